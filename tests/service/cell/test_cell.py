"""Requests of people to a cell, and a run in which nothing goes wrong."""

import asyncio
from pathlib import Path

import numpy as np
import pytest

from service.cell.tick_record import TickRecord
from service.drivers.base import Program, Sample
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
from service.testing import RECIPE, Bench, SimulatedCellFactory
from tests.service.cell import policies
from tests.service.cell.conftest import EASY, FaultyCell
from tests.service.cell.faulty_driver import speed, with_wrench


async def test_a_peg_goes_in_and_the_run_says_how_deep_and_how_hard(
    simulated_cell: SimulatedCellFactory, tmp_path: Path
) -> None:
    async with simulated_cell(policies.straight(tmp_path), conditions="easy") as bench:
        depths: list[float] = []

        class Truth:
            def on_tick(self, record: TickRecord) -> None:
                depths.append(bench.world.truth()["depth"])

            def on_event(self, event: Event) -> None: ...

            def on_telemetry(self, point: Telemetry) -> None: ...

        bench.cell.journal.observers.append(Truth())
        run = await bench.insert(EASY)
        assert (run.state, run.code) == (RunState.SUCCEEDED, None)
        assert max(depths) > 2.5e-3, "it went in by the world's own measure too"
        assert run.depth_m is not None
        assert run.depth_m > 3e-3
        assert 0.0 < run.peak_force_n < 30.0
        assert run.steps == len(bench.records)
        assert bench.cell.state is CellState.READY
        sample = bench.cell.newest_sample
        assert sample is not None
        assert sample.program is Program.IDLE
        assert speed(sample) < 2e-3
        assert bench.world.truth()["depth"] < -0.02, "retracted to the hover"


async def test_a_run_goes_through_the_states_in_their_order(
    simulated_cell: SimulatedCellFactory, tmp_path: Path
) -> None:
    async with simulated_cell(policies.straight(tmp_path), conditions="easy") as bench:
        await bench.insert(EASY)
        states = [event.state.value for event in bench.events if event.kind == "STATE"]
        assert states[-5:] == ["PREFLIGHT", "APPROACH", "RUNNING", "RETRACT", "READY"]


async def test_the_same_seed_gives_the_same_run_to_the_last_bit(
    simulated_cell: SimulatedCellFactory, tmp_path: Path
) -> None:
    async with simulated_cell(policies.straight(tmp_path), conditions="easy") as bench:
        await bench.insert(EASY)
        first, bench.records = bench.records, []
        await bench.insert(EASY)
        assert len(first) == len(bench.records)
        for one, two in zip(first, bench.records, strict=True):
            assert (one.observation == two.observation).all()
            assert (one.target.position == two.target.position).all()


async def test_one_record_holds_a_whole_step_and_its_parts_agree(
    simulated_cell: SimulatedCellFactory, tmp_path: Path
) -> None:
    async with simulated_cell(policies.straight(tmp_path), conditions="easy") as bench:
        await bench.insert(EASY)
        assert [record.step for record in bench.records] == list(range(len(bench.records)))
        times = [record.sample.time_s for record in bench.records]
        assert np.allclose(np.diff(times), 0.08)
        for record in bench.records:
            assert (record.target.position == record.bounded.position).all()
            assert np.isfinite(record.observation).all()


async def test_without_the_peg_in_the_hole_the_run_fails_retracts_and_latches_nothing(
    simulated_cell: SimulatedCellFactory, tmp_path: Path
) -> None:
    async with simulated_cell(policies.still(tmp_path), conditions="easy", max_steps=20) as bench:
        run = await bench.insert(3)
        assert (run.state, run.code) == (RunState.FAILED, FaultCode.SEARCH_LIMIT)
        assert run.steps == 20
        assert bench.cell.state is CellState.READY
        assert bench.cell.status().can_start


async def test_contact_never_found_search_limit_by_depth(simulated_cell: SimulatedCellFactory, tmp_path: Path) -> None:
    dsl = {"mode": "paper", "seek_step_m": 3e-3, "search_depth_m": 5e-3}
    async with simulated_cell(policies.still(tmp_path, dsl=dsl), conditions="easy") as bench:
        run = await bench.insert(3)
        assert (run.state, run.code) == (RunState.FAILED, FaultCode.SEARCH_LIMIT)
        assert "5 mm" in run.text


async def test_contact_never_found_search_limit_by_time(simulated_cell: SimulatedCellFactory, tmp_path: Path) -> None:
    dsl = {"mode": "paper", "seek_step_m": 1e-4, "search_steps": 6}
    async with simulated_cell(policies.still(tmp_path, dsl=dsl), conditions="easy") as bench:
        run = await bench.insert(3)
        assert (run.state, run.code) == (RunState.FAILED, FaultCode.SEARCH_LIMIT)
        assert "6 steps" in run.text


