"""A force/torque sensor that lies underneath everything, and the true force on the part, which the world knows.

Bounds of the true force stand in `docs/explanation/sensor-lies.md`.
"""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from service.drivers.base import Sample
from service.faults import FaultCode
from service.messages import CellState, Run, RunState, StopRequest
from service.testing import Bench
from service.testing.lying_sensor import LIES, LyingSensor
from sim_backend.world.world import World
from tests.service.cell import policies
from tests.service.cell.conftest import EASY, Arm, FaultyCell
from tests.service.cell.faulty_driver import speed
from wire.limits import FORCE_CEILING_N

BOUND_N = FORCE_CEILING_N + 12.0
"""Largest true force of any lie: the ceiling and the resolution of the joints."""
TOUCHED_N = 3.0
BESIDE = 1
"""A seed of the easy conditions whose hole is turned so far that a peg which only sinks stands on the block."""


@dataclass
class LyingCell:
    """A cell whose sensor can lie."""

    bench: Bench
    sensor: LyingSensor
    world: World

    @property
    def newest(self) -> Sample:
        sample = self.bench.cell.newest_sample
        assert sample is not None
        return sample

    async def lie(self, name: str, moment: str) -> Run:
        """Run with a lie that begins at `moment`; return the ended run."""
        bench, sensor = self.bench, self.sensor
        if moment == "from the start":
            sensor.begin(LIES[name], absolute=True)
        run = await bench.start(BESIDE)
        if moment == "in free air":
            await bench.state(CellState.APPROACH, CellState.READY)
        elif moment == "in contact":
            await bench.until(lambda: sensor.peak_n > TOUCHED_N or bench.cell.runs.active is None)
        if moment != "from the start":
            sensor.begin(LIES[name])
        return await bench.ended(run)


@asynccontextmanager
async def lying_cell(arm: Arm, tmp_path: Path) -> AsyncIterator[LyingCell]:
    config = arm.config(tmp_path / "state", policies.still(tmp_path), conditions="easy")
    async with arm.cell(config) as bench:
        world: World = bench.world.plant.world if hasattr(bench.world, "plant") else bench.world.world
        yield LyingCell(bench, LyingSensor(world), world)


async def assert_stands(cell: LyingCell) -> None:
    await cell.bench.let_pass(0.3)
    assert speed(cell.newest) < 2e-3


@pytest.mark.parametrize(
    ("name", "moment"),
    [
        ("Fx frozen", "in free air"),
        ("Fz frozen", "in contact"),
        ("forces frozen", "in contact"),
        ("torques frozen", "in contact"),
    ],
)
async def test_64_65_channels_that_freeze_latch_sensor_stuck(arm: Arm, tmp_path: Path, name: str, moment: str) -> None:
    async with lying_cell(arm, tmp_path) as cell:
        run = await cell.lie(name, moment)
        assert (run.state, run.code) == (RunState.LATCHED, FaultCode.SENSOR_STUCK)
        await assert_stands(cell)
        assert cell.sensor.peak_n < FORCE_CEILING_N


@pytest.mark.parametrize(
    ("name", "moment"),
    [("sign of Fz", "in contact"), ("sign of all", "in free air"), ("x and z swapped", "in contact")],
)
async def test_66_a_wrong_sign_or_axis_latches_at_the_touch_and_the_arm_does_not_yield_to_it(
    arm: Arm, tmp_path: Path, name: str, moment: str
) -> None:
    async with lying_cell(arm, tmp_path) as cell:
        run = await cell.lie(name, moment)
        assert (run.state, run.code) == (RunState.LATCHED, FaultCode.SENSOR_INVALID)
        assert "the joints feel" in run.text
        await assert_stands(cell)
        assert cell.sensor.peak_n < FORCE_CEILING_N


async def test_66_an_operator_s_stop_in_contact_does_not_yield_to_a_wrong_sign_either(arm: Arm, tmp_path: Path) -> None:
    async with lying_cell(arm, tmp_path) as cell:
        run = await cell.bench.start(BESIDE)
        await cell.bench.until(lambda: cell.sensor.peak_n > TOUCHED_N)
        cell.sensor.begin(LIES["sign of all"])
        cell.bench.cell.stop(StopRequest())
        run = await cell.bench.ended(run)
        assert run.code is FaultCode.OPERATOR_STOP, "it came first"
        await assert_stands(cell)
        assert cell.sensor.peak_n < FORCE_CEILING_N


@pytest.mark.parametrize("name", ["sign of all", "x and z swapped"])
async def test_07_a_sensor_that_is_wired_wrongly_is_refused_before_any_motion_with_the_residual(
    arm: Arm, tmp_path: Path, name: str
) -> None:
    async with lying_cell(arm, tmp_path) as cell:
        before = cell.newest.tcp_position
        run = await cell.lie(name, "from the start")
        assert (run.state, run.code) == (RunState.FAILED, FaultCode.CONTACT_AT_START)
        assert " N" in run.text
        assert np.abs(cell.newest.tcp_position - before).max() < 1e-3
        assert cell.sensor.peak_n == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("name", ["gain 0.2", "gain 0.5"])
