import asyncio
import random
import socket
import time
from collections.abc import AsyncIterator, Callable
from typing import Any

import pytest

from service.drivers.ur.rtde import RtdeClient
from service.drivers.ur.rtde_link import LinkError
from sim_backend.protocol.rtde.codec import PackageType, Recipe, frame
from sim_backend.protocol.rtde.errors import FramingError, PackageError, Reason, RtdeError, SetupError
from sim_backend.protocol.rtde.fields import OUTPUTS
from sim_backend.protocol.rtde.messages import Level, TextMessage
from tests.fault_proxy import FaultProxy, Spoil, chunked, duplicated, garbled, halved, reordered, untouched
from tests.service.drivers.ur.rtde_responder import VERSION, RtdeResponder

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


@pytest.fixture
async def robot() -> AsyncIterator[RtdeResponder]:
    async with RtdeResponder() as responder:
        yield responder


@pytest.fixture
async def proxy(robot: RtdeResponder) -> AsyncIterator[FaultProxy]:
    async with FaultProxy((robot.host, robot.port), robot.host) as between:
        yield between


@pytest.fixture
def listener() -> Listener:
    return Listener()


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


async def test_values_arrive_as_the_types_say_and_only_then_is_it_ready(
    robot: RtdeResponder, listener: Listener
) -> None:
    client = listener.client(robot.host, robot.port)
    assert not client.ready
    await client.connect()
    assert client.controller_version == VERSION
    await client.setup(OUTPUT_NAMES, 500.0, INPUT_NAMES)
    assert not client.ready
    before = time.monotonic()
    await start(client, robot)
    assert client.ready
    assert listener.packages == [(60.002, tuple(range(1, 7)), 2, True, tuple(range(4, 10)), 5)]
    assert [type(value) for value in listener.packages[0]] == [float, tuple, int, bool, tuple, int]
    assert before <= listener.arrivals[0] <= time.monotonic()
    assert robot.frequencies_hz == [500.0]
    await client.close()
    assert not client.ready
    assert listener.lost == []


@pytest.mark.parametrize(
    "cut", [lambda: untouched, lambda: chunked(random.Random(1), 7), lambda: chunked(random.Random(2), 400), halved]
)
async def test_every_package_arrives_in_order_however_the_stream_was_cut(
    robot: RtdeResponder, proxy: FaultProxy, listener: Listener, cut: Callable[[], Spoil]
) -> None:
    client = await flowing(listener.client(proxy.host, proxy.port), robot)
    proxy.to_client.spoil = cut()
    for burst in (1, 1, 60, 3, 35):
        robot.tick(burst)
        await asyncio.sleep(0.005)
    robot.tick()  # carries the kept half of its predecessor, where halves are kept
    await until(lambda: client.received >= 101)
    assert [package[0] for package in listener.packages[:101]] == pytest.approx(
        [60.002 + 0.002 * i for i in range(101)]
    )
    assert (client.skipped, client.out_of_order) == (0, 0)


async def test_packages_that_the_controller_left_out_are_counted(robot: RtdeResponder, listener: Listener) -> None:
    client = await flowing(listener.client(robot.host, robot.port), robot)
    robot.skip(4)
    robot.tick(3)
    robot.skip(1)
    robot.tick()
    await until(lambda: client.received == 5)
    assert client.skipped == 5
    await client.close()


async def test_at_200_hz_a_package_of_every_second_tick_is_none_skipped(
    robot: RtdeResponder, listener: Listener
) -> None:
    client = await flowing(listener.client(robot.host, robot.port), robot, 200.0)
    for _ in range(5):
        robot.skip(1)
        robot.tick()
    robot.skip(3)
    robot.tick()
    await until(lambda: client.received == 7)
    assert client.skipped == 1
    await client.close()


