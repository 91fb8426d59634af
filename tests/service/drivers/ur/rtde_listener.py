"""A client of RTDE: the packages that it hears, and how it comes to hear them."""

import asyncio
import time
from collections.abc import Callable
from typing import Any

from service.drivers.ur.rtde import RtdeClient
from tests.service.drivers.ur.rtde_responder import RtdeResponder
from wire.rtde.errors import RtdeError
from wire.rtde.messages import TextMessage

OUTPUT_NAMES = ["timestamp", "actual_q", "robot_mode", "output_bit_register_64", "actual_TCP_force", "runtime_state"]
INPUT_NAMES = [
    ["input_int_register_24", "input_double_register_24"],
    ["speed_slider_mask", "speed_slider_fraction"],
    [f"input_double_register_{number}" for number in range(48)],
]


class Listener:
    def __init__(self) -> None:
        self.packages: list[tuple[Any, ...]] = []
        self.arrivals: list[float] = []
        self.lost: list[RtdeError] = []
        self.texts: list[TextMessage] = []
        self.spoil: Callable[[], None] = lambda: None

    def on_package(self, values: tuple[Any, ...], arrival_s: float) -> None:
        self.packages.append(values)
        self.arrivals.append(arrival_s)
        self.spoil()

    def client(self, host: str, port: int, timeout_s: float = 1.0, silence_s: float | None = None) -> RtdeClient:
        return RtdeClient(
            host, port, clock=time.monotonic, timeout_s=timeout_s, silence_s=silence_s,
            on_package=self.on_package, on_lost=self.lost.append, on_text=self.texts.append,
        )  # fmt: skip


async def until(condition: Callable[[], object]) -> None:
    async with asyncio.timeout(20.0):
        while not condition():
            await asyncio.sleep(0.001)


async def flowing(client: RtdeClient, robot: RtdeResponder, frequency_hz: float = 500.0) -> RtdeClient:
    await client.connect()
    await client.setup(OUTPUT_NAMES, frequency_hz, INPUT_NAMES)
    await start(client, robot)
    return client


async def start(client: RtdeClient, robot: RtdeResponder) -> None:
    starting = asyncio.create_task(client.start())
    await until(lambda: any(one.running for one in robot.clients) or starting.done())
    robot.tick()
    await starting
