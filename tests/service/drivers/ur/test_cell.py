"""A whole cell with a UR arm: runs, faults and resets, over the bytes that a real controller gets."""

from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.drivers.base import Program
from service.faults import FaultCode
from service.messages import (
    CellState,
    Problem,
    RefusalReason,
    Refused,
    ResetRequest,
    RunState,
    StatusResult,
    StopRequest,
)
from service.testing import Bench, cell_config, lockstep_cell
from tests.service.cell import policies
from tests.service.cell.conftest import EASY
from tests.service.drivers.ur.emulated import Emulated, lockstep_ur_cell, ur_cell_config
from wire.rtde.modes import RuntimeState, SafetyMode

UrCell = Callable[..., AbstractAsyncContextManager[Bench]]


@pytest.fixture
def ur_cell(tmp_path: Path) -> UrCell:
    def make(policy: Path | None = None, **recipe: Any) -> AbstractAsyncContextManager[Bench]:
        recipe.setdefault("conditions", "easy")
        return lockstep_ur_cell(ur_cell_config(tmp_path / "state", policy or policies.straight(tmp_path), **recipe))

    return make


def arm_of(bench: Bench) -> Emulated:
    assert isinstance(bench.world, Emulated)
    return bench.world


async def acknowledged(bench: Bench) -> Problem | None:
    answer = await bench.cell.reset(ResetRequest())
    return answer.problem if isinstance(answer, Refused) else None


async def assert_stands(bench: Bench) -> None:
    await bench.let_pass(0.3)
    assert np.abs(arm_of(bench).plant.qd).max() < 2e-3


async def test_a_run_over_rtde_ends_as_one_over_the_simulator_s_own_wire(ur_cell: UrCell, tmp_path: Path) -> None:
    async with ur_cell() as bench:
        over_rtde = await bench.insert(EASY)
        assert arm_of(bench).truth()["depth"] < -0.02, "retracted to the hover"
        depths = [float(record.depth_m) for record in bench.records]
    config = cell_config(tmp_path / "other", policies.straight(tmp_path), conditions="easy")
    async with lockstep_cell(config) as bench:
        over_zenoh = await bench.insert(EASY)
    assert (over_rtde.state, over_rtde.code) == (over_zenoh.state, over_zenoh.code) == (RunState.SUCCEEDED, None)
    assert max(depths) > 3e-3
    assert abs(over_rtde.steps - over_zenoh.steps) <= 3
    assert over_rtde.peak_force_n == pytest.approx(over_zenoh.peak_force_n, abs=4.0)


async def test_the_same_seed_gives_the_same_run(ur_cell: UrCell) -> None:
    async with ur_cell() as bench:
        felt = []
        for _ in range(2):
            bench.records.clear()
            await running(bench)
            felt.append([record.sample.wrench for record in bench.records[:3]])
            bench.cell.stop(StopRequest())
            await bench.state(CellState.LATCHED)
            await bench.let_pass(0.2)
            assert await acknowledged(bench) is None
    assert np.array_equal(*felt)


async def running(bench: Bench) -> str:
    run = await bench.start(EASY)
    seen = len(bench.records)
    await bench.until(lambda: len(bench.records) >= seen + 3)
    return run.id


async def test_a_program_that_is_ended_under_a_run_latches_authority_and_the_next_run_starts_it_again(
    ur_cell: UrCell,
) -> None:
    async with ur_cell() as bench:
        run_id = await running(bench)
        arm_of(bench).controller.stop_program()
        await bench.state(CellState.LATCHED)
        assert bench.cell.runs.find(run_id).code is FaultCode.AUTHORITY
        assert "PROGRAM_ENDED" in bench.cell.journal.latch.text
        await assert_stands(bench)
        assert await acknowledged(bench) is None
        assert arm_of(bench).controller.runtime_state is RuntimeState.STOPPED, "a reset starts nothing"
        await running(bench)


async def test_a_protective_stop_is_released_by_the_operator_s_reset_and_the_cell_works_again(ur_cell: UrCell) -> None:
    async with ur_cell() as bench:
        run_id = await running(bench)
        controller = arm_of(bench).controller
        controller.protective_stop("test")
        await bench.state(CellState.LATCHED)
        assert bench.cell.runs.find(run_id).code is FaultCode.PROTECTIVE_STOP
        await bench.let_pass(5.2)
        assert controller.safety_mode is SafetyMode.PROTECTIVE_STOP, "nothing recovers by itself"
        refused = await acknowledged(bench)
        assert refused is not None
        assert refused.reason is RefusalReason.WRONG_STATE
        await bench.until(lambda: controller.safety_mode is SafetyMode.NORMAL, 2.0)
        await bench.let_pass(0.1)
        assert await acknowledged(bench) is None
        await running(bench)


async def test_an_emergency_stop_under_a_run_latches_and_the_arm_stands(ur_cell: UrCell) -> None:
    async with ur_cell() as bench:
        await running(bench)
        arm_of(bench).controller.press_emergency_stop()
        await bench.state(CellState.LATCHED)
        assert bench.cell.journal.latch.code is FaultCode.AUTHORITY
        await assert_stands(bench)


async def test_a_start_in_local_control_fails_before_any_motion_and_says_what_to_do(ur_cell: UrCell) -> None:
    async with ur_cell() as bench:
        arm = arm_of(bench)
        arm.controller.remote_control = False
        before = arm.plant.q.copy()
        run = await bench.insert(EASY)
        assert (run.state, run.code) == (RunState.FAILED, FaultCode.AUTHORITY)
        assert "Settings/System/Remote Control" in run.text
        assert arm.plant.q == pytest.approx(before, abs=1e-6)
        assert bench.cell.state is CellState.READY
        arm.controller.remote_control = True
        await bench.let_pass(0.02)
        await running(bench)


async def test_the_controller_s_own_ceiling_stops_a_push_that_the_host_does_not_see(
    ur_cell: UrCell, tmp_path: Path
) -> None:
    """The host's monitor is blind here; what stops the arm is the control program."""
    async with ur_cell(policies.still(tmp_path), force_ceiling_n=4.0, impact_n=30.0, conditions="standard") as bench:
        bench.cell._intake.renew = lambda force_ceiling_n=None: type(bench.cell._intake).renew(bench.cell._intake, 50.0)
        run = await bench.insert(5)
        assert (run.state, run.code) == (RunState.LATCHED, FaultCode.FORCE_CEILING)
        assert "stopped by itself" in run.text
        assert arm_of(bench).plant.true_force < 10.0
        await assert_stands(bench)


async def test_a_stop_by_the_operator_is_confirmed_by_measurement(ur_cell: UrCell) -> None:
    async with ur_cell() as bench:
        await running(bench)
        asked_s = bench.cell.driver.clock()
        assert isinstance(bench.cell.stop(StopRequest()), StatusResult)
        await bench.state(CellState.LATCHED)
        assert bench.cell.journal.latch.code is FaultCode.OPERATOR_STOP
        assert bench.cell.driver.clock() - asked_s < 0.25
        assert bench.cell.newest_sample.program is Program.IDLE
        await assert_stands(bench)
