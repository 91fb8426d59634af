"""A UR driver and an emulated controller in one process, over real sockets, one tick at a time.

Time passes only once the driver has received the last tick, so a test is as fast as the machine, and the same every
time.
"""

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from service.cell.cell import Cell
from service.cell.inference import InferenceKind, InlineInference
from service.cell.process import attended
from service.config import CellConfig
from service.drivers.base import Driver, Load, Sample
from service.drivers.sim_wire import check_task
from service.drivers.ur.driver import UrDriver
from service.drivers.world_setup import LaidOut
from service.faults import FaultCode
from service.testing import Bench
from sim_backend.ur_controller.assembly import make_controller
from sim_backend.ur_controller.controller import Controller
from sim_backend.ur_controller.outputs import Outputs
from sim_backend.ur_controller.plant import Plant
from sim_backend.ur_controller.server import ANY_PORTS, ControllerServer
from sim_backend.world.world import World
from tests.fault_proxy import FaultProxy
from tests.service.drivers.ur.cells import UR, ur_config
from wire.task import Task

HOST = UR["host"]
DELIVERY_S = 2.0
"""Host time in which a package crosses this machine's loopback, however busy it is."""


class PlantWorldSetup:
    """Lays the plant out directly, and is the camera that looks at it."""

    def __init__(self, controller: Controller) -> None:
        self.episode = 0
        self._controller = controller

    async def open(self) -> None: ...

    async def close(self) -> None: ...

    async def lay_out(self, task: Task | None) -> LaidOut:
        self._controller.plant.lay_out(check_task(task))
        self.episode += 1
        return LaidOut(self.episode, self._controller.time_s)

    def estimate(self, now: float):
        return self._controller.plant.estimate.copy()


@dataclass
class Emulated:
    """One emulated controller and the driver of its arm.

    Attributes:
        paused: no tick passes while this is set.
        samples: that came while nobody else was the driver's sink.
        faults: likewise.
        before_tick: called before every tick.
        proxy: between driver and controller, where one was asked for.
    """

    controller: Controller
    server: ControllerServer
    driver: UrDriver
    config: CellConfig
    paused: bool = False
    samples: list[Sample] = field(default_factory=list)
    faults: list[tuple[FaultCode, str]] = field(default_factory=list)
    before_tick: Callable[[], None] = lambda: None
    proxy: FaultProxy | None = None

    @property
    def plant(self) -> Plant:
        return self.controller.plant

    def truth(self) -> dict[str, Any]:
        return self.plant.truth()

    def overloads(self, load: Load) -> bool:
        return False

    def on_sample(self, sample: Sample) -> None:
        self.samples.append(sample)

    def on_link_fault(self, code: FaultCode, text: str) -> None:
        self.faults.append((code, text))

    def output(self, name: str) -> Any:
        return Outputs(self.controller).getters[name]()

    async def pass_time(self, seconds: float) -> None:
        until = self.controller.time_s + seconds
        while self.controller.time_s < until:
            await asyncio.sleep(0)

    async def until(self, condition: Callable[[], bool], limit_s: float = 5.0) -> None:
        """Let simulated time pass until `condition` holds."""
        end_s = self.controller.time_s + limit_s
        while not condition():
            assert self.controller.time_s < end_s, f"not within {limit_s} s of simulated time"
            await asyncio.sleep(0)

    async def let_time_pass(self) -> None:
        while True:
            if not self.paused:
                self.before_tick()
                self.server.step()
            await asyncio.sleep(0)
            patience_s = time.monotonic() + DELIVERY_S
            while (received_s := self.driver.received_s) is not None and received_s < self.controller.time_s - 1e-9:
                if time.monotonic() > patience_s:
                    break
                await asyncio.sleep(0)


@asynccontextmanager
async def emulated(
    config: CellConfig | None = None,
    *,
    host: str = HOST,
    prepare: Callable[[Controller], None] = lambda controller: None,
    proxied: bool = False,
) -> AsyncIterator[Emulated]:
    """An emulated controller that ticks, and a driver that is not connected yet.

    Args:
        config: of the cell; its ports are replaced by free ones.
        host: address to listen at.
        prepare: does something to the controller before its first tick.
        proxied: RTDE goes through a proxy that can spoil it.
    """
    config = config or ur_config()
    plant = Plant(World(1, "tr"))
    controller = make_controller(plant)
    prepare(controller)
    server = ControllerServer(controller, host, ANY_PORTS)
    ports = server.ports
    assert config.ur is not None
    stack = AsyncExitStack()
    proxy = await stack.enter_async_context(FaultProxy((host, ports.rtde), host)) if proxied else None
    ur = config.ur.model_copy(
        update={
            "host": host,
            "rtde_port": ports.rtde if proxy is None else proxy.port,
            "dashboard_port": ports.dashboard,
            "primary_port": ports.primary,
        }
    )
    config = config.model_copy(update={"ur": ur})
    world_setup = PlantWorldSetup(controller)
    driver = UrDriver(config, mode="lockstep", camera=world_setup, world_setup=world_setup)
    bench = Emulated(controller, server, driver, config, proxy=proxy)
    ticking = asyncio.create_task(bench.let_time_pass(), name="ticks")
    try:
        yield bench
    finally:
        await driver.close()
        ticking.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await ticking
        await stack.aclose()
        server.close()


@asynccontextmanager
async def lockstep_ur_cell(
    config: CellConfig, *, wrap: Callable[[Driver], Driver] | None = None, inference: InferenceKind = InlineInference
) -> AsyncIterator[Bench]:
    """`service.testing.lockstep_cell` with a UR arm: the same bench, whose world is the emulated controller's."""
    async with emulated(config) as arm:
        driver: Driver = arm.driver if wrap is None else wrap(arm.driver)
        cell = Cell(arm.config, driver, inference=inference)
        bench = Bench(cell, arm)  # type: ignore[arg-type]
        cell.journal.observers.append(bench)
        async with attended(cell):
            await bench.until(lambda: cell.newest_sample is not None)
            yield bench


def ur_cell_config(state_dir: Path, policy: Path, limits: dict[str, Any] | None = None, **recipe: Any) -> CellConfig:
    """`service.testing.cell_config` with a UR arm."""
    return ur_config(state_dir, policy, limits=limits, **recipe)
