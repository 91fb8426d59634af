from pathlib import Path

from service.cell.journal import Journal
from service.cell.journal.ledger import FILE_NAME
from service.faults import FaultCode
from service.messages import CellState, EventKind, RunState
from tests.service.cell.journal.runs import run


def journal_in(directory: Path) -> Journal:
    return Journal(directory, lambda: 100.0)


async def test_a_latch_whose_file_was_deleted_comes_back_from_the_ledger(tmp_path: Path) -> None:
    journal = journal_in(tmp_path)
    journal.record(run(1, RunState.LATCHED, code=FaultCode.FORCE_CEILING))
    journal.close(5.0)
    again = journal_in(tmp_path)
    assert again.latch is not None
    assert (again.latch.code, again.latch.run_id) == (FaultCode.FORCE_CEILING, "run-1")
    await again.clear_latch_on_disk()
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