async def test_two_starts_at_once_one_is_accepted(simulated_cell: SimulatedCellFactory, tmp_path: Path) -> None:
    async with simulated_cell(policies.still(tmp_path)) as bench:
        answers = await asyncio.gather(*(bench.cell.start(StartRequest(recipe=RECIPE, seed=1)) for _ in range(5)))
        assert [type(answer) for answer in answers].count(RunResult) == 1
        for answer in answers:
            if isinstance(answer, Refused):
                assert answer.problem.reason is RefusalReason.WRONG_STATE


async def test_the_same_idempotency_key_is_the_same_run_at_once_later_and_after_its_end(
    simulated_cell: SimulatedCellFactory, tmp_path: Path
) -> None:
    async with simulated_cell(policies.still(tmp_path), max_steps=3) as bench:
        request = StartRequest(recipe=RECIPE, seed=1, idempotency_key="once")
        first, second = await asyncio.gather(bench.cell.start(request), bench.cell.start(request))
        assert isinstance(first, RunResult)
        assert isinstance(second, RunResult)
        assert first.run.id == second.run.id
        assert [first.created, second.created] == [True, False]
        ended = await bench.ended(first.run)
        third = await bench.cell.start(request)
        assert isinstance(third, RunResult)
        assert (third.run.id, third.created, third.run.state) == (ended.id, False, ended.state)


async def test_an_unknown_recipe_is_refused_and_the_known_ones_named(
    simulated_cell: SimulatedCellFactory, tmp_path: Path
) -> None:
    async with simulated_cell(policies.still(tmp_path)) as bench:
        answer = await bench.cell.start(StartRequest(recipe="nothing"))
        assert isinstance(answer, Refused)
        assert answer.problem.reason is RefusalReason.UNKNOWN_RECIPE
        assert RECIPE in answer.problem.detail


async def test_a_start_that_comes_after_its_sender_gave_up_is_refused_and_moves_nothing(
    faulty_cell: FaultyCell,
) -> None:
    async with faulty_cell() as faulty:
        bench = faulty.bench
        now = bench.cell.journal.clock()
        late = await bench.cell.start(StartRequest(recipe=RECIPE, seed=EASY, valid_until=now - 0.001))
        assert isinstance(late, Refused)
        assert late.problem.reason is RefusalReason.EXPIRED
        await bench.let_pass(0.5)
        assert faulty.driver.said("engage") == []
        assert (bench.cell.state, bench.cell.runs.active) == (CellState.READY, None)
        timely = await bench.cell.start(StartRequest(recipe=RECIPE, seed=EASY, valid_until=now + 1000.0))
        assert isinstance(timely, RunResult)


