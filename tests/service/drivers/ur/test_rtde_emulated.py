"""The client against the emulated controller, over sockets, in one process and without waiting for real time."""

import asyncio
import contextlib
import random
from collections.abc import AsyncIterator, Callable
from typing import Any

import pytest

from service.drivers.ur.rtde import RtdeClient
from sim_backend.ur_controller.assembly import make_controller
from sim_backend.ur_controller.plant import Plant
from sim_backend.ur_controller.server import ANY_PORTS, ControllerServer
from sim_backend.world.world import World
from tests.fault_proxy import FaultProxy, chunked, garbled
from wire.rtde.errors import RtdeError, RtdeErrorReason, SetupError
from wire.rtde.fields import INPUTS, OUTPUTS, SINCE

HOST = "127.0.0.23"
MORE_THAN_BUFFERS_HOLD = 1000
"""Packages of a kilobyte."""


class Robot:
    """An emulated controller whose time passes as long as a test waits for something."""

    def __init__(self) -> None:
        self.controller = make_controller(Plant(World(1, "tr")))
        self.server = ControllerServer(self.controller, HOST, ANY_PORTS)
        self.clients: list[RtdeClient] = []
        self.packages: list[tuple[Any, ...]] = []
        self.lost: list[RtdeError] = []

    def client(self, port: int | None = None) -> RtdeClient:
        client = RtdeClient(
            HOST, port or self.server.ports.rtde, clock=lambda: self.controller.time_s, silence_s=None,
            on_package=lambda values, _: self.packages.append(values), on_lost=self.lost.append,
        )  # fmt: skip
        self.clients.append(client)
        return client

    async def run(self) -> None:
        while True:
            self.server.step()
            await asyncio.sleep(0)

    async def until(self, condition: Callable[[], object]) -> None:
        async with asyncio.timeout(20.0):
            while not condition():
                await asyncio.sleep(0)


@pytest.fixture
async def robot() -> AsyncIterator[Robot]:
    robot = Robot()
    time_passes = asyncio.create_task(robot.run())
    yield robot
    for client in robot.clients:
        await client.close()
    time_passes.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await time_passes
    robot.server.close()


async def connected(
    client: RtdeClient, outputs: list[str], frequency_hz: float = 500.0, inputs: Any = ()
) -> RtdeClient:
    await client.connect()
    await client.setup(outputs, frequency_hz, inputs)
    await client.start()
    return client


async def test_the_arm_is_seen_at_every_tick_as_it_is(robot: Robot) -> None:
    client = await connected(robot.client(), ["timestamp", "actual_q", "robot_mode", "runtime_state", "payload_cog"])
    await robot.until(lambda: client.received >= 500)
    assert (client.skipped, client.out_of_order) == (0, 0)
    ticks = [package[0] / 0.002 for package in robot.packages]
    assert ticks == pytest.approx([ticks[0] + i for i in range(len(ticks))], abs=1e-4)
    assert ticks == pytest.approx([round(tick) for tick in ticks], abs=1e-4)
    assert robot.packages[-1][1] == pytest.approx(robot.controller.plant.q, abs=1e-3)
    assert robot.packages[-1][2] == 7
    assert client.controller_version == robot.controller.versions
    assert not robot.lost


async def test_every_variable_of_its_version_can_be_had_and_no_newer_one(robot: Robot) -> None:
    version = tuple(robot.controller.versions[:3])
    names = [name for name in OUTPUTS if SINCE.get(name, (0, 0, 0)) <= version and name != "timestamp"]
    for start in range(0, len(names), 60):
        wanted = ["timestamp", *names[start : start + 60]]
        client = await connected(robot.client(), wanted)
        values = robot.packages[-1]
        for name, value in zip(wanted, values, strict=True):
            assert (len(value) if isinstance(value, tuple) else 1) == OUTPUTS[name].count
        await client.close()
    newer = [name for name in OUTPUTS if SINCE.get(name, (0, 0, 0)) > version]
    assert newer
    with pytest.raises(SetupError) as caught:
        await connected(robot.client(), ["timestamp", *newer])
    assert caught.value.refused == dict.fromkeys(newer, RtdeErrorReason.NOT_FOUND)


