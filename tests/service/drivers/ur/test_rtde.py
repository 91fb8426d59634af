import asyncio
import random
import socket
import time
from collections.abc import Callable

import pytest

from service.drivers.ur.rtde_link import LinkError
from tests.fault_proxy import FaultProxy, Spoil, chunked, halved, untouched
from tests.service.drivers.ur.rtde_listener import INPUT_NAMES, OUTPUT_NAMES, Listener, flowing, start, until
from tests.service.drivers.ur.rtde_responder import VERSION, RtdeResponder
from wire.rtde.codec import PackageType
from wire.rtde.errors import PackageError, RtdeErrorReason, SetupError
from wire.rtde.messages import Level, TextMessage


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
    assert caught.value.refused == {"speed_slider_mask": RtdeErrorReason.IN_USE}
    assert caught.value.reason is RtdeErrorReason.IN_USE
    await client.connect()
    with pytest.raises(SetupError, match="actual_w") as caught:
        await client.setup(["timestamp", "actual_w", "actual_q", "actual_v"], 500.0)
    assert caught.value.refused == {"actual_w": RtdeErrorReason.NOT_FOUND, "actual_v": RtdeErrorReason.NOT_FOUND}
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
    assert caught.value.reason is RtdeErrorReason.TIMEOUT
    assert not client.ready
    assert listener.lost == []
    await until(lambda: not robot.clients)


async def test_a_start_without_data_is_an_error(robot: RtdeResponder, listener: Listener) -> None:
    client = listener.client(robot.host, robot.port, timeout_s=0.05)
    await client.connect()
    await client.setup(OUTPUT_NAMES, 500.0)
    with pytest.raises(LinkError, match="DATA") as caught:
        await client.start()
    assert caught.value.reason is RtdeErrorReason.TIMEOUT
    assert not client.ready


async def test_a_controller_that_says_no_is_heard(robot: RtdeResponder, listener: Listener) -> None:
    client = listener.client(robot.host, robot.port)
    robot.speaks = False
    with pytest.raises(LinkError, match="version 2") as caught:
        await client.connect()
    assert caught.value.reason is RtdeErrorReason.REFUSED
    robot.speaks, robot.starts = True, False
    await client.connect()
    await client.setup(OUTPUT_NAMES, 500.0)
    with pytest.raises(LinkError, match="start") as caught:
        await client.start()
    assert caught.value.reason is RtdeErrorReason.REFUSED


async def test_nobody_there_is_unreachable_and_says_where(listener: Listener) -> None:
    async with RtdeResponder() as gone:
        pass
    with pytest.raises(LinkError, match=f"{gone.host}:{gone.port}") as caught:
        await listener.client(gone.host, gone.port).connect()
    assert caught.value.reason is RtdeErrorReason.UNREACHABLE
    with pytest.raises(LinkError, match="connect first"):
        await listener.client(gone.host, gone.port).start()


async def test_a_controller_that_does_not_take_the_connection_ends_it_in_time(listener: Listener) -> None:
    with (
        socket.create_server(("127.0.0.23", 0), backlog=0) as full,
        socket.create_connection(full.getsockname()),
        pytest.raises(LinkError, match=r"no connection in 0\.05 s") as caught,
    ):
        await listener.client(*full.getsockname(), timeout_s=0.05).connect()
    assert caught.value.reason is RtdeErrorReason.TIMEOUT


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
    assert caught.value.reason is RtdeErrorReason.CLOSED
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
