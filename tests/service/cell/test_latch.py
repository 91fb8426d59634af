from collections.abc import Sequence
from pathlib import Path

import pytest

from service.cell.latch import FILE_NAME, LatchFile
from service.drivers.base import Sample
from service.faults import FaultCode
from service.messages import CellState, Latch, RefusalReason, Refused, ResetRequest
from tests.service.cell.conftest import FaultyCell
from tests.service.cell.faulty_driver import with_wrench

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


async def test_a_reset_while_the_torque_is_above_the_limit_is_refused(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        await faulty.running()
        faulty.driver.spoil = lambda sample: [with_wrench(sample, ty=8.0)]
        await faulty.bench.state(CellState.LATCHED)
        answer = await faulty.bench.cell.reset(ResetRequest())
        assert isinstance(answer, Refused)
        assert answer.problem.reason is RefusalReason.FORCE_ABOVE_LIMIT
        assert "8.00 N·m are measured" in answer.problem.detail


async def test_what_is_felt_until_the_arm_stands_is_told_of_run_and_latch(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        run = await faulty.running()

        def pressed(sample: Sample) -> Sequence[Sample]:
            after = faulty.bench.cell.state is CellState.STOPPING
            return [with_wrench(sample, fx=0.0, fy=0.0, fz=47.0 if after else 32.0)]

        faulty.driver.spoil = pressed
        await faulty.bench.until(lambda: faulty.bench.cell.journal.latch is not None)
        assert faulty.bench.cell.journal.latch.peak_force_n == pytest.approx(32.0, abs=0.5)
        ended = await faulty.assert_latched(run, FaultCode.FORCE_CEILING)
        assert ended.peak_force_n == pytest.approx(47.0)
        assert faulty.bench.cell.journal.latch.peak_force_n == pytest.approx(47.0)
