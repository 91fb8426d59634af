"""Contents of the latch, and conditions that bar its reset."""

from collections.abc import Sequence

import pytest

from service.drivers.base import Sample
from service.faults import FaultCode
from service.messages import CellState, RefusalReason, Refused, ResetRequest
from tests.service.cell.conftest import FaultyCell
from tests.service.cell.faulty_driver import with_wrench


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
