import json
import os
import resource
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from service.cell.journal.ledger import FILE_NAME, Ledger
from service.faults import FaultCode
from service.messages import CellState, Event, EventKind, Latch, Run, RunState
from tests.service.cell.journal.runs import run

Open = Callable[..., Ledger]


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[Open]:
    """Open the ledger of this test's directory, as the next process would."""
    ledgers: list[Ledger] = []

    def close() -> None:
        while ledgers:
            assert ledgers.pop().close(5.0)

    def make(now: float = 0.0, latch: Latch | None = None) -> Ledger:
        close()
        ledgers.append(Ledger(tmp_path, now, latch))
        return ledgers[-1]

    yield make
    close()


def without_number(*runs: Run) -> tuple[Run, ...]:
    return tuple(run.model_copy(update={"seq": 0}) for run in runs)


def test_runs_are_found_again_by_the_next_process_as_they_ended(tmp_path: Path, opened: Open) -> None:
    ledger = opened()
    ledger.record(run(1, RunState.ACTIVE))
    ledger.record(run(1, peak_force_n=9.0))
    ledger.record(run(2, RunState.FAILED, code=FaultCode.SEARCH_LIMIT))
    again = opened(100.0)
    found = without_number(*again.newest(10))
    assert found == (run(2, RunState.FAILED, code=FaultCode.SEARCH_LIMIT), run(1, peak_force_n=9.0))
    assert again.interrupted == ()


def test_a_run_without_an_end_was_interrupted(opened: Open) -> None:
    opened().record(run(1, RunState.ACTIVE))
    again = opened(100.0)
    found = again.find("run-1")
    assert found is not None
    assert (found.state, found.code, found.ended_at) == (RunState.INTERRUPTED, FaultCode.INTERRUPTED, 100.0)
    assert again.interrupted == (found,)
    assert opened(200.0).interrupted == ()


def test_78_a_run_that_its_latch_names_ended_as_the_latch_tells(opened: Open) -> None:
    opened().record(run(1, RunState.ACTIVE))
    latch = Latch(code=FaultCode.OPERATOR_STOP, text="enough", latched_at=7.5, run_id="run-1", peak_force_n=9.0)
    again = opened(100.0, latch)
    found = again.find("run-1")
    assert found is not None
    assert (found.state, found.code, found.text) == (RunState.STOPPED, FaultCode.OPERATOR_STOP, "enough")
    assert (found.ended_at, found.peak_force_n) == (7.5, 9.0)
    assert again.interrupted == ()


def test_79_a_run_found_unfinished_by_a_clock_that_was_set_back_ends_no_earlier_than_it_began(opened: Open) -> None:
    opened().record(run(1000, RunState.ACTIVE))
    found = opened(5.0).find("run-1000")
    assert found is not None
    assert found.ended_at == found.requested_at == 1000.0


def test_79_runs_are_numbered_in_the_order_of_their_acceptance_across_processes(opened: Open) -> None:
    numbers: list[int] = []
    for time_of_day in (1000.0, 1.0):
        ledger = opened(time_of_day)
        for number in range(2):
            numbers.append(ledger.next_seq())
            ledger.record(run(int(time_of_day) + number, seq=numbers[-1]))
    assert numbers == sorted(set(numbers))
    assert [found.seq for found in opened().newest(10)] == numbers[::-1]


def test_79_a_ledger_that_numbered_nothing_is_read_in_the_order_of_its_lines(tmp_path: Path, opened: Open) -> None:
    old = [run(number, requested_at=1000.0 - number).model_dump(mode="json") for number in (4, 9, 2)]
    for document in old:
        del document["seq"]
    lines = [{"run": document | {"state": state}} for state in ("ACTIVE", "SUCCEEDED") for document in old]
    (tmp_path / FILE_NAME).write_text("".join(json.dumps(line) + "\n" for line in lines))
    ledger = opened()
    assert [(found.id, found.seq) for found in ledger.newest(10)] == [("run-2", 3), ("run-9", 2), ("run-4", 1)]
    assert ledger.next_seq() == 4


def test_a_ledger_begun_after_a_lost_one_numbers_on_above_it(opened: Open) -> None:
    assert opened(1000.0).next_seq() > 1000


def test_71_a_proposed_run_is_not_found_before_it_is_accepted_and_never_if_it_is_taken_back(opened: Open) -> None:
    ledger = opened()
    proposed, refused = run(1, RunState.ACTIVE, idempotency_key="k"), run(2, RunState.ACTIVE, idempotency_key="l")
    ledger.propose(proposed)
    ledger.propose(refused)
    assert ledger.newest(10) == ()
    assert ledger.find_key("k") is None
    ledger.withdraw("run-2")
    again = opened()
    assert [found.id for found in again.newest(10)] == ["run-1"], "a kill after the line was written is an interruption"
    assert again.find_key("l") is None


def delete(path: Path) -> None:
    path.unlink()


def move(path: Path) -> None:
    path.rename(path.with_suffix(".1"))


def replace(path: Path) -> None:
    shutil.copy(path, path.with_suffix(".copy"))
    path.with_suffix(".copy").replace(path)