async def test_67_a_wrong_gain_ends_the_run_or_leaves_the_force_within_its_bound(
    arm: Arm, tmp_path: Path, name: str
) -> None:
    async with lying_cell(arm, tmp_path) as cell:
        run = await cell.lie(name, "in free air")
        await assert_stands(cell)
        assert cell.sensor.peak_n < BOUND_N
        assert run.code is not None, "the policy presses until something ends it"
        if name == "gain 0.2":
            assert run.code is FaultCode.SENSOR_INVALID
            assert cell.sensor.peak_n < FORCE_CEILING_N


async def test_08_a_sensor_that_drifts_fast_is_found_by_the_joints_in_free_air(arm: Arm, tmp_path: Path) -> None:
    async with lying_cell(arm, tmp_path) as cell:
        run = await cell.bench.start(BESIDE)
        await cell.bench.state(CellState.APPROACH)
        ticks = 0

        def drifting(honest: np.ndarray, _: np.ndarray) -> np.ndarray:
            nonlocal ticks
            ticks += 1
            return honest + np.array([0.02 * ticks, 0, 0, 0, 0, 0])  # 10 N/s

        cell.sensor.begin(drifting)
        run = await cell.bench.ended(run)
        assert (run.state, run.code) == (RunState.LATCHED, FaultCode.SENSOR_INVALID)
        assert cell.sensor.peak_n < FORCE_CEILING_N
        await assert_stands(cell)


async def test_67_a_low_gain_and_joints_that_are_stuck_do_not_agree_unnoticed(
    faulty_cell: FaultyCell, tmp_path: Path
) -> None:
    async with faulty_cell(policies.still(tmp_path)) as faulty:
        stuck: list[np.ndarray] = []

        def spoil(sample: Sample) -> list[Sample]:
            if faulty.bench.cell.state is CellState.RUNNING:
                assert sample.joint_force is not None
                stuck.append(sample.joint_force)
                sample = replace(sample, wrench=0.2 * sample.wrench, joint_force=stuck[0])
            return [sample]

        faulty.driver.spoil = spoil
        run = await faulty.bench.insert(BESIDE)
        assert (run.state, run.code) == (RunState.LATCHED, FaultCode.SENSOR_STUCK)
        assert "that the joints feel is bit-identical" in run.text


async def test_09_a_load_that_grows_while_the_sensor_is_zeroed_is_not_zeroed_away(
    faulty_cell: FaultyCell, tmp_path: Path
) -> None:
    """Something leans on the tool: each zeroing hides another 2 N of it."""
    async with faulty_cell(policies.still(tmp_path)) as faulty:
        load_n = zero_n = 0.0
        begun_s: float | None = None
        zero_ft = faulty.driver.zero_ft

        def zero() -> None:
            nonlocal zero_n
            zero_n = load_n
            zero_ft()

        def spoil(sample: Sample) -> list[Sample]:
            nonlocal load_n, begun_s
            if faulty.bench.cell.state is CellState.PREFLIGHT:
                begun_s = sample.time_s if begun_s is None else begun_s
                load_n = float(np.clip(12.0 * (sample.time_s - begun_s - 0.2), 0.0, 20.0))
            wrench, unzeroed = sample.wrench.copy(), sample.unzeroed.copy()
            wrench[2] += load_n - zero_n
            unzeroed[2] += load_n
            assert sample.joint_force is not None
            felt = sample.joint_force + np.array([0.0, 0.0, load_n])
            return [replace(sample, wrench=wrench, unzeroed=unzeroed, joint_force=felt)]

        faulty.driver.zero_ft = zero  # type: ignore[method-assign]
        faulty.driver.spoil = spoil
        run = await faulty.bench.insert(BESIDE)
        assert len(faulty.driver.said("zero_ft")) > 3, "it was zeroed again and again"
        assert (run.state, run.code) == (RunState.FAILED, FaultCode.CONTACT_AT_START)
        assert faulty.driver.said("engage") == []


async def test_10_a_payload_of_twice_the_weight_is_refused_by_the_joints_before_any_motion(
    arm: Arm, tmp_path: Path
) -> None:
    async with lying_cell(arm, tmp_path) as cell:
        reset = cell.world.reset

        def heavier(cells: np.ndarray, tasks: object) -> None:
            reset(cells, tasks)  # type: ignore[arg-type]
            cell.world._layout.mass[0, cell.world._scene.gripper_body] += 0.97
            cell.world.sensor._average[0, 2] += 0.97 * 9.81

        cell.world.reset = heavier  # type: ignore[method-assign]
        run = await cell.bench.insert(BESIDE)
        assert (run.state, run.code) == (RunState.FAILED, FaultCode.CONTACT_AT_START)
        assert "weigh the payload" in run.text
        residual = float(run.text.split(" N in all")[0].split(", ")[-1])
        assert residual == pytest.approx(0.97 * 9.81, abs=3.0)


async def test_82_a_cell_that_idled_for_a_week_is_ready_and_a_run_succeeds(arm: Arm, tmp_path: Path) -> None:
    config = arm.config(tmp_path / "state", policies.straight(tmp_path), conditions="easy")
    async with arm.cell(config) as bench:
        world: World = bench.world.plant.world if hasattr(bench.world, "plant") else bench.world.world
        world.sensor._tick[0] += 7 * 24 * 3600 * 500
        await bench.let_pass(1.0)
        assert bench.cell.state is CellState.READY
        assert bench.cell.status().can_start
        assert (await bench.insert(EASY)).state is RunState.SUCCEEDED