async def test_inputs_reach_the_controller_and_can_be_read_back(robot: Robot) -> None:
    names = [name for name in INPUTS if name.startswith("input_") and name.endswith("_24")]
    outputs = ["timestamp", *names]
    client = await connected(robot.client(), outputs, inputs=[[names[0]], names[1:]])
    assert client.send(0, (42,))
    assert client.send(1, (2.5,))
    await robot.until(lambda: robot.packages[-1][1:] == (42, 2.5))
    await robot.until(lambda: client.received > 100)
    assert robot.packages[-1][1:] == (42, 2.5)  # inputs keep their last value
    assert client.dropped == 0


async def test_a_variable_that_another_client_holds_is_named_until_it_leaves(robot: Robot) -> None:
    held = ["input_int_register_24", "input_double_register_24"]
    first = await connected(robot.client(), ["timestamp"], inputs=[held])
    second = robot.client()
    with pytest.raises(SetupError) as caught:
        await connected(second, ["timestamp"], inputs=[["input_int_register_25"], ["input_int_register_26", *held]])
    assert caught.value.refused == dict.fromkeys(held, RtdeErrorReason.IN_USE)
    await first.close()
    await connected(second, ["timestamp"], inputs=[held])
    assert second.ready


async def test_at_200_hz_every_second_tick_is_sent(robot: Robot) -> None:
    client = await connected(robot.client(), ["timestamp"], 200.0)
    await robot.until(lambda: client.received >= 50)
    assert client.skipped == 0
    assert robot.packages[40][0] - robot.packages[0][0] == pytest.approx(40 * 0.004)


async def test_packages_left_out_for_a_slow_network_are_counted_and_the_newest_come(robot: Robot) -> None:
    async with FaultProxy((HOST, robot.server.ports.rtde), HOST) as proxy:
        wide = [name for name in OUTPUTS if OUTPUTS[name].count == 6 and name not in SINCE]
        client = await connected(robot.client(proxy.port), ["timestamp", *wide])
        proxy.to_client.stall()
        stalled_at = robot.server.counters.ticks
        await robot.until(lambda: robot.server.counters.ticks > stalled_at + MORE_THAN_BUFFERS_HOLD)
        proxy.to_client.resume()
        await robot.until(lambda: client.skipped)
        await robot.until(lambda: robot.packages[-1][0] > robot.controller.time_s - 0.1)
        assert client.out_of_order == 0
        count = client.received + client.skipped
        assert count == round((robot.packages[-1][0] - robot.packages[0][0]) / 0.002) + 1
        await client.close()


async def test_one_client_s_broken_line_is_no_other_client_s(robot: Robot) -> None:
    steady = await connected(robot.client(), ["timestamp"], inputs=[["input_int_register_30"]])
    async with FaultProxy((HOST, robot.server.ports.rtde), HOST) as proxy:
        broken = robot.client(proxy.port)
        proxy.to_service.spoil = proxy.to_client.spoil = chunked(random.Random(1), 3)
        await connected(broken, ["timestamp", "actual_q"], inputs=[["input_int_register_31"]])
        proxy.to_service.spoil = garbled(random.Random(2), 1)
        with contextlib.suppress(RtdeError):
            for number in range(50):
                broken.send(0, (number,))
                await asyncio.sleep(0.001)
        await robot.until(lambda: robot.lost)
        proxy.to_service.spoil = lambda chunk: [chunk]
        await connected(broken, ["timestamp", "actual_q"], inputs=[["input_int_register_31"]])
        assert broken.ready
        await proxy.reset()
        await robot.until(lambda: len(robot.lost) == 2)
    before = steady.received
    await robot.until(lambda: steady.received > before + 100)
    assert (steady.skipped, steady.out_of_order) == (0, 0)
    assert steady.send(0, (7,))
    await robot.until(lambda: robot.controller.inputs.registers.ints[30] == 7)
