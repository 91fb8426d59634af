import asyncio
import random
from typing import Any

import pytest

from service.drivers.ur.rtde_link import LinkError
from tests.fault_proxy import FaultProxy, duplicated, garbled, reordered, untouched
from tests.service.drivers.ur.rtde_listener import INPUT_NAMES, OUTPUT_NAMES, Listener, flowing, start, until
from tests.service.drivers.ur.rtde_responder import RtdeResponder
from wire.rtde.codec import PackageType, Recipe, frame
from wire.rtde.errors import FramingError, PackageError, RtdeError, RtdeErrorReason
from wire.rtde.fields import OUTPUTS

FAULTS = {
    RtdeErrorReason.UNKNOWN_PACKAGE: frame(37, b"?"),
    RtdeErrorReason.UNEXPECTED: frame(PackageType.START, b"\x01"),
    RtdeErrorReason.WRONG_RECIPE: frame(PackageType.DATA, b"\x02" + bytes(117)),
    RtdeErrorReason.MALFORMED: frame(PackageType.DATA, b"\x01" + bytes(3)),
    RtdeErrorReason.FRAMING: b"\x00\x02U",
}


@pytest.mark.parametrize("reason", FAULTS)
async def test_a_breach_of_the_protocol_ends_the_link_and_is_told_once(
    robot: RtdeResponder, listener: Listener, reason: RtdeErrorReason
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
    assert listener.lost[0].reason is RtdeErrorReason.MALFORMED


async def test_data_before_a_recipe_are_a_fault(robot: RtdeResponder, listener: Listener) -> None:
    client = listener.client(robot.host, robot.port)
    await client.connect()
    robot.say(frame(PackageType.DATA, b"\x01"))
    await until(lambda: not robot.clients)
    with pytest.raises(LinkError, match="before any were asked for"):
        await client.setup(OUTPUT_NAMES, 500.0)


async def test_18_after_a_loss_it_connects_again_and_is_not_ready_before_data_flow(
    robot: RtdeResponder, proxy: FaultProxy, listener: Listener
) -> None:
    client = await flowing(listener.client(proxy.host, proxy.port), robot)
    await proxy.reset()
    await until(lambda: listener.lost)
    assert listener.lost[0].reason is RtdeErrorReason.CLOSED
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
    assert listener.lost[0].reason is RtdeErrorReason.CLOSED


async def test_17_a_black_hole_is_a_loss_after_the_silence_that_is_allowed(
    robot: RtdeResponder, proxy: FaultProxy, listener: Listener
) -> None:
    client = await flowing(listener.client(proxy.host, proxy.port, silence_s=0.05), robot)
    for _ in range(20):
        robot.tick()
        await asyncio.sleep(0.01)
    assert client.ready
    proxy.to_client.stall()
    await until(lambda: listener.lost)
    assert listener.lost[0].reason is RtdeErrorReason.TIMEOUT
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
    assert caught.value.reason is RtdeErrorReason.WRONG_VALUE
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
    assert [error.reason for error in listener.lost] == [RtdeErrorReason.CLOSED]
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
