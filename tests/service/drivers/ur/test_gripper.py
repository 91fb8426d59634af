import asyncio
import contextlib
import random
from collections.abc import AsyncIterator

import pytest

from service.drivers.ur.gripper import Detection, Gripper, GripperError, GripperErrorReason
from sim_backend.ur_controller import gripper_server
from sim_backend.ur_controller.gripper_server import GripperService
from sim_backend.ur_controller.listener import Listener
from tests.fault_proxy import FaultProxy, chunked

HOST = "127.0.0.25"


@contextlib.asynccontextmanager
async def served(mechanism: gripper_server.Gripper) -> AsyncIterator[Gripper]:
    """A driver of these fingers; their time runs as fast as it can."""
    listener = Listener()
    port = listener.serve(GripperService(mechanism), HOST, 0)

    async def step() -> None:
        while True:
            listener.poll()
            listener.publish()
            await asyncio.sleep(0)

    stepping = asyncio.create_task(step())
    try:
        async with Gripper(HOST, port) as driver:
            yield driver
    finally:
        stepping.cancel()
        listener.close()


async def test_it_opens_and_closes_on_an_object() -> None:
    mechanism = gripper_server.Gripper(None)
    async with served(mechanism) as gripper:
        opened = await gripper.open()
        assert not opened.holds_object
        assert opened.opening_mm == mechanism.opening_mm == 85.0

        mechanism.object_mm = 40.0
        closed = await gripper.close(speed_mm_s=150.0, force_n=235.0)

        assert closed.detection == Detection.OBJECT_CLOSING
        assert closed.holds_object
        assert closed.opening_mm == pytest.approx(40.0, abs=0.2)
        assert mechanism.force_n == 235.0


async def test_it_moves_to_an_opening_in_mm() -> None:
    mechanism = gripper_server.Gripper(None)
    async with served(mechanism) as gripper:
        status = await gripper.move(50.0)

        assert mechanism.opening_mm == pytest.approx(50.0, abs=0.2)
        assert status.opening_mm == pytest.approx(50.0, abs=0.2)
        assert not status.is_moving


async def test_an_active_gripper_is_not_activated_again_and_keeps_what_it_holds() -> None:
    mechanism = gripper_server.Gripper()
    async with served(mechanism) as gripper:
        status = await gripper.activate()

        assert status.holds_object
        assert mechanism.opening_mm == gripper_server.PEG_WIDTH_MM


async def test_it_must_be_activated_before_it_moves() -> None:
    async with served(gripper_server.Gripper(None, is_active=False)) as gripper:
        with pytest.raises(GripperError, match="activate it") as raised:
            await gripper.open()
        assert raised.value.reason is GripperErrorReason.NOT_ACTIVE

        assert (await gripper.activate()).is_active
        assert (await gripper.move(20.0)).opening_mm == pytest.approx(20.0, abs=0.2)


async def test_a_released_gripper_says_so() -> None:
    mechanism = gripper_server.Gripper(None)
    async with served(mechanism) as gripper:
        mechanism.set("ATR", 1)
        with pytest.raises(GripperError, match=r"fault 1[15]") as raised:
            await gripper.close()
        assert raised.value.reason is GripperErrorReason.FAULT
        assert (await gripper.activate()).fault == 0


@pytest.mark.parametrize(
    ("opening_mm", "speed_mm_s", "force_n"),
    [(-1.0, 150.0, 20.0), (86.0, 150.0, 20.0), (10.0, 10.0, 20.0), (10.0, 150.0, 300.0), (float("nan"), 150.0, 20.0)],
)
async def test_what_a_2f_85_cannot_do_is_not_sent(opening_mm: float, speed_mm_s: float, force_n: float) -> None:
    mechanism = gripper_server.Gripper(None)
    async with served(mechanism) as gripper:
        with pytest.raises(ValueError, match="2F-85 takes"):
            await gripper.move(opening_mm, speed_mm_s, force_n)
        assert mechanism.get("PRE") == 255


async def test_no_server_is_named() -> None:
    with pytest.raises(GripperError, match=r"cannot reach the gripper at 127\.0\.0\.25:9"):
        await Gripper(HOST, 9).connect()


async def test_a_server_that_goes_is_named() -> None:
    async def hang_up(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.close()

    async with await asyncio.start_server(hang_up, HOST, 0) as server:
        port = server.sockets[0].getsockname()[1]
        async with Gripper(HOST, port) as gripper:
            with pytest.raises(GripperError, match="connection broke") as raised:
                await gripper.status()
    assert raised.value.reason is GripperErrorReason.LOST


async def test_a_connection_that_is_reset_is_lost_and_can_be_made_again() -> None:
    async with served(gripper_server.Gripper(None)) as direct, FaultProxy((HOST, direct.port), HOST) as proxy:
        proxy.to_client.spoil = chunked(random.Random(0), 2)
        async with Gripper(proxy.host, proxy.port) as gripper:
            assert (await gripper.open()).opening_mm == 85.0
            await proxy.reset()
            with pytest.raises(GripperError) as raised:
                await gripper.status()
            assert raised.value.reason is GripperErrorReason.LOST

            await gripper.connect()
            assert (await gripper.status()).opening_mm == 85.0
