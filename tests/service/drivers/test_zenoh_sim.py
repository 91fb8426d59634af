"""The driver against the simulator's own process, and against a publisher that sends what no simulator would."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import numpy as np
import pytest
import zenoh

from service.drivers.base import DriverError, Load, PoseTarget, Program, Sample
from service.drivers.zenoh_sim import ZenohSimDriver
from service.faults import FaultCode
from service.testing.in_process import InProcessDriver
from sim_backend.zenoh_cell.cell import SimulatedCell
from tests.service.sim_server import free_endpoint, sim_process
from wire import records
from wire.law import ComplianceLaw, ControlLimits
from wire.limits import WORKSPACE_M
from wire.session import close_session, open_session
from wire.task import Task

TASK = Task(7, "tr", 2e-3, "easy")
LAW = ComplianceLaw((1000.0,) * 3 + (20.0,) * 3, (200.0,) * 3 + (2.0,) * 3, (2.0,) * 3 + (0.05,) * 3)
LIMITS = ControlLimits(WORKSPACE_M, 30.0, (0.1, 1.0), (0.012, 0.3), 0.5)


class Sink:
    def __init__(self) -> None:
        self.samples: list[Sample] = []
        self.faults: list[tuple[FaultCode, str]] = []
        self.stop_at_once = False
        self.is_broken = False

    def overloads(self, load: Load) -> bool:
        if self.is_broken:
            raise LookupError("broken")
        stop_at_once, self.stop_at_once = self.stop_at_once, False
        return stop_at_once

    def on_sample(self, sample: Sample) -> None:
        self.samples.append(sample)

    def on_link_fault(self, code: FaultCode, text: str) -> None:
        self.faults.append((code, text))


async def until(condition: Callable[[], object], seconds: float = 20.0) -> None:
    async with asyncio.timeout(seconds):
        while not condition():
            await asyncio.sleep(0.002)


@asynccontextmanager
async def connected(endpoint: str, mode: str) -> AsyncIterator[tuple[ZenohSimDriver, Sink]]:
    driver, sink = ZenohSimDriver("world-1", [endpoint], mode), Sink()
    try:
        await driver.connect(sink)
        yield driver, sink
    finally:
        await driver.close()


@pytest.mark.parametrize("mode", ["real_time", "lockstep"])
async def test_an_arm_is_prepared_engaged_moved_and_stopped(mode: str) -> None:
    endpoint = free_endpoint()
    with sim_process(endpoint, mode.replace("_", "-")):
        async with connected(endpoint, mode) as (driver, sink):
            await driver.prepare(TASK)
            await until(lambda: sink.samples)
            start = sink.samples[-1]
            driver.engage(LAW, LIMITS)
            await until(lambda: sink.samples[-1].program is Program.ENGAGED)
            target = PoseTarget(start.tcp_position + np.array([0.0, 0.0, 0.01]), start.tcp_rotvec)
            seq = driver.send_target(target)
            await until(lambda: sink.samples[-1].command_seq == seq)
            await until(lambda: sink.samples[-1].tcp_position[2] > start.tcp_position[2] + 0.005)
            driver.stop()
            driver.stop()
            await until(lambda: sink.samples[-1].program is Program.IDLE)
            assert sink.faults == []


async def test_no_order_of_a_run_follows_a_stop_from_the_transports_thread() -> None:
    endpoint = free_endpoint()
    with sim_process(endpoint):
        async with connected(endpoint, "real_time") as (driver, sink):
            await driver.prepare(TASK)
            driver.engage(LAW, LIMITS)
            await until(lambda: sink.samples[-1].program is Program.ENGAGED)
            sink.stop_at_once = True
            await until(lambda: sink.samples[-1].program is Program.IDLE)
            stopped = sink.samples[-1]
            for _ in range(5):
                driver.engage(LAW, LIMITS)
                driver.send_target(PoseTarget(stopped.tcp_position + np.array([0.0, 0.0, 0.01]), stopped.tcp_rotvec))
            await until(lambda: sink.samples[-1].seq > stopped.seq + 100)
            assert {one.program for one in sink.samples if one.seq > stopped.seq} == {Program.IDLE}
            await driver.prepare(TASK)
            driver.engage(LAW, LIMITS)
            await until(lambda: sink.samples[-1].program is Program.ENGAGED)
            assert sink.faults == []


async def test_a_judgement_that_fails_on_the_transports_thread_is_a_fault_and_the_sample_goes_on_to_the_loop() -> None:
    endpoint = free_endpoint()
    with sim_process(endpoint):
        async with connected(endpoint, "real_time") as (_, sink):
            await until(lambda: sink.samples)
            sink.is_broken = True
            await until(lambda: sink.faults)
            assert sink.faults[0] == (FaultCode.INTERNAL, "LookupError: broken")
            seen = sink.samples[-1].seq
            await until(lambda: sink.samples[-1].seq > seen + 10)


async def test_lockstep_delivers_every_tick_once_and_time_is_the_worlds() -> None:
    endpoint = free_endpoint()
    with sim_process(endpoint, "lockstep"):
        async with connected(endpoint, "lockstep") as (driver, sink):
            await until(lambda: len(sink.samples) > 100)
            assert (np.diff([sample.seq for sample in sink.samples]) == 1).all()
            assert sink.samples[-1].arrival_s == driver.clock()
            assert np.allclose(np.diff([sample.arrival_s for sample in sink.samples]), records.TICK_S)


async def test_the_same_seed_is_the_same_world_with_transport_and_without() -> None:
    endpoint = free_endpoint()
    near = Sink()
    inside = InProcessDriver(SimulatedCell("tr"))
    await inside.connect(near)
    await inside.prepare(TASK)
    await until(lambda: len(near.samples) > 20)
    await inside.close()
    with sim_process(endpoint, "lockstep"):
        async with connected(endpoint, "lockstep") as (driver, far):
            await driver.prepare(TASK)
            first = far.samples[-1]
            twin = next(sample for sample in near.samples if sample.episode == near.samples[-1].episode)
            assert first.hole_estimate is not None
            assert twin.hole_estimate is not None
            assert np.abs(first.hole_estimate - twin.hole_estimate).max() < 2e-3
            await until(lambda: far.samples[-1].seq > first.seq + 5)


async def test_a_driver_without_a_simulator_says_what_to_do() -> None:
    with pytest.raises(DriverError, match="does not answer: is `dsl-assembly sim serve` running") as error:
        async with connected(free_endpoint(), "real_time"):
            pass
    assert error.value.code is FaultCode.LINK


async def test_a_world_in_the_other_mode_is_refused() -> None:
    endpoint = free_endpoint()
    with sim_process(endpoint, "lockstep"):
        with pytest.raises(DriverError, match=r"runs in lockstep.*change sim\.mode") as error:
            async with connected(endpoint, "real_time"):
                pass
        assert error.value.code is FaultCode.PROTOCOL


async def test_a_world_that_cannot_be_laid_out_is_refused_by_the_fields_name() -> None:
    endpoint = free_endpoint()
    with sim_process(endpoint):
        async with connected(endpoint, "real_time") as (driver, _):
            with pytest.raises(DriverError, match=r"task\.part") as error:
                await driver.prepare(Task(1, "star", 2e-3, "easy"))
            assert error.value.code is FaultCode.PROTOCOL


def state(**fields: object) -> bytes:
    record = records.new(records.STATE, records.Kind.STATE)
    for name, value in fields.items():
        record[name] = value
    return record.tobytes()


@pytest.fixture
def impostor() -> AsyncIterator[tuple[str, zenoh.Session]]:
    """A session that answers `info` and claims like a simulator; the test publishes through it."""
    endpoint = free_endpoint()
    session = open_session(listen=[endpoint])
    info = b'{"version": %d, "mode": "real-time", "epoch": 5, "tick_s": 0.002, "part": "tr"}' % records.VERSION

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply("sim/world-1/info", info)

    def grant(query: zenoh.Query) -> None:
        with query:
            query.reply("sim/world-1/claim", b'{"client": 5, "refused": 0}')

    session.declare_queryable("sim/world-1/info", answer)
    session.declare_queryable("sim/world-1/claim", grant)
    yield endpoint, session
    close_session(session)


@pytest.mark.parametrize(
    ("payload", "says"),
    [
        (b"", "0 bytes"),
        (state()[:-1], "511 bytes are not one state"),
        (b"\xff" * records.STATE.itemsize, "wrong magic"),
        (state(version=99), "schema version 99"),
        (state(kind=records.Kind.STOP), "kind 4 on a state key"),
        (state(program=77), "77 is not a valid Program"),
        (state() * 2, "1024 bytes are not one state"),
    ],
    ids=["empty", "half", "garbage", "version", "kind", "enumeration", "two"],
)
async def test_15_what_is_no_state_is_a_protocol_fault_and_the_driver_goes_on(
    impostor: tuple[str, zenoh.Session], payload: bytes, says: str
) -> None:
    endpoint, session = impostor
    async with connected(endpoint, "real_time") as (_, sink):
        await until(lambda: session.put("sim/world-1/state", state(epoch=5, seq=1)) or sink.samples)
        session.put("sim/world-1/state", payload)
        await until(lambda: sink.faults)
        assert sink.faults[0][0] is FaultCode.PROTOCOL
        assert says in sink.faults[0][1]
        count = len(sink.samples)
        session.put("sim/world-1/state", state(epoch=5, seq=2))
        await until(lambda: len(sink.samples) > count)


async def test_an_answer_to_info_that_cannot_be_read_is_refused() -> None:
    endpoint = free_endpoint()
    session = open_session(listen=[endpoint])
    session.declare_queryable("sim/world-1/info", lambda query: query.reply("sim/world-1/info", b"{}") or query.drop())
    try:
        with pytest.raises(DriverError, match="cannot be read"):
            async with connected(endpoint, "real_time"):
                pass
    finally:
        close_session(session)


async def test_22_two_worlds_of_one_name_are_refused() -> None:
    endpoint = free_endpoint()
    info = b'{"version": %d, "mode": "real-time", "epoch": 5}' % records.VERSION
    first, second = open_session(listen=[endpoint]), open_session(connect=[endpoint])

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply("sim/world-1/info", info)

    first.declare_queryable("sim/world-1/info", answer)
    other = free_endpoint()
    third = open_session(listen=[other])
    third.declare_queryable("sim/world-1/info", answer)
    driver = ZenohSimDriver("world-1", [endpoint, other], "real_time")
    try:
        with pytest.raises(DriverError, match="2 worlds answer") as error:
            await driver.connect(Sink())
        assert error.value.code is FaultCode.SOURCE
    finally:
        await driver.close()
        for session in (first, second, third):
            close_session(session)
