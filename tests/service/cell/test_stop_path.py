"""Every way through a cell's stop, by the arm's motion and the record. Mutation testing runs this file for each mutant.

The runs are stopped early, so that a test takes a fraction of a second; insertions to their end are in `test_cell`.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from service.cell.cell import Cell
from service.cell.halting import Halting
from service.drivers.base import Program, Sample
from service.faults import FaultCode
from service.messages import CellState, EventKind, Run, RunState, StopRequest
from service.safety.verdict import Verdict
from tests.service.cell.conftest import EASY, FaultyBench, FaultyCell
from tests.service.cell.faulty_driver import speed, with_wrench

pytestmark = pytest.mark.parametrize("arm", ["simulated"], indirect=True)
STATES_OF_A_RUN = [CellState.PREFLIGHT, CellState.APPROACH]
FAULT = FaultCode.BOUNDS
TEXT = "what was found"


async def begun(faulty: FaultyBench, state: CellState = CellState.APPROACH) -> Run:
    """Start a run; wait until it is in `state`, in APPROACH until the arm moves."""
    run = await faulty.bench.start(EASY)
    await faulty.bench.state(state)
    if state is CellState.APPROACH:
        await faulty.bench.until(lambda: speed(faulty.driver.truth) > 5e-3)
    return run


def said_blind(faulty: FaultyBench) -> list[float]:
    return faulty.driver.said("stop_blind")


def faults(faulty: FaultyBench) -> list[tuple[CellState, FaultCode | None, str, str | None]]:
    """Return the state, code, text and run of every fault event, oldest first."""
    told = [event for event in faulty.bench.events if event.kind is EventKind.FAULT]
    return [(event.state, event.code, event.text, event.run_id) for event in told]


@pytest.mark.parametrize("state", STATES_OF_A_RUN)
@pytest.mark.parametrize(
    ("request_", "text"),
    [
        (StopRequest(), "stopped"),
        (StopRequest(requested_by="Ann"), "stopped by Ann"),
        (StopRequest(reason="noise"), "stopped: noise"),
        (StopRequest(requested_by="Ann", reason="noise"), "stopped by Ann: noise"),
    ],
)
async def test_39_a_stop_of_a_run_latches_and_the_record_says_who_and_why(
    faulty_cell: FaultyCell, state: CellState, request_: StopRequest, text: str
) -> None:
    async with faulty_cell() as faulty:
        run = await begun(faulty, state)
        stops = faulty.bench.cell.mark.stops
        answer = faulty.bench.cell.stop(request_)
        assert answer.status.state is CellState.STOPPING
        assert faulty.bench.cell.mark.stops > stops
        ended = await faulty.assert_latched(run, FaultCode.OPERATOR_STOP)
        assert (ended.state, ended.text) == (RunState.STOPPED, text)
        assert faulty.bench.cell.journal.latch.text == text
        assert faults(faulty) == [(CellState.STOPPING, FaultCode.OPERATOR_STOP, text, run.id)]
        states = [event.state for event in faulty.bench.events if event.kind is EventKind.STATE]
        assert states[-2:] == [CellState.STOPPING, CellState.LATCHED]


async def test_39_a_stop_of_an_idle_cell_reaches_the_arm_and_outdates_earlier_starts(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        cell = faulty.bench.cell
        for _ in range(3):
            told, stops = len(faulty.driver.said("stop")), cell.mark.stops
            cell.stop(StopRequest())
            assert len(faulty.driver.said("stop")) == told + 1
            assert cell.mark.stops == stops + 1
        await faulty.bench.let_pass(0.2)
        assert cell.state is CellState.READY
        assert cell.journal.latch is None


@pytest.mark.parametrize("state", STATES_OF_A_RUN)
async def test_a_fault_of_a_run_stops_the_arm_and_stands_in_latch_run_and_events(
    faulty_cell: FaultyCell, state: CellState
) -> None:
    async with faulty_cell() as faulty:
        run = await begun(faulty, state)
        stops = faulty.bench.cell.mark.stops
        faulty.bench.cell.halt(FAULT, TEXT)
        assert faulty.bench.cell.mark.stops == stops + 1
        latch = faulty.bench.cell.journal.latch
        assert (latch.code, latch.text, latch.run_id) == (FAULT, TEXT, run.id)
        assert latch.peak_force_n is not None
        ended = await faulty.assert_latched(run, FAULT)
        assert (ended.state, ended.text) == (RunState.LATCHED, TEXT)
        assert ended.peak_force_n == faulty.bench.cell.journal.latch.peak_force_n
        assert ended.ended_at is not None
        assert faults(faulty) == [(CellState.STOPPING, FAULT, TEXT, run.id)]
        assert said_blind(faulty) == []


async def test_a_later_fault_does_not_replace_the_first(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        run = await begun(faulty)
        faulty.bench.cell.halt(FAULT, TEXT)
        faulty.bench.cell.halt(FaultCode.INTERNAL, "later")
        ended = await faulty.assert_latched(run, FAULT)
        faulty.bench.cell.halt(FaultCode.INTERNAL, "later still")
        assert ended.text == faulty.bench.cell.journal.latch.text == TEXT
        assert len(faults(faulty)) == 1


async def test_a_fault_of_a_ready_arm_latches_without_a_run(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        await faulty.bench.state(CellState.READY)
        told = len(faulty.driver.said("stop"))
        faulty.bench.cell.halt(FAULT, TEXT)
        assert len(faulty.driver.said("stop")) > told
        await faulty.bench.state(CellState.LATCHED)
        latch = faulty.bench.cell.journal.latch
        assert (latch.code, latch.text, latch.run_id, latch.peak_force_n) == (FAULT, TEXT, None, None)
        assert faults(faulty) == [(CellState.STOPPING, FAULT, TEXT, None)]


@pytest.mark.parametrize("code", [FaultCode.STALE, FaultCode.LINK, FaultCode.SOURCE, FaultCode.PROTOCOL])
async def test_a_fault_of_the_link_takes_a_ready_cell_offline_and_stops_its_arm(
    faulty_cell: FaultyCell, code: FaultCode
) -> None:
    async with faulty_cell() as faulty:
        await faulty.bench.state(CellState.READY)
        told = len(faulty.driver.said("stop"))
        faulty.bench.cell.halt(code, TEXT)
        assert len(faulty.driver.said("stop")) == told + 1
        assert faulty.bench.cell.state is CellState.OFFLINE
        assert faulty.bench.cell.journal.latch is None
        await faulty.bench.state(CellState.READY, limit_s=5.0)


@pytest.mark.parametrize("code", [FaultCode.STALE, FaultCode.LINK, FaultCode.SOURCE, FaultCode.PROTOCOL])
async def test_a_fault_of_the_link_latches_a_run_by_its_own_name(faulty_cell: FaultyCell, code: FaultCode) -> None:
    async with faulty_cell() as faulty:
        run = await begun(faulty)
        faulty.bench.cell.halt(code, TEXT)
        ended = await faulty.assert_latched(run, code)
        assert ended.text == TEXT
        assert any(TEXT in event.text for event in faulty.bench.events if event.kind is not EventKind.FAULT)


@pytest.mark.parametrize("code", [FaultCode.SENSOR_INVALID, FaultCode.SENSOR_STUCK, FaultCode.BIAS])
async def test_66_an_arm_whose_sensor_lies_stops_without_yielding_to_it(
    faulty_cell: FaultyCell, code: FaultCode
) -> None:
    async with faulty_cell() as faulty:
        run = await begun(faulty)
        faulty.bench.cell.halt(code, TEXT)
        assert said_blind(faulty)
        await faulty.assert_latched(run, code)


async def test_66_a_stop_becomes_blind_where_the_sensor_turns_out_to_lie_and_only_then(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        run = await begun(faulty)
        faulty.bench.cell.stop(StopRequest())
        faulty.bench.cell.halt(FAULT, TEXT)
        await faulty.bench.let_pass(0.01)
        assert said_blind(faulty) == []
        faulty.bench.cell.halt(FaultCode.SENSOR_INVALID, TEXT)
        assert said_blind(faulty)
        ended = await faulty.assert_latched(run, FaultCode.OPERATOR_STOP)
        assert ended.text == "stopped"


@pytest.mark.parametrize("heard", [True, False], ids=["heard", "silent"])
async def test_45_a_stop_without_standstill_is_repeated_and_told_as_unconfirmed(
    faulty_cell: FaultyCell, heard: bool
) -> None:
    async with faulty_cell(real_time=True) as faulty:
        run = await begun(faulty)
        faulty.driver.deaf_to_stop = True
        if not heard:
            faulty.driver.spoil = lambda sample: []
        at = faulty.driver.clock()
        faulty.bench.cell.halt(FAULT, TEXT)
        await faulty.bench.state(CellState.LATCHED)
        asked = [time_s for time_s in faulty.driver.said("stop") if time_s > at]
        assert len(asked) > 10
        latch = faulty.bench.cell.journal.latch
        assert latch.code is (FaultCode.STOP_UNCONFIRMED if heard else FAULT)
        assert latch.run_id == run.id
        assert latch.peak_force_n is not None
        assert latch.text == (
            "no standstill was measured in time after the stop: use the robot's own emergency stop. "
            f"Stopped for {FAULT}: {TEXT}"
        )
        assert faults(faulty)[-1] == (CellState.STOPPING, FaultCode.STOP_UNCONFIRMED, latch.text, run.id)
        assert faulty.bench.cell.runs.find(run.id).code is FAULT
        faulty.driver.deaf_to_stop = False
        faulty.driver.stop()


async def test_what_is_felt_while_the_arm_comes_to_rest_is_told_of_run_and_latch(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        run = await begun(faulty)
        faulty.bench.cell.halt(FAULT, TEXT)
        before = faulty.bench.cell.journal.latch.peak_force_n
        faulty.driver.spoil = lambda sample: [with_wrench(sample, fx=0.0, fy=0.0, fz=21.0)]
        ended = await faulty.assert_latched(run, FAULT)
        latch = faulty.bench.cell.journal.latch
        assert before < 10.0
        assert latch.peak_force_n == ended.peak_force_n == pytest.approx(21.0)
        assert (latch.code, latch.text, latch.run_id) == (FAULT, TEXT, run.id)


async def test_a_run_that_fails_before_it_engages_ends_ready_with_its_reason(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        faulty.driver.spoil = lambda sample: [with_wrench(sample, fz=sample.wrench[2] + 5.0)]
        run = await faulty.bench.start(EASY)
        told = len(faulty.driver.said("stop"))
        ended = await faulty.bench.ended(run)
        assert (ended.state, ended.code) == (RunState.FAILED, FaultCode.CONTACT_AT_START)
        assert "N" in ended.text
        assert len(faulty.driver.said("stop")) > told
        assert faulty.bench.cell.state is CellState.READY
        assert faulty.bench.cell.journal.latch is None


async def test_a_run_to_its_end_is_told_as_succeeded_once_the_arm_stands(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        stops = faulty.bench.cell.mark.stops
        ended = await faulty.bench.insert(EASY)
        assert (ended.state, ended.code, ended.text) == (RunState.SUCCEEDED, None, "")
        assert speed(faulty.driver.truth) < 2e-3
        assert faulty.bench.cell.mark.stops == stops
        assert said_blind(faulty) == []


async def test_66_the_stop_at_the_end_of_a_run_becomes_blind_where_the_sensor_lies(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        run = await begun(faulty)

        def lying(sample: Sample) -> list[Sample]:
            stopping = faulty.bench.cell.state is CellState.RETRACT and faulty.driver.said("stop")[-1] > last
            return [with_wrench(sample, fz=sample.wrench[2] + 25.0)] if stopping else [sample]

        last = faulty.driver.clock()
        faulty.driver.spoil = lying
        ended = await faulty.bench.ended(run)
        assert said_blind(faulty)
        assert ended.state is RunState.SUCCEEDED


async def test_a_run_that_ends_and_an_arm_that_does_not_stand_is_latched_unconfirmed(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:

        def drifting(sample: Sample) -> list[Sample]:
            moved = {"tcp_velocity": np.full(6, 0.1)} if faulty.driver.said("stop") else {}
            return [replace(with_wrench(sample, fz=sample.wrench[2] + 5.0), **moved)]

        faulty.driver.spoil = drifting
        run = await faulty.bench.start(EASY)
        await faulty.bench.state(CellState.LATCHED)
        latch = faulty.bench.cell.journal.latch
        assert latch.code is FaultCode.STOP_UNCONFIRMED
        assert latch.run_id == run.id
        assert "no standstill was measured" in latch.text


@pytest.mark.parametrize("state", [CellState.READY, *STATES_OF_A_RUN])
async def test_48_a_process_that_ends_stops_its_arm_and_interrupts_its_run(
    faulty_cell: FaultyCell, state: CellState
) -> None:
    async with faulty_cell() as faulty:
        run = None if state is CellState.READY else await begun(faulty, state)
        told, stops = len(faulty.driver.said("stop")), faulty.bench.cell.mark.stops
        await faulty.bench.cell.close()
        assert len(faulty.driver.said("stop")) > told
        assert faulty.bench.cell.mark.stops > stops
        latch = faulty.bench.cell.journal.latch
        if run is None:
            assert latch is None
        else:
            assert (latch.code, latch.run_id) == (FaultCode.INTERRUPTED, run.id)
            assert latch.text == "the control process was told to end"
            assert faulty.bench.cell.runs.find(run.id).code is FaultCode.INTERRUPTED


async def test_an_arm_that_stays_engaged_is_told_to_stop_again(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        faulty.driver.deaf_to_stop = True
        await begun(faulty)
        faulty.bench.cell.stop(StopRequest())
        await faulty.bench.state(CellState.LATCHED)
        told = len(faulty.driver.said("stop"))
        await faulty.bench.let_pass(0.5)
        assert len(faulty.driver.said("stop")) - told >= 20
        assert faulty.driver.truth.program is Program.ENGAGED
        faulty.driver.deaf_to_stop = False
        await faulty.bench.until(lambda: faulty.driver.truth.program is Program.IDLE)


NEXT: dict[str, Callable[[Cell], object]] = {
    "sample": lambda cell: cell.newest_sample is None or cell.on_sample(cell.newest_sample),
    "turn of the watch": lambda cell: cell.watch(),
    "fault": lambda cell: cell.halt(FAULT, TEXT),
    "stop": lambda cell: cell.stop(StopRequest()),
}


@pytest.mark.parametrize("comes_next", NEXT.values(), ids=NEXT)
async def test_the_first_overload_of_the_transport_s_thread_is_the_cause_whatever_comes_next(
    faulty_cell: FaultyCell, comes_next: Callable[[Cell], object]
) -> None:
    async with faulty_cell() as faulty:
        cell, truth = faulty.bench.cell, faulty.driver
        run = await begun(faulty)
        judged = [cell.overloads(with_wrench(truth.truth, fz=force_n).load) for force_n in (20.0, 40.0, 50.0)]
        assert judged == [False, True, True]
        comes_next(cell)
        assert cell.state is CellState.STOPPING
        await faulty.bench.state(CellState.LATCHED)
        (told,) = faults(faulty)
        assert told[:2] == (CellState.STOPPING, FaultCode.FORCE_CEILING)
        assert told[2].startswith("force 40")
        assert told[3] == run.id


class Interrupted(Halting):
    """Has an overload come from the transport's thread between the loop's look for one and whatever follows."""

    came: Verdict | None = None

    @property
    def _overload(self) -> Verdict | None:
        seen = self.came
        self.came = self.came or Verdict(FaultCode.FORCE_CEILING, text=TEXT)
        return seen

    @_overload.setter
    def _overload(self, overload: Verdict | None) -> None:
        self.came = overload


async def test_an_overload_that_comes_while_the_loop_looks_for_one_is_not_lost(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        cell = faulty.bench.cell
        await begun(faulty)
        cell._halting.__class__ = Interrupted
        cell.watch()
        assert cell.state is CellState.APPROACH
        cell.watch()
        assert cell.state is CellState.STOPPING
        assert faults(faulty)[0][1:3] == (FaultCode.FORCE_CEILING, TEXT)
