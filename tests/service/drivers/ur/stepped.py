"""An emulated controller for asynchronous clients: stepped on their event loop, as fast as it goes."""

import asyncio
import contextlib
from collections.abc import AsyncGenerator

from sim_backend.ur_controller.assembly import make_controller
from sim_backend.ur_controller.controller import Controller
from sim_backend.ur_controller.plant import Plant
from sim_backend.ur_controller.server import ANY_PORTS, ControllerServer, Ports
from sim_backend.world.world import World

HOST = "127.0.0.25"


@contextlib.asynccontextmanager
async def stepped_controller() -> AsyncGenerator[tuple[Controller, Ports]]:
    """A controller and the ports that it listens at, on `HOST`."""
    controller = make_controller(Plant(World(1, "tr")))
    server = ControllerServer(controller, HOST, ANY_PORTS)

    async def step() -> None:
        while True:
            server.step()
            await asyncio.sleep(0)

    stepping = asyncio.create_task(step())
    try:
        yield controller, server.ports
    finally:
        stepping.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await stepping
        server.close()
