from pathlib import Path

import pytest

from service.cell.journal.latch_file import FILE_NAME, LatchFile
from service.faults import FaultCode
from service.messages import Latch

LATCH = Latch(code=FaultCode.STALE, text="no sample", latched_at=12.5, run_id="run-1", peak_force_n=7.0)


def test_a_directory_in_which_no_cell_has_run_is_not_latched(tmp_path: Path) -> None:
    assert LatchFile(tmp_path / "new").read(1.0) is None


def test_a_latch_is_read_back_by_the_next_process_until_it_is_cleared(tmp_path: Path) -> None:
    LatchFile(tmp_path).write(LATCH)
    assert LatchFile(tmp_path).read(99.0) == LATCH
    LatchFile(tmp_path).write(None)
    assert LatchFile(tmp_path).read(99.0) is None


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"null", b"[]", b"{}", b"\xff\xfe", b'{"latch": {}}', b'{"latch": {"code": "NOPE"}}', b'{"latch": 0}'],
)
def test_a_damaged_file_is_a_latch_and_never_a_clear_cell(tmp_path: Path, content: bytes) -> None:
    (tmp_path / FILE_NAME).write_bytes(content)
    latch = LatchFile(tmp_path).read(7.0)
    assert latch is not None
    assert latch.code is FaultCode.INTERNAL
    assert latch.latched_at == 7.0
    assert FILE_NAME in latch.text


def test_a_file_that_may_not_be_read_is_a_latch(tmp_path: Path) -> None:
    (tmp_path / FILE_NAME).mkdir()
    assert LatchFile(tmp_path).read(7.0) is not None


def test_a_write_that_fails_leaves_the_latch_that_was_there(tmp_path: Path) -> None:
    file = LatchFile(tmp_path)
    file.write(LATCH)
    (tmp_path / FILE_NAME).with_suffix(".tmp").mkdir()
    with pytest.raises(OSError, match="directory"):
        file.write(None)
    assert file.read(0.0) == LATCH