def truncate(path: Path) -> None:
    os.truncate(path, 0)


def delete_the_directory(path: Path) -> None:
    shutil.rmtree(path.parent)


def move_the_directory(path: Path) -> None:
    path.parent.rename(path.parent.with_name("moved"))


@pytest.mark.parametrize("harm", [delete, move, replace, truncate, delete_the_directory, move_the_directory])
def test_69_a_ledger_that_was_taken_away_is_said_and_written_anew(tmp_path: Path, harm: Callable[[Path], None]) -> None:
    path = tmp_path / "state" / FILE_NAME
    ledger = Ledger(path.parent, 0.0)
    ledger.record(run(1, seq=1))
    ledger.record(run(2, RunState.ACTIVE, seq=2, idempotency_key="k")).synced.result(5.0)
    assert ledger.fault is None
    harm(path)
    while ledger.lost is None or b"run-2" not in (path.read_bytes() if path.exists() else b""):
        os.sched_yield()
    assert ledger.fault is not None
    assert FILE_NAME in ledger.fault
    ledger.record(run(3, seq=3)).synced.result(5.0)
    assert ledger.close(5.0)
    again = Ledger(path.parent, 0.0)
    assert [found.id for found in again.newest(10)] == ["run-3", "run-2", "run-1"]
    assert [found.id for found in again.interrupted] == ["run-2"], "not ACTIVE for ever"
    assert again.close(5.0)


def test_69_a_run_that_is_proposed_after_the_ledger_was_taken_away_stands_at_its_path(tmp_path: Path) -> None:
    ledger = Ledger(tmp_path, 0.0)
    move(tmp_path / FILE_NAME)
    ledger.propose(run(1, RunState.ACTIVE)).synced.result(5.0)
    assert b"run-1" in (tmp_path / FILE_NAME).read_bytes()
    assert ledger.lost is not None
    assert ledger.close(5.0)


def test_51_a_line_that_was_written_in_part_costs_that_line_only(tmp_path: Path, opened: Open) -> None:
    ledger = opened()
    ledger.record(run(1)).synced.result(5.0)
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, ((tmp_path / FILE_NAME).stat().st_size + 20, limit[1]))
    try:
        assert isinstance(ledger.record(run(2)).synced.exception(5.0), OSError)
        assert ledger.fault is not None
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    ledger.record(run(3)).synced.result(5.0)
    again = opened()
    assert [found.id for found in again.newest(10)] == ["run-3", "run-1"]
    assert again.damaged_lines == 1


def test_a_line_torn_off_by_a_crash_costs_that_line_only(tmp_path: Path, opened: Open) -> None:
    ledger = opened()
    ledger.record(run(1))
    assert ledger.close(5.0)
    with (tmp_path / FILE_NAME).open("ab") as file:
        file.write(b'{"run": {"id": "run-2", "reci')
    again = opened()
    assert [found.id for found in again.newest(10)] == ["run-1"]
    assert again.damaged_lines == 1
    again.record(run(3)).synced.result(5.0)
    assert [found.id for found in opened(100.0).newest(10)] == ["run-3", "run-1"]


def test_an_idempotency_key_finds_its_run_after_a_restart(opened: Open) -> None:
    opened().record(run(1, idempotency_key="k"))
    found = opened(100.0).find_key("k")
    assert found is not None
    assert found.id == "run-1"


def test_pages_go_backwards_from_the_run_that_is_named(tmp_path: Path, opened: Open) -> None:
    ledger = opened()
    for number in range(5):
        ledger.record(run(number))
    assert [found.id for found in ledger.newest(2)] == ["run-4", "run-3"]
    assert [found.id for found in ledger.newest(2, before="run-3")] == ["run-2", "run-1"]


def test_events_are_journalled_between_the_runs(tmp_path: Path, opened: Open) -> None:
    ledger = opened()
    ledger.note(Event(service_epoch="e", seq=1, time=2.0, kind=EventKind.STATE, state=CellState.READY, text="hello"))
    opened()
    assert '"hello"' in (tmp_path / FILE_NAME).read_text()


def fault(code: FaultCode = FaultCode.STALE, kind: EventKind = EventKind.FAULT) -> Event:
    return Event(service_epoch="e", seq=1, time=2.0, kind=kind, state=CellState.STOPPING, code=code, text="")


@pytest.mark.parametrize("state", [RunState.LATCHED, RunState.STOPPED, RunState.INTERRUPTED])
def test_a_latching_end_counts_until_a_reset_stands_after_it(opened: Open, state: RunState) -> None:
    ledger = opened()
    ledger.record(run(1, state, code=FaultCode.STALE))
    ledger = opened()
    assert ledger.unacknowledged == (FaultCode.STALE, "run-1")
    ledger.note(fault(kind=EventKind.RESET))
    ledger.record(run(2, RunState.FAILED, code=FaultCode.SEARCH_LIMIT))
    ledger = opened()
    assert ledger.unacknowledged is None
    ledger.note(fault(FaultCode.SENSOR_INVALID))
    assert opened().unacknowledged == (FaultCode.SENSOR_INVALID, None)