async def test_a_start_whose_policy_took_too_long_to_load_is_refused_and_moves_nothing(
    faulty_cell: FaultyCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with faulty_cell() as faulty:
        bench = faulty.bench
        hours = iter([10.0, 10.0])
        monkeypatch.setattr(bench.cell.journal, "clock", lambda: next(hours, 12.0))
        late = await bench.cell.start(StartRequest(recipe=RECIPE, seed=EASY, valid_until=11.0))
        assert isinstance(late, Refused)
        assert late.problem.reason is RefusalReason.EXPIRED
        assert faulty.driver.said("engage") == []
        assert bench.cell.state is CellState.READY


async def stop_in(bench: Bench, state: CellState) -> StatusResult:
    await bench.state(state)
    return bench.cell.stop(StopRequest(reason="test", requested_by="operator"))


@pytest.mark.parametrize("state", [CellState.PREFLIGHT, CellState.APPROACH, CellState.RUNNING, CellState.RETRACT])
async def test_39_a_stop_in_any_state_of_a_run_latches_and_the_arm_stands(
    faulty_cell: FaultyCell, state: CellState
) -> None:
    async with faulty_cell() as faulty:
        bench = faulty.bench
        run = await bench.start(EASY)
        answer = await stop_in(bench, state)
        assert answer.status.state is CellState.STOPPING
        ended = await faulty.assert_latched(run, FaultCode.OPERATOR_STOP)
        assert ended.state is RunState.STOPPED
        assert ended.text == bench.cell.journal.latch.text == "stopped by operator: test"
        states = [event.state for event in bench.events]
        assert CellState.RUNNING not in states[states.index(CellState.STOPPING) :]


async def test_a_stop_of_an_idle_cell_is_accepted_and_latches_nothing(
    simulated_cell: SimulatedCellFactory, tmp_path: Path
) -> None:
    async with simulated_cell(policies.still(tmp_path)) as bench:
        assert bench.cell.stop(StopRequest()).status.state is CellState.READY
        assert bench.cell.journal.latch is None


async def test_42_a_reset_in_advance_is_refused_and_a_later_fault_still_latches(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        answer = await faulty.bench.cell.reset(ResetRequest())
        assert isinstance(answer, Refused)
        assert answer.problem.reason is RefusalReason.NOT_LATCHED
        run = await faulty.running()
        faulty.bench.cell.stop(StopRequest())
        await faulty.assert_latched(run, FaultCode.OPERATOR_STOP)


async def test_44_a_reset_leads_to_ready_moves_nothing_and_resumes_nothing(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        bench = faulty.bench
        run = await faulty.running()
        bench.cell.stop(StopRequest())
        await faulty.assert_latched(run, FaultCode.OPERATOR_STOP)
        refused = await bench.cell.start(StartRequest(recipe=RECIPE, seed=1))
        assert isinstance(refused, Refused)
        assert (refused.problem.reason, refused.problem.code) == (RefusalReason.LATCHED, FaultCode.OPERATOR_STOP)
        before = faulty.driver.truth.tcp_position
        orders = len(faulty.driver.said("target")) + len(faulty.driver.said("engage"))
        wrong = await bench.cell.reset(ResetRequest(acknowledge=FaultCode.STALE))
        assert isinstance(wrong, Refused)
        by, found = "M. Sato", "chip in the hole, removed"
        answer = await bench.cell.reset(
            ResetRequest(acknowledge=FaultCode.OPERATOR_STOP, requested_by=by, comment=found)
        )
        assert isinstance(answer, StatusResult)
        assert bench.events[-1].kind == "RESET"
        assert bench.events[-1].text == f"OPERATOR_STOP acknowledged by {by}: {found}"
        assert answer.status.state is CellState.READY
        await bench.let_pass(0.5)
        assert np.abs(faulty.driver.truth.tcp_position - before).max() < 1e-4
        assert len(faulty.driver.said("target")) + len(faulty.driver.said("engage")) == orders
        assert bench.cell.runs.active is None
        assert (await bench.insert(EASY)).state is RunState.SUCCEEDED


async def test_resets_at_once_lead_to_ready_once(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        bench = faulty.bench
        await faulty.running()
        bench.cell.stop(StopRequest())
        await bench.state(CellState.LATCHED)
        answers = await asyncio.gather(*(bench.cell.reset(ResetRequest()) for _ in range(4)))
        assert [type(answer) for answer in answers].count(StatusResult) == 1
        assert bench.cell.state is CellState.READY
        assert bench.cell.journal.latch is None


async def test_a_reset_before_the_stop_is_confirmed_is_refused(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        await faulty.running()
        faulty.bench.cell.stop(StopRequest())
        answer = await faulty.bench.cell.reset(ResetRequest())
        assert isinstance(answer, Refused)
        assert answer.problem.reason is RefusalReason.WRONG_STATE


async def test_status_tells_what_is_measured(simulated_cell: SimulatedCellFactory, tmp_path: Path) -> None:
    async with simulated_cell(policies.straight(tmp_path), conditions="easy") as bench:
        idle = bench.cell.status()
        assert idle.measured is not None
        assert not idle.measured.moving
        run = await bench.start(EASY)
        await bench.state(CellState.APPROACH)
        await bench.let_pass(0.3)
        moving = bench.cell.status()
        assert moving.measured is not None
        assert moving.measured.moving
        assert moving.run is not None
        assert moving.run.id == run.id
        assert not moving.can_start
        await bench.ended(run)
        assert len(bench.telemetry) > 50


async def test_status_counts_what_the_driver_dropped(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        assert faulty.bench.cell.status().counters.samples_dropped == 0
        faulty.driver.samples_dropped = 7
        assert faulty.bench.cell.status().counters.samples_dropped == 7


async def test_telemetry_shows_a_peak_between_two_of_its_points_once(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        await faulty.running()
        bench = faulty.bench
        shown = len(bench.telemetry)
        await bench.until(lambda: len(bench.telemetry) > shown)
        await bench.let_pass(0.006)
        spoilt: list[int] = []

        def kick(sample: Sample) -> list[Sample]:
            if spoilt:
                return [sample]
            spoilt.append(sample.seq)
            return [with_wrench(sample, fx=0.0, fy=0.0, fz=29.0)]

        faulty.driver.spoil = kick
        shown = len(bench.telemetry)
        await bench.until(lambda: len(bench.telemetry) >= shown + 3)
        assert [point.force_peak_n == 29.0 for point in bench.telemetry[shown : shown + 3]] == [True, False, False]
        assert all(point.force_magnitude_n < 29.0 for point in bench.telemetry[shown:])
        assert all(point.force_peak_n >= point.force_magnitude_n - 1e-9 for point in bench.telemetry)


async def test_a_lower_ceiling_of_the_recipe_holds_for_its_runs_is_shown_and_bars_a_reset(
    simulated_cell: SimulatedCellFactory, tmp_path: Path
) -> None:
    async with simulated_cell(policies.still(tmp_path), force_ceiling_n=6.0, impact_n=30.0) as bench:
        assert bench.cell.status().force_ceiling_n == 30.0
        started = await bench.start(3)
        await bench.state(CellState.APPROACH)
        assert bench.cell.status().force_ceiling_n == 6.0
        run = await bench.ended(started)
        assert (run.state, run.code) == (RunState.LATCHED, FaultCode.FORCE_CEILING)
        assert run.peak_force_n >= 6.0
