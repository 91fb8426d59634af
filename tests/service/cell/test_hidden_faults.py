"""Faults that hide: behind a zeroed sensor, a slow disk, a link that comes and goes, an arm that does not obey."""

import asyncio
import os
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from service.cell import watch
from service.cell.inference import InlineInference, OnAction, OnFailure
from service.cell.journal import Journal
from service.cell.path import StraightPath
from service.cell.tick_record import TickRecord
from service.drivers.base import DriverError, PoseTarget, Program, SampleSink
from service.faults import FaultCode
from service.messages import (
    CellState,
    Event,
    RefusalReason,
    Refused,
    ResetRequest,
    RunResult,
    RunState,
    StartRequest,
    StatusResult,
    StopRequest,
    Telemetry,
)
from service.policy.model import Policy
from service.testing import RECIPE, Bench, cell_config, lockstep_cell
from sim_backend.zenoh_cell.cell import SimulatedCell
from tests.service.cell import policies
from tests.service.cell.conftest import EASY, FaultyCell
from tests.service.cell.faulty_driver import FaultyDriver, Wrapping, with_wrench
from wire.task import Task


class LoadedCell(SimulatedCell):
    """A world in which something has leaned on the tool since long before the run: the sensor carries it."""

    def __init__(self, load: Sequence[float]) -> None:
        super().__init__("tr")
        self._load = np.array(load)

    def reset(self, task: Task) -> np.ndarray:
        answer = super().reset(task)
        sensor = self._world.sensor
        sensor._bias[0] += self._load
        sensor._average[0] += self._load
        return answer


@pytest.mark.parametrize("load", [(20.0, 0, 0, 0, 0, 0), (0, 0, -22.0, 0, 0, 0), (0, 0, 0, 0, 0, 3.0)])
async def test_09_a_load_that_was_there_before_the_run_is_not_zeroed_away_contact_at_start(
    tmp_path: Path, load: Sequence[float]
) -> None:
    wrap = Wrapping(FaultyDriver)
    config = cell_config(tmp_path / "state", policies.straight(tmp_path), conditions="easy")
    async with lockstep_cell(config, wrap=wrap, world=LoadedCell(load)) as bench:
        run = await bench.insert(EASY)
        assert (run.state, run.code) == (RunState.FAILED, FaultCode.CONTACT_AT_START)
        assert "before zeroing" in run.text
        assert wrap.driver.said("zero_ft") == wrap.driver.said("engage") == []


