"""The camera and the world setup over Zenoh, against an emulated controller's surroundings."""

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager

import numpy as np
import pytest
import zenoh

from service.drivers.base import DriverError
from service.drivers.camera import ZenohCamera
from service.drivers.world_setup import ZenohWorldSetup
from service.faults import FaultCode
from tests.service.sim_server import free_endpoint
from wire import keys, records
from wire.session import close_session, open_session
from wire.task import Task

KEY = keys.CAMERA.format(world="w")
TASK = Task(7, "tr", 2e-3, "easy")


@contextmanager
def listening(endpoint: str) -> Iterator[zenoh.Session]:
    session = open_session(listen=[endpoint])
    try:
        yield session
    finally:
        close_session(session)


@asynccontextmanager
async def watching(clock: Callable[[], float]) -> AsyncIterator[tuple[zenoh.Session, ZenohCamera]]:
    endpoint = free_endpoint()
    camera = ZenohCamera(endpoint, KEY, 0.2, clock)
    assert camera.estimate(clock()) is None
    with listening(endpoint) as session:
        await camera.open()
        try:
            yield session, camera
        finally:
            await camera.close()


def frame(position: tuple[float, float, float], episode: int = 4, time_s: float = 61.5, epoch: int = 0) -> bytes:
    record = records.new(records.CAMERA, records.Kind.CAMERA)
    record[0]["epoch"] = epoch
    record[0]["episode"], record[0]["position"], record[0]["time_s"] = episode, position, time_s
    return record.tobytes()


async def publish_until(session: zenoh.Session, payload: bytes, condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(10.0):
        while not condition():
            session.put(KEY, payload)
            await asyncio.sleep(0.02)


async def test_the_newest_estimate_counts_until_it_is_too_old() -> None:
    now = 100.0
    async with watching(lambda: now) as (session, camera):
        await publish_until(session, frame((0.3, -0.1, 0.08)), lambda: camera.estimate(now) is not None)
        assert camera.estimate(now) == pytest.approx([0.3, -0.1, 0.08])
        assert camera.episode == 4
        assert camera.estimate(now + 0.19) is not None
        assert camera.estimate(now + 0.21) is None
        now = 101.0
        newer = frame((0.31, -0.1, 0.08), episode=5)
        await publish_until(session, newer, lambda: camera.episode == 5)
        assert camera.estimate(now) == pytest.approx([0.31, -0.1, 0.08])


async def test_a_frame_that_is_no_number_is_no_estimate_and_one_that_cannot_be_read_is_ignored() -> None:
    async with watching(lambda: 0.0) as (session, camera):
        await publish_until(session, frame((0.3, -0.1, 0.08)), lambda: camera.estimate(0.0) is not None)
        for _ in range(5):
            session.put(KEY, b"not a frame")
        await asyncio.sleep(0.1)
        assert camera.estimate(0.0) == pytest.approx([0.3, -0.1, 0.08])
        blind = frame((np.nan, 0.0, 0.0), time_s=61.6)
        await publish_until(session, blind, lambda: camera.estimate(0.0) is None)


async def test_a_frame_that_comes_again_and_again_grows_old_all_the_same() -> None:
    """The camera hangs, its publisher does not."""
    now = 100.0
    async with watching(lambda: now) as (session, camera):
        await publish_until(session, frame((0.3, -0.1, 0.08)), lambda: camera.estimate(now) is not None)
        now = 100.3
        for time_s in (61.5, 61.5, 61.4):
            session.put(KEY, frame((0.3, -0.1, 0.08), time_s=time_s))
        await asyncio.sleep(0.2)
        assert camera.estimate(now) is None
        newer = frame((0.3, -0.1, 0.08), time_s=61.6)
        await publish_until(session, newer, lambda: camera.estimate(now) is not None)


async def test_two_cameras_under_one_key_are_none_until_one_is_silent() -> None:
    now = 100.0
    async with watching(lambda: now) as (session, camera):
        ours, other = frame((0.3, -0.1, 0.08), epoch=7), frame((0.35, -0.1, 0.08), epoch=8, time_s=90.0)
        await publish_until(session, ours, lambda: camera.estimate(now) is not None)
        await publish_until(session, other, lambda: camera.estimate(now) is None)
        session.put(KEY, frame((0.3, -0.1, 0.08), epoch=7, time_s=61.6))
        await asyncio.sleep(0.1)
        assert camera.estimate(now) is None
        now = 100.3
        await publish_until(session, other, lambda: camera.estimate(now) is not None)
        assert camera.estimate(now) == pytest.approx([0.35, -0.1, 0.08])


async def laid_out_by(answer: Callable[[zenoh.Query], None]) -> object:
    endpoint = free_endpoint()
    with listening(endpoint) as session:
        session.declare_queryable(keys.RESET.format(world="w"), answer)
        session.declare_queryable(
            keys.CLAIM.format(world="w"),
            lambda query: query.reply(query.key_expr, b'{"client": 5, "refused": 0}') or query.drop(),
        )
        setup = ZenohWorldSetup("w", [endpoint])
        await setup.open()
        try:
            for _ in range(50):
                try:
                    return await setup.lay_out(TASK)
                except DriverError as error:
                    if error.code is not FaultCode.LINK:
                        raise
                    await asyncio.sleep(0.02)
        finally:
            await setup.close()
    raise AssertionError("nobody answered")


async def test_a_world_is_laid_out_as_the_run_wants_it() -> None:
    asked = []

    def answer(query: zenoh.Query) -> None:
        asked.append(query.payload.to_string())
        query.reply(query.key_expr, frame((0.3, -0.1, 0.08), episode=9))

    laid_out = await laid_out_by(answer)
    assert (laid_out.episode, laid_out.time_s) == (9, 61.5)
    assert '"seed": 7' in asked[0]
    assert '"conditions": "easy"' in asked[0]


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        (lambda query: query.reply_err(b"no such part"), "no such part"),
        (lambda query: query.reply(query.key_expr, b"nonsense"), "bytes"),
    ],
)
async def test_a_world_that_is_refused_or_answers_nonsense_is_a_driver_error(answer, text: str) -> None:
    with pytest.raises(DriverError, match=text) as refused:
        await laid_out_by(answer)
    assert refused.value.code is FaultCode.PROTOCOL


async def test_a_world_setup_that_was_not_opened_says_so() -> None:
    with pytest.raises(DriverError, match="not connected"):
        await ZenohWorldSetup("w", ["tcp/127.0.0.1:1"]).lay_out(TASK)