async def test_a_package_that_is_not_newer_is_delivered_and_counted(robot: RtdeResponder, listener: Listener) -> None:
    client = await flowing(listener.client(robot.host, robot.port), robot)
    robot.skip(-1)
    robot.tick()
    robot.skip(-2)
    robot.tick()
    await until(lambda: client.received == 3)
    assert client.out_of_order == 2
    assert [package[0] for package in listener.packages] == pytest.approx([60.002, 60.002, 60.0])
    await client.close()


async def test_refused_variables_are_named_with_their_reason(robot: RtdeResponder, listener: Listener) -> None:
    robot.in_use = {"speed_slider_mask"}
    client = listener.client(robot.host, robot.port)
    await client.connect()
    with pytest.raises(SetupError, match="speed_slider_mask") as caught:
        await client.setup(OUTPUT_NAMES, 500.0, INPUT_NAMES)
    assert caught.value.refused == {"speed_slider_mask": Reason.IN_USE}
    assert caught.value.reason is Reason.IN_USE
    await client.connect()
    with pytest.raises(SetupError, match="actual_w") as caught:
        await client.setup(["timestamp", "actual_w", "actual_q", "actual_v"], 500.0)
    assert caught.value.refused == {"actual_w": Reason.NOT_FOUND, "actual_v": Reason.NOT_FOUND}
    await until(lambda: not robot.clients)


async def test_a_recipe_that_cannot_be_asked_for_is_refused_here(robot: RtdeResponder, listener: Listener) -> None:
    client = listener.client(robot.host, robot.port)
    await client.connect()
    with pytest.raises(ValueError, match="timestamp"):
        await client.setup(["actual_q"], 500.0)
    with pytest.raises(ValueError, match="500"):
        await client.setup(["timestamp"], 501.0)
    with pytest.raises(PackageError, match="2048"):
        await client.setup(["timestamp", *["actual_q"] * 300], 500.0)
    await client.close()


@pytest.mark.parametrize(
    "step",
    [
        PackageType.PROTOCOL_VERSION, PackageType.CONTROLLER_VERSION, PackageType.SETUP_OUTPUTS,
        PackageType.SETUP_INPUTS, PackageType.START,
    ],
)  # fmt: skip
async def test_a_step_without_an_answer_ends_in_time_and_says_which(
    robot: RtdeResponder, listener: Listener, step: PackageType
) -> None:
    robot.mute = {step}
    client = listener.client(robot.host, robot.port, timeout_s=0.05)
    with pytest.raises(LinkError, match=step.name) as caught:
        await flowing(client, robot)
    assert caught.value.reason is Reason.TIMEOUT
    assert not client.ready
    assert listener.lost == []
    await until(lambda: not robot.clients)


async def test_a_start_without_data_is_an_error(robot: RtdeResponder, listener: Listener) -> None:
    client = listener.client(robot.host, robot.port, timeout_s=0.05)
    await client.connect()
    await client.setup(OUTPUT_NAMES, 500.0)
    with pytest.raises(LinkError, match="DATA") as caught:
        await client.start()
    assert caught.value.reason is Reason.TIMEOUT
    assert not client.ready


async def test_a_controller_that_says_no_is_heard(robot: RtdeResponder, listener: Listener) -> None:
    client = listener.client(robot.host, robot.port)
    robot.speaks = False
    with pytest.raises(LinkError, match="version 2") as caught:
        await client.connect()
    assert caught.value.reason is Reason.REFUSED
    robot.speaks, robot.starts = True, False
    await client.connect()
    await client.setup(OUTPUT_NAMES, 500.0)
    with pytest.raises(LinkError, match="start") as caught:
        await client.start()
    assert caught.value.reason is Reason.REFUSED


async def test_nobody_there_is_unreachable_and_says_where(listener: Listener) -> None:
    async with RtdeResponder() as gone:
        pass
    with pytest.raises(LinkError, match=f"{gone.host}:{gone.port}") as caught:
        await listener.client(gone.host, gone.port).connect()
    assert caught.value.reason is Reason.UNREACHABLE
    with pytest.raises(LinkError, match="connect first"):
        await listener.client(gone.host, gone.port).start()