async def test_a_sensor_is_zeroed_only_while_the_arm_stands_and_rests(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        faulty.driver.spoil = lambda sample: [replace(sample, program=Program.STOPPING)]
        run = await faulty.bench.insert(EASY)
        assert (run.state, run.code) == (RunState.LATCHED, FaultCode.STOP_UNCONFIRMED)
        assert faulty.driver.said("zero_ft") == faulty.driver.said("engage") == []


async def test_a_latch_that_cannot_be_written_is_shown_holds_and_is_written_later(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        bench, obstacle = faulty.bench, faulty.state_dir / "latch.tmp"
        run = await faulty.running()
        obstacle.mkdir()
        bench.cell.stop(StopRequest())
        await faulty.assert_latched(run, FaultCode.OPERATOR_STOP)
        await bench.until(lambda: bench.cell.journal.fault is not None)
        assert "state directory" in bench.cell.status().degradations[-1]
        answer = await bench.cell.reset(ResetRequest())
        assert isinstance(answer, Refused)
        assert answer.problem.reason is RefusalReason.STORAGE
        obstacle.rmdir()
        async with asyncio.timeout(10.0):
            while bench.cell.journal.fault is not None:
                await asyncio.sleep(0.01)
        assert FaultCode.OPERATOR_STOP in (faulty.state_dir / "latch.json").read_text()
        assert bench.cell.status().degradations == ()
        assert isinstance(await bench.cell.reset(ResetRequest()), StatusResult)


class Connecting(FaultyDriver):
    """Samples flow at once, and connecting ends when the test says so."""

    hold = False
    fail = False

    async def connect(self, sink: SampleSink) -> None:
        await super().connect(sink)
        while self.hold:
            await asyncio.sleep(0)
        if self.fail:
            raise DriverError(FaultCode.LINK, "no answer")


@asynccontextmanager
async def connecting_cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[tuple[Bench, Connecting]]:
    monkeypatch.setattr(watch, "RECONNECT_S", 0.01)
    wrap = Wrapping(Connecting)
    config = cell_config(tmp_path / "state", policies.straight(tmp_path), conditions="easy")
    async with lockstep_cell(config, wrap=wrap) as bench:
        wrap.driver.real_time = True
        await bench.state(CellState.READY)
        yield bench, wrap.driver


async def test_while_connecting_samples_of_a_source_not_yet_believed_make_nothing_ready(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with connecting_cell(tmp_path, monkeypatch) as (bench, driver):
        driver.hold = driver.fail = True
        driver.on_link_fault(FaultCode.LINK, "a command could not be sent")
        await bench.let_pass(0.3)
        assert bench.cell.state in (CellState.OFFLINE, CellState.CONNECTING)
        assert not bench.cell.status().can_start
        assert isinstance(await bench.cell.start(StartRequest(recipe=RECIPE, seed=EASY)), Refused)
        driver.hold = driver.fail = False
        await bench.state(CellState.READY)


async def test_a_simulator_that_was_restarted_is_ready_again_by_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with connecting_cell(tmp_path, monkeypatch) as (bench, driver):
        driver.hold, driver.spoil = True, lambda sample: []
        await bench.state(CellState.CONNECTING)
        driver.spoil = lambda sample: [replace(sample, epoch=sample.epoch + 1)]
        await bench.let_pass(0.1)
        driver.hold = False
        await bench.state(CellState.READY, limit_s=20.0)
        assert bench.cell.status().can_start


async def test_a_link_that_is_made_anew_under_a_run_ends_it_link(faulty_cell: FaultyCell) -> None:
    async with faulty_cell(force_ceiling_n=20.0) as faulty:
        run = await faulty.running()
        faulty.bench.cell.linked()
        await faulty.assert_latched(run, FaultCode.LINK)


async def test_an_arm_that_stays_engaged_is_stopped_again_and_again_and_no_reset_is_granted(
    faulty_cell: FaultyCell, tmp_path: Path
) -> None:
    async with faulty_cell(policies.still(tmp_path)) as faulty:
        bench, driver = faulty.bench, faulty.driver
        driver.deaf_to_stop = True
        await bench.start(EASY)
        await bench.state(CellState.APPROACH)
        await bench.let_pass(0.1)
        bench.cell.stop(StopRequest())
        await bench.state(CellState.LATCHED)
        await bench.let_pass(1.0)
        asked = len(driver.said("stop"))
        await bench.let_pass(0.5)
        assert len(driver.said("stop")) - asked >= 40
        assert driver.truth.program is Program.ENGAGED
        answer = await bench.cell.reset(ResetRequest())
        assert isinstance(answer, Refused)
        assert bench.cell.state is CellState.LATCHED
        driver.deaf_to_stop = False
        await bench.until(lambda: driver.truth.program is Program.IDLE)
        assert isinstance(await bench.cell.reset(ResetRequest()), StatusResult)


class Preparing(FaultyDriver):
    """Takes its time to lay out a world; samples go on meanwhile."""

    async def prepare(self, task: Task | None) -> None:
        end = self.clock() + 3.0
        while self.clock() < end:
            await asyncio.sleep(0)
        await super().prepare(task)


@asynccontextmanager
async def preparing_cell(tmp_path: Path) -> AsyncIterator[tuple[Bench, Preparing]]:
    wrap = Wrapping(Preparing)
    config = cell_config(tmp_path / "state", policies.straight(tmp_path), conditions="easy")
    async with lockstep_cell(config, wrap=wrap) as bench:
        await bench.state(CellState.READY)
        await bench.start(EASY)
        await bench.let_pass(0.1)
        yield bench, wrap.driver


async def test_a_force_at_the_ceiling_latches_while_the_world_is_prepared_too_force_ceiling(tmp_path: Path) -> None:
    async with preparing_cell(tmp_path) as (bench, driver):
        driver.spoil = lambda sample: [with_wrench(sample, fx=60.0)]
        await bench.let_pass(0.01)
        driver.spoil = lambda sample: [sample]
        await bench.state(CellState.LATCHED, limit_s=1.0)
        assert bench.cell.journal.latch.code is FaultCode.FORCE_CEILING
        assert driver.said("stop")


async def test_the_ceiling_that_is_shown_is_the_one_in_force(tmp_path: Path) -> None:
    wrap = Wrapping(Preparing)
    policy = policies.still(tmp_path)
    config = cell_config(tmp_path / "state", policy, conditions="easy", force_ceiling_n=20.0, max_steps=1)
    async with lockstep_cell(config, wrap=wrap) as bench:
        await bench.insert(EASY)
        assert bench.cell.status().force_ceiling_n == 20.0
        await bench.start(EASY)
        await bench.let_pass(0.1)
        assert bench.cell.status().force_ceiling_n == 20.0, "while the next world is prepared"
        wrap.driver.spoil = lambda sample: [with_wrench(sample, fx=25.0)]
        await bench.let_pass(0.01)
        wrap.driver.spoil = lambda sample: [sample]
        await bench.state(CellState.LATCHED, limit_s=1.0)
        assert bench.cell.journal.latch.code is FaultCode.FORCE_CEILING


async def test_a_stop_is_confirmed_while_the_world_is_still_being_prepared(tmp_path: Path) -> None:
    async with preparing_cell(tmp_path) as (bench, driver):
        at = driver.clock()
        bench.cell.stop(StopRequest())
        await bench.state(CellState.LATCHED, limit_s=1.0)
        assert driver.clock() - at < bench.cell.config.limits.stop_confirm_s
        assert bench.cell.journal.latch.code is FaultCode.OPERATOR_STOP
        await bench.let_pass(4.0)
        assert bench.cell.state is CellState.LATCHED
        assert driver.said("engage") == []


async def test_a_clock_of_the_arm_that_stands_is_stale_though_samples_go_on(faulty_cell: FaultyCell) -> None:
    async with faulty_cell(real_time=True) as faulty:
        run = await faulty.running()
        stamp = faulty.driver.truth.time_s
        faulty.driver.spoil = lambda sample: [replace(sample, time_s=stamp)]
        await faulty.bench.until(lambda: faulty.bench.cell.journal.latch is not None, 0.1)
        faulty.driver.spoil = lambda sample: [sample]
        await faulty.assert_latched(run, FaultCode.STALE)


async def test_an_absurd_velocity_latches_and_can_still_be_shown(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        run = await faulty.running()
        absurd = np.array([1e200, 0.0, 0.0, 0.0, 0.0, 0.0])
        faulty.driver.spoil = lambda sample: [replace(sample, tcp_velocity=absurd)]
        await faulty.bench.state(CellState.STOPPING)
        assert faulty.bench.cell.status().state is CellState.STOPPING
        faulty.driver.spoil = lambda sample: [sample]
        await faulty.assert_latched(run, FaultCode.SENSOR_INVALID)


class LaterInference:
    """Answers in a later turn of the loop, as a thread would, but at a time that the simulation fixes."""

    def __init__(self, policy: Policy, on_action: OnAction, on_failure: OnFailure) -> None:
        self._inner = InlineInference(policy, self._answer, on_failure)
        self._on_action = on_action
        self._closed = False

    def ask(self, observation: np.ndarray) -> None:
        self._inner.ask(observation)

    def close(self) -> None:
        self._closed = True

    def _answer(self, action: np.ndarray) -> None:
        asyncio.get_running_loop().call_soon(lambda: None if self._closed else self._on_action(action))


async def test_an_error_of_ours_after_an_answer_from_elsewhere_latches_internal(
    faulty_cell: FaultyCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with faulty_cell(inference=LaterInference) as faulty:
        run = await faulty.running()

        def fail(*_: object) -> None:
            raise ZeroDivisionError("ours")

        monkeypatch.setattr("service.safety.seating.Seating.observe", fail)
        ended = await faulty.assert_latched(run, FaultCode.INTERNAL)
        assert "ZeroDivisionError" in ended.text


async def test_nothing_is_told_between_a_question_to_the_policy_and_the_next_sample(
    faulty_cell: FaultyCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.cell.cell.TELEMETRY_TICKS", 1)
    async with faulty_cell(inference=LaterInference) as faulty:
        await faulty.running()
        records, points = faulty.bench.records, faulty.bench.telemetry
        before = len(records)
        await faulty.bench.until(lambda: len(records) >= before + 3)
        asked = {record.sample.time_s for record in records[before:]}
        told = {point.t for point in points}
        assert not asked & told
        assert {round((at - 0.002) / 0.002) for at in asked} <= {round(at / 0.002) for at in told}


async def test_an_observer_that_fails_costs_nobody_else_anything(faulty_cell: FaultyCell) -> None:
    class Broken:
        def on_event(self, event: Event) -> None:
            raise RuntimeError("observer")

        def on_telemetry(self, point: Telemetry) -> None:
            raise RuntimeError("observer")

        def on_tick(self, record: TickRecord) -> None:
            raise RuntimeError("observer")

    async with faulty_cell() as faulty:
        faulty.bench.cell.journal.observers.insert(0, Broken())
        run = await faulty.bench.insert(EASY)
        assert run.state is RunState.SUCCEEDED
        assert faulty.bench.events
        assert faulty.bench.telemetry


async def test_a_watch_that_fails_stops_the_run_and_watches_on(
    faulty_cell: FaultyCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with faulty_cell(real_time=True) as faulty:
        run = await faulty.running()
        cell, watched = faulty.bench.cell, list[int]()

        def fail() -> None:
            watched.append(1)
            raise ZeroDivisionError("ours")

        guard = asyncio.create_task(watch.keep_watch(cell))
        await asyncio.sleep(0)
        faulty.driver.real_time = False  # from here on only `keep_watch` watches
        monkeypatch.setattr(cell, "watch", fail)
        await faulty.assert_latched(run, FaultCode.INTERNAL)
        while len(watched) < 3:
            await asyncio.sleep(0.005)
        assert not guard.done()
        guard.cancel()


async def test_a_start_that_the_disk_refused_leaves_no_run_behind(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        bench, ledger = faulty.bench, faulty.bench.cell.journal._ledger
        request = StartRequest(recipe=RECIPE, seed=EASY, idempotency_key="once")
        full, whole = os.open("/dev/full", os.O_WRONLY), os.dup(ledger._file.fileno())
        os.dup2(full, ledger._file.fileno())
        refused = await bench.cell.start(request)
        os.dup2(whole, ledger._file.fileno())
        assert isinstance(refused, Refused)
        assert refused.problem.reason is RefusalReason.STORAGE
        assert ledger.newest(10) == ()
        async with asyncio.timeout(10.0):
            while bench.cell.journal.fault is not None:
                await asyncio.sleep(0.01)
        accepted = await bench.cell.start(request)
        assert isinstance(accepted, RunResult)
        assert accepted.created, "it is a start, not the run that never was"
        bench.cell.stop(StopRequest())
        await bench.state(CellState.LATCHED)
    journal = Journal(faulty.state_dir, lambda: 0.0)
    assert [run.id for run in journal.newest(10)] == [accepted.run.id]
    journal.close(5.0)


async def test_no_target_leads_the_arm_by_more_than_its_leash_scripted_or_not(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        driver, cell = faulty.driver, faulty.bench.cell
        leads: dict[CellState, float] = {}
        send = driver.send_target

        def note(target: PoseTarget) -> int:
            lead = float(np.linalg.norm(target.position - driver.truth.tcp_position))
            leads[cell.state] = max(lead, leads.get(cell.state, 0.0))
            return send(target)

        driver.send_target = note
        run = await faulty.bench.insert(EASY)
        assert run.state is RunState.SUCCEEDED
        assert set(leads) == {CellState.APPROACH, CellState.RUNNING, CellState.RETRACT}
        assert max(leads.values()) <= cell.config.limits.max_step_m + 1e-12, leads


async def test_a_target_waits_for_an_arm_that_does_not_come_along() -> None:
    path = StraightPath.plan(np.zeros(3), 0.0, [np.array([0.0, 0.0, 0.1])], 0.1, 0.01, 0.0)
    stuck = np.zeros(3)
    for _ in range(50):
        target = path.advance(stuck, 0.012)
    assert 0.010 < target[2] <= 0.012
    on = path.advance(np.array([0.0, 0.0, 0.005]), 0.012)
    assert on[2] == pytest.approx(target[2] + path.step_m), "and goes on when it does"
