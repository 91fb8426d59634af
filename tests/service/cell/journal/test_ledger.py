from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from service.cell.journal.ledger import FILE_NAME, Ledger
from service.cell.journal.storage import StorageThread
from service.faults import FaultCode
from service.messages import CellState, Event, EventKind, RunState
from tests.service.cell.journal.runs import run

Open = Callable[..., Ledger]


@pytest.fixture
def opened(tmp_path: Path, storage: StorageThread) -> Iterator[Open]:
    """Open the ledger of this test's directory, as the next process would."""
    ledgers: list[Ledger] = []

    def make(now: float = 0.0) -> Ledger:
        storage.submit(lambda: None).result(5.0)
        ledgers.append(Ledger(tmp_path, storage, now))
        return ledgers[-1]

    yield make
    storage.submit(lambda: None).result(5.0)
    for ledger in ledgers:
        ledger.close()


def test_runs_are_found_again_by_the_next_process_as_they_ended(tmp_path: Path, opened: Open) -> None:
    ledger = opened()
    ledger.record(run(1, RunState.ACTIVE))
    ledger.record(run(1, peak_force_n=9.0))
    ledger.record(run(2, RunState.FAILED, code=FaultCode.SEARCH_LIMIT))
    again = opened(100.0)
    assert again.newest(10) == (run(2, RunState.FAILED, code=FaultCode.SEARCH_LIMIT), run(1, peak_force_n=9.0))
    assert again.interrupted == ()


def test_a_run_without_an_end_was_interrupted(opened: Open) -> None:
    opened().record(run(1, RunState.ACTIVE))
    again = opened(100.0)
    found = again.find("run-1")
    assert found is not None
    assert (found.state, found.code, found.ended_at) == (RunState.INTERRUPTED, FaultCode.INTERRUPTED, 100.0)
    assert again.interrupted == (found,)
    assert opened(200.0).interrupted == ()


def test_a_line_torn_off_by_a_crash_costs_that_line_only(tmp_path: Path, opened: Open) -> None:
    ledger = opened()
    ledger.record(run(1)).result(5.0)
    with (tmp_path / FILE_NAME).open("ab") as file:
        file.write(b'{"run": {"id": "run-2", "reci')
    again = opened()
    assert [found.id for found in again.newest(10)] == ["run-1"]
    assert again.damaged_lines == 1
    again.record(run(3)).result(5.0)
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
    assert opened().unacknowledged == (FaultCode.STALE, "run-1")
    ledger.note(fault(kind=EventKind.RESET))
    ledger.record(run(2, RunState.FAILED, code=FaultCode.SEARCH_LIMIT))
    assert opened().unacknowledged is None
    ledger.note(fault(FaultCode.SENSOR_INVALID))
    assert opened().unacknowledged == (FaultCode.SENSOR_INVALID, None)
