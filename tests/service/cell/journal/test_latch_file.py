import json
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from service.cell.journal.latch_file import FILE_NAME, LatchFile
from service.faults import FaultCode
from service.messages import Latch

LATCH = Latch(code=FaultCode.STALE, text="no sample", latched_at=12.5, run_id="run-1", peak_force_n=7.0)


@contextmanager
def opened(directory: Path, now: float = 99.0) -> Iterator[LatchFile]:
    file = LatchFile(directory, now)
    try:
        yield file
    finally:
        file.close(5.0)


def found_in(directory: Path, now: float = 99.0) -> Latch | None:
    with opened(directory, now) as file:
        return file.found


def test_a_directory_in_which_no_cell_has_run_is_not_latched(tmp_path: Path) -> None:
    assert found_in(tmp_path / "new") is None


def test_a_latch_is_read_back_by_the_next_process_until_it_is_cleared(tmp_path: Path) -> None:
    with opened(tmp_path) as file:
        file.set(LATCH).synced.result(5.0)
        assert found_in(tmp_path) == LATCH
        file.clear().synced.result(5.0)
    assert found_in(tmp_path) is None


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"null", b"[]", b"{}", b"\xff\xfe", b'{"latch": {}}', b'{"latch": {"code": "NOPE"}}', b'{"latch": 0}'],
)
def test_a_damaged_file_is_a_latch_and_never_a_clear_cell(tmp_path: Path, content: bytes) -> None:
    (tmp_path / FILE_NAME).write_bytes(content)
    latch = found_in(tmp_path, 7.0)
    assert latch is not None
    assert latch.code is FaultCode.INTERNAL
    assert latch.latched_at == 7.0
    assert FILE_NAME in latch.text


def test_a_file_that_may_not_be_read_is_a_latch(tmp_path: Path) -> None:
    (tmp_path / FILE_NAME).mkdir()
    assert found_in(tmp_path) is not None


def test_a_write_that_fails_leaves_the_latch_that_was_there(tmp_path: Path) -> None:
    with opened(tmp_path) as file:
        file.set(LATCH).synced.result(5.0)
        (tmp_path / FILE_NAME).with_suffix(".tmp").mkdir()
        assert isinstance(file.clear().synced.exception(5.0), OSError)
        assert found_in(tmp_path) == LATCH


def delete(path: Path) -> None:
    path.unlink()


def move(path: Path) -> None:
    path.rename(path.with_suffix(".1"))


def replace(path: Path) -> None:
    copy = path.with_suffix(".copy")
    copy.write_text('{"latch": null}')
    copy.replace(path)


def edit(path: Path) -> None:
    path.write_text('{"latch": null}')


def delete_the_directory(path: Path) -> None:
    shutil.rmtree(path.parent)


def move_the_directory(path: Path) -> None:
    path.parent.rename(path.parent.with_name("moved"))


@pytest.mark.parametrize("harm", [delete, move, replace, edit, delete_the_directory, move_the_directory])
@pytest.mark.parametrize("latch", [LATCH, None], ids=["latched", "clear"])
def test_69_a_latch_that_was_taken_away_is_said_and_written_anew(
    tmp_path: Path, harm: Callable[[Path], None], latch: Latch | None
) -> None:
    path = tmp_path / "state" / FILE_NAME
    with opened(path.parent) as file:
        if latch is not None:
            file.set(latch).synced.result(5.0)
        harm(path)
        while file.lost is None or not path.exists():
            os.sched_yield()
        file.set(LATCH).synced.result(5.0) if latch is None else None
        while json.loads(path.read_text())["latch"] is None:
            os.sched_yield()
        assert file.fault is not None
        assert FILE_NAME in file.fault
        assert found_in(path.parent) == LATCH