async def test_a_controller_that_does_not_take_the_connection_ends_it_in_time(listener: Listener) -> None:
    with (
        socket.create_server(("127.0.0.23", 0), backlog=0) as full,
        socket.create_connection(full.getsockname()),
        pytest.raises(LinkError, match=r"no connection in 0\.05 s") as caught,
    ):
        await listener.client(*full.getsockname(), timeout_s=0.05).connect()
    assert caught.value.reason is Reason.TIMEOUT


async def test_a_name_with_several_addresses_is_tried_at_each(listener: Listener) -> None:
    async with RtdeResponder("127.0.0.1") as local:
        client = await flowing(listener.client("localhost", local.port), local)
        assert client.ready
        await client.close()


async def test_a_loss_in_the_middle_of_the_set_up_is_told_at_once(robot: RtdeResponder, listener: Listener) -> None:
    robot.mute = {PackageType.SETUP_INPUTS}
    client = listener.client(robot.host, robot.port, timeout_s=60.0)
    await client.connect()
    setting_up = asyncio.create_task(client.setup(OUTPUT_NAMES, 500.0, INPUT_NAMES))
    await until(lambda: client.outputs)
    robot.hang_up()
    with pytest.raises(LinkError) as caught:
        await setting_up
    assert caught.value.reason is Reason.CLOSED
    assert listener.lost == []


async def test_a_set_up_that_is_cancelled_hangs_up(robot: RtdeResponder, listener: Listener) -> None:
    robot.mute = {PackageType.SETUP_OUTPUTS}
    client = listener.client(robot.host, robot.port, timeout_s=60.0)
    await client.connect()
    setting_up = asyncio.create_task(client.setup(OUTPUT_NAMES, 500.0))
    await asyncio.sleep(0.01)
    setting_up.cancel()
    with pytest.raises(asyncio.CancelledError):
        await setting_up
    await until(lambda: not robot.clients)
    with pytest.raises(LinkError, match="connect first"):
        await client.start()


async def test_what_the_controller_says_is_passed_on_and_explains_a_silence(
    robot: RtdeResponder, listener: Listener
) -> None:
    client = listener.client(robot.host, robot.port, timeout_s=0.05)
    await client.connect()
    said = TextMessage("no field bus", "RTDE", Level.WARNING)
    robot.say(said.encode())
    robot.mute = {PackageType.SETUP_OUTPUTS}
    with pytest.raises(LinkError, match="no field bus"):
        await client.setup(OUTPUT_NAMES, 500.0)
    assert listener.texts == [said]


FAULTS = {
    Reason.UNKNOWN_PACKAGE: frame(37, b"?"),
    Reason.UNEXPECTED: frame(PackageType.START, b"\x01"),
    Reason.WRONG_RECIPE: frame(PackageType.DATA, b"\x02" + bytes(117)),
    Reason.MALFORMED: frame(PackageType.DATA, b"\x01" + bytes(3)),
    Reason.FRAMING: b"\x00\x02U",
}


@pytest.mark.parametrize("reason", FAULTS)
async def test_a_breach_of_the_protocol_ends_the_link_and_is_told_once(
    robot: RtdeResponder, listener: Listener, reason: Reason
) -> None:
    client = await flowing(listener.client(robot.host, robot.port), robot)
    robot.tick()
    robot.say(FAULTS[reason])
    robot.tick()
    await until(lambda: listener.lost)
    await asyncio.sleep(0.01)
    assert [error.reason for error in listener.lost] == [reason]
    assert client.name in str(listener.lost[0])
    assert isinstance(listener.lost[0].__cause__, PackageError | FramingError)
    assert len(listener.packages) == 2  # the good one before it, and not the one after
    assert not client.ready


async def test_a_timestamp_that_is_no_number_ends_the_link(robot: RtdeResponder, listener: Listener) -> None:
    await flowing(listener.client(robot.host, robot.port), robot)
    robot.time_s = float("nan")
    robot.tick()
    await until(lambda: listener.lost)
    assert listener.lost[0].reason is Reason.MALFORMED


