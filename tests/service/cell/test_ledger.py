import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from service.cell.journal import Journal
from service.cell.ledger import FILE_NAME, Ledger
from service.cell.storage import CAPACITY, StorageFullError, StorageThread
from service.faults import FaultCode
from service.messages import CellState, Event, EventKind, Run, RunState


def run(number: int, state: RunState = RunState.SUCCEEDED, **changes: object) -> Run:
    fields = {"id": f"run-{number}", "recipe": "r", "seed": number, "state": state, "requested_at": float(number)}
    return Run.model_validate(fields | changes)


@pytest.fixture
def storage() -> Iterator[StorageThread]:
    thread = StorageThread()
    yield thread
    thread.close(5.0)


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


def test_a_disk_that_does_not_answer_never_blocks_and_is_reported(storage: StorageThread) -> None:
    begun, release = threading.Event(), threading.Event()
    storage.submit(lambda: (begun.set(), release.wait()))
    begun.wait(5.0)
    for _ in range(CAPACITY):
        storage.submit(lambda: None)
    with pytest.raises(StorageFullError, match="writes wait"):
        storage.submit(lambda: None)
    assert storage.fault is not None
    release.set()


def test_a_failed_write_is_a_fault_until_one_succeeds(storage: StorageThread) -> None:
    def fail() -> None:
        raise OSError("disk full")

    assert isinstance(storage.submit(fail).exception(5.0), OSError)
    assert storage.fault is not None
    assert "disk full" in storage.fault
    storage.submit(lambda: None).result(5.0)
    assert storage.fault is None


def test_an_owed_write_is_tried_again_and_a_fault_until_it_is_done(storage: StorageThread) -> None:
    broken, done = [True], threading.Event()

    def write() -> None:
        if broken:
            raise OSError("read-only")
        done.set()

    assert isinstance(storage.submit(write, owed=True).exception(5.0), OSError)
    storage.submit(lambda: None).result(5.0)
    assert storage.fault is not None, "another job's success does not hide it"
    assert "read-only" in storage.fault
    broken.clear()
    assert done.wait(5.0), "it is tried again by itself"
    storage.submit(lambda: None).result(5.0)
    assert storage.fault is None


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


def journal_in(directory: Path) -> Journal:
    return Journal(directory, lambda: 100.0)


def test_a_latch_whose_file_was_deleted_comes_back_from_the_ledger(tmp_path: Path) -> None:
    journal = journal_in(tmp_path)
    journal.record(run(1, RunState.LATCHED, code=FaultCode.FORCE_CEILING))
    journal.close(5.0)
    again = journal_in(tmp_path)
    assert again.latch is not None
    assert (again.latch.code, again.latch.run_id) == (FaultCode.FORCE_CEILING, "run-1")
    again.clear_latch_on_disk().result(5.0)
    again.tell(EventKind.RESET, CellState.READY, "acknowledged")
    again.close(5.0)
    last = journal_in(tmp_path)
    assert last.latch is None
    last.close(5.0)


def test_a_damaged_last_line_may_have_been_a_fault_so_the_cell_starts_latched(tmp_path: Path) -> None:
    journal = journal_in(tmp_path)
    journal.record(run(1))
    journal.close(5.0)
    with (tmp_path / FILE_NAME).open("ab") as file:
        file.write(b'{"run":{"id":"run-2"')
    again = journal_in(tmp_path)
    assert again.latch is not None
    assert again.latch.code is FaultCode.INTERRUPTED
    again.close(5.0)