async def test_data_before_a_recipe_are_a_fault(robot: RtdeResponder, listener: Listener) -> None:
    client = listener.client(robot.host, robot.port)
    await client.connect()
    robot.say(frame(PackageType.DATA, b"\x01"))
    await until(lambda: not robot.clients)
    with pytest.raises(LinkError, match="before any were asked for"):
        await client.setup(OUTPUT_NAMES, 500.0)


async def test_after_a_loss_it_connects_again_and_is_not_ready_before_data_flow(
    robot: RtdeResponder, proxy: FaultProxy, listener: Listener
) -> None:
    client = await flowing(listener.client(proxy.host, proxy.port), robot)
    await proxy.reset()
    await until(lambda: listener.lost)
    assert listener.lost[0].reason is Reason.CLOSED
    assert not client.ready
    assert not client.send(0, (1, 1.0))
    proxy.accepting = False
    with pytest.raises(RtdeError):
        await client.connect()
    proxy.accepting = True
    await client.connect()
    assert not client.ready
    await client.setup(OUTPUT_NAMES, 500.0, INPUT_NAMES)
    assert not client.ready
    await start(client, robot)
    assert client.ready
    assert (client.received, client.skipped, client.out_of_order) == (1, 0, 0)
    assert len(listener.lost) == 1
    await client.close()


async def test_a_controller_that_hangs_up_is_a_loss(robot: RtdeResponder, listener: Listener) -> None:
    await flowing(listener.client(robot.host, robot.port), robot)
    robot.hang_up()
    await until(lambda: listener.lost)
    assert listener.lost[0].reason is Reason.CLOSED


async def test_a_black_hole_is_a_loss_after_the_silence_that_is_allowed(
    robot: RtdeResponder, proxy: FaultProxy, listener: Listener
) -> None:
    client = await flowing(listener.client(proxy.host, proxy.port, silence_s=0.05), robot)
    for _ in range(20):
        robot.tick()
        await asyncio.sleep(0.01)
    assert client.ready
    proxy.to_client.stall()
    await until(lambda: listener.lost)
    assert listener.lost[0].reason is Reason.TIMEOUT
    assert not client.ready


async def test_inputs_arrive_with_their_recipe(robot: RtdeResponder, listener: Listener) -> None:
    client = await flowing(listener.client(robot.host, robot.port), robot)
    assert client.send(0, (7, 0.25))
    assert client.send(1, (1, 0.5))
    assert client.send(0, (-8, 1e300))
    await until(lambda: len(robot.received) == 3)
    assert robot.received == [(1, (7, 0.25)), (2, (1, 0.5)), (1, (-8, 1e300))]
    assert client.dropped == 0
    with pytest.raises(PackageError, match="input_int_register_24") as caught:
        client.send(0, (2**31, 0.0))
    assert caught.value.reason is Reason.WRONG_VALUE
    await client.close()


async def test_what_was_sent_before_close_was_read(robot: RtdeResponder, listener: Listener) -> None:
    client = await flowing(listener.client(robot.host, robot.port), robot)
    robot.tick(20)
    assert client.send(0, (9, 0.0))
    await client.close()
    assert robot.received == [(1, (9, 0.0))]
    assert listener.lost == []
    assert not client.send(0, (10, 0.0))


@pytest.mark.parametrize(("recipe", "size"), [(0, 2), (2, 48)])
async def test_an_input_that_cannot_leave_now_is_dropped_and_never_sent_later(
    robot: RtdeResponder, proxy: FaultProxy, listener: Listener, recipe: int, size: int
) -> None:
    client = await flowing(listener.client(proxy.host, proxy.port), robot)
    proxy.to_service.stall()
    left: list[int] = []
    for number in range(10_000):
        if client.send(recipe, [number] * size):
            left.append(number)
        if number % 100 == 0:
            await asyncio.sleep(0)
    assert client.dropped == 10_000 - len(left)
    assert len(left) < 1000  # most of them in the proxy's own buffers
    assert client.ready  # data still arrive: it is the caller who judges
    proxy.to_service.resume()
    await until(lambda: len(robot.received) == len(left))
    assert client.send(recipe, [-1] * size)
    await until(lambda: robot.received[-1] == (recipe + 1, (-1,) * size))
    assert robot.received[:-1] == [(recipe + 1, (number,) * size) for number in left]
    await client.close()


async def test_sending_while_the_link_breaks_is_no_error(robot: RtdeResponder, listener: Listener) -> None:
    client = await flowing(listener.client(robot.host, robot.port), robot)
    robot.hang_up()
    async with asyncio.timeout(20.0):
        while not listener.lost:
            client.send(0, (1, 1.0))
            await asyncio.sleep(0)
    assert [error.reason for error in listener.lost] == [Reason.CLOSED]
    assert not client.send(0, (1, 1.0))


async def test_duplicates_are_counted_and_delivered(
    robot: RtdeResponder, proxy: FaultProxy, listener: Listener
) -> None:
    client = await flowing(listener.client(proxy.host, proxy.port), robot)
    proxy.to_client.spoil = duplicated(1)
    robot.tick()
    await until(lambda: client.received == 3)
    assert client.out_of_order == 1
    assert listener.packages[1] == listener.packages[2]
    proxy.to_client.spoil = reordered(2)
    robot.tick()
    await until(lambda: client.received == 4)
    robot.tick()
    await asyncio.sleep(0.01)
    robot.tick()
    await until(lambda: client.received == 6)
    assert client.out_of_order == 2
    assert client.skipped == 1
    proxy.to_client.spoil = untouched
    await client.close()


async def test_garbage_never_passes_for_data(robot: RtdeResponder, proxy: FaultProxy, listener: Listener) -> None:
    for seed in range(10):
        client = await flowing(listener.client(proxy.host, proxy.port, silence_s=0.2), robot)
        good = len(listener.packages)
        proxy.to_client.spoil = garbled(random.Random(seed), 2)
        for _ in range(20):
            robot.tick()
            await asyncio.sleep(0.001)
        await until(lambda seed=seed: len(listener.lost) == seed + 1)
        proxy.to_client.spoil = garbled(random.Random(seed), 1_000_000)
        assert not client.ready
        assert len(listener.packages) - good == 1
        expected = Recipe(OUTPUT_NAMES, [OUTPUTS[name] for name in OUTPUT_NAMES], 1)
        assert all(package[1:] == tuple(robot.values(expected))[1:] for package in listener.packages)
        await until(lambda: not robot.clients)


async def test_latency_delays_and_loses_nothing(robot: RtdeResponder, proxy: FaultProxy, listener: Listener) -> None:
    client = await flowing(listener.client(proxy.host, proxy.port), robot)
    proxy.to_client.delay_s, proxy.to_client.jitter_s = 0.03, 0.02
    for _ in range(50):
        robot.tick()
        await asyncio.sleep(0.001)
    await until(lambda: client.received == 51)
    assert (client.skipped, client.out_of_order) == (0, 0)
    await client.close()


async def test_a_receiver_that_fails_ends_the_link(robot: RtdeResponder, listener: Listener) -> None:
    failures: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda loop, context: failures.append(context))
    client = await flowing(listener.client(robot.host, robot.port), robot)
    listener.spoil = lambda: [][1]
    robot.tick()
    await until(lambda: listener.lost)
    assert not client.ready
    assert isinstance(failures[0]["exception"], IndexError)


async def test_closing_from_a_receiver_delivers_nothing_more(robot: RtdeResponder, listener: Listener) -> None:
    client = await flowing(listener.client(robot.host, robot.port), robot)
    tasks: list[asyncio.Task[None]] = []
    listener.spoil = lambda: tasks.append(asyncio.create_task(client.connect()))
    robot.tick()
    await until(lambda: tasks)
    await tasks[0]
    count = len(listener.packages)
    robot.tick(5)
    await asyncio.sleep(0.02)
    assert len(listener.packages) == count
    await client.close()
    assert listener.lost == []
