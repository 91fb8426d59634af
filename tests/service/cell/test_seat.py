"""SUCCEEDED means a peg in the hole, by the world's own measure: rows 32, 62 and 63."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.drivers.base import Sample
from service.faults import FaultCode
from service.messages import CellState, Event, Run, RunState, Telemetry
from service.safety.dsl import DslParameters
from service.testing import Bench, cell_config, lockstep_cell
from sim_backend.zenoh_cell.cell import SimulatedCell
from tests.service.cell import policies
from tests.service.cell.conftest import EASY, FaultyBench, FaultyCell
from tests.service.cell.faulty_driver import with_wrench
from training.environment.insertion import SUCCESS_DEPTH_M
from wire.task import Task

MODELS = Path(__file__).parents[3] / "models"
SHIPPED = MODELS / "vftm-dsl.onnx"
LEVEL = 24
"""A seed of the standard conditions whose hole is near the nominal height, so that the camera may be 20 mm off."""

TURNED = 5
"""Another one, whose hole is turned so far that a peg comes to stand on the block."""


class Outcome:
    """Looks at the world at the moment at which a run's outcome is decided, before the arm moves away."""

    def __init__(self, bench: Bench) -> None:
        self.truth: dict[str, Any] = {}
        self._bench = bench
        bench.cell.journal.observers.append(self)

    @property
    def inserted(self) -> bool:
        return self.truth["depth"] >= SUCCESS_DEPTH_M and self.truth["contained"]

    def on_tick(self, record: object) -> None: ...

    def on_telemetry(self, point: Telemetry) -> None: ...

    def on_event(self, event: Event) -> None:
        if event.state in (CellState.RETRACT, CellState.STOPPING) and not self.truth:
            self.truth = self._bench.world.truth()


async def insert(faulty: FaultyBench, seed: int) -> tuple[Run, Outcome]:
    """Play a run; no success is told that is none."""
    outcome = Outcome(faulty.bench)
    run = await faulty.bench.insert(seed)
    assert run.state is not RunState.SUCCEEDED or outcome.inserted, (run, outcome.truth)
    return run, outcome


def mislead(faulty: FaultyBench, offset_mm: Sequence[float]) -> None:
    """Move what the camera sees."""
    offset = 1e-3 * np.array(offset_mm)
    faulty.driver.spoil = lambda sample: [replace(sample, hole_estimate=sample.hole_estimate + offset)]


@pytest.mark.parametrize(
    ("arm", "height_mm"),
    [
        *(("simulated", height_mm) for height_mm in (-20.0, -6.0, -3.5, 2.0, 3.5, 6.0, 9.0, 12.0, 20.0)),
        ("ur", 6.0),
    ],
    indirect=["arm"],
)
async def test_62_camera_height_wrong_no_success_in_the_air(faulty_cell: FaultyCell, height_mm: float) -> None:
    async with faulty_cell(SHIPPED, clearance_m=1.33e-3, conditions="standard") as faulty:
        mislead(faulty, (0.0, 0.0, height_mm))
        run, _ = await insert(faulty, LEVEL)
        if abs(height_mm) > 5.0:
            above = "above the hole's mouth, tolerance 2.5 mm"
            code, said = (FaultCode.BOUNDS, above) if height_mm < 0.0 else (FaultCode.SEARCH_LIMIT, "nothing holds it")
            assert (run.state, run.code) == (RunState.FAILED, code), run.text
            assert said in run.text
        assert faulty.bench.cell.state is CellState.READY


@pytest.mark.parametrize("arm", ["simulated"], indirect=True)
@pytest.mark.parametrize("offset_mm", [(0.0, -8.0), (-14.0, 14.0), (20.0, 0.0)], ids=str)
async def test_62_camera_position_wrong_no_success_beside_the_hole(
    faulty_cell: FaultyCell, offset_mm: tuple[float, float]
) -> None:
    async with faulty_cell(SHIPPED, clearance_m=1.33e-3, conditions="standard", max_steps=60) as faulty:
        mislead(faulty, (*offset_mm, 0.0))
        run, _ = await insert(faulty, LEVEL)
        if np.hypot(*offset_mm) > 10.0:
            assert run.state is RunState.FAILED
            assert run.code in (FaultCode.SEARCH_LIMIT, FaultCode.BOUNDS)


class Shifted(SimulatedCell):
    """A world whose block was moved after the camera had looked: there is no hole where it is believed."""

    def __init__(self, shift_mm: Sequence[float]) -> None:
        super().__init__("tr")
        self._shift = 1e-3 * np.array(shift_mm)

    def reset(self, task: Task) -> np.ndarray:
        answer = super().reset(task)
        world = self._world
        world.move_hole(np.array([0]), world.hole_position + self._shift, world.hole_yaw.copy())
        return answer


@pytest.mark.parametrize(
    ("shift_mm", "said"),
    [
        ((60.0, 0.0, 0.0), "not inserted within"),
        ((0.0, 60.0, -7.0), "nothing holds it"),
        ((0.0, 0.0, -300.0), "nothing holds it"),
    ],
    ids=["no hole", "no hole, and lower", "nothing"],
)
async def test_62_no_hole_at_all_never_succeeds(tmp_path: Path, shift_mm: Sequence[float], said: str) -> None:
    config = cell_config(tmp_path, SHIPPED, clearance_m=1.33e-3, max_steps=60)
    async with lockstep_cell(config, world=Shifted(shift_mm)) as bench:
        run = await bench.insert(LEVEL)
        assert (run.state, run.code) == (RunState.FAILED, FaultCode.SEARCH_LIMIT)
        assert said in run.text


async def test_62_without_a_camera_depth_below_the_nominal_hole_is_no_success(tmp_path: Path) -> None:
    """A hole 10 mm lower than the nominal one: the search comes to the nominal depth in free air."""
    config = cell_config(tmp_path, MODELS / "ftm-dsl.onnx", clearance_m=1.33e-3, conditions="search", max_steps=30)
    async with lockstep_cell(config, world=Shifted((0.0, 0.0, -10.0))) as bench:
        outcome = Outcome(bench)
        run = await bench.insert(1020)
        assert run.state is RunState.FAILED or outcome.inserted


async def test_63_a_policy_that_pushes_sideways_ends_at_the_bound_about_its_hole(
    faulty_cell: FaultyCell, tmp_path: Path
) -> None:
    async with faulty_cell(policies.sideways(tmp_path), conditions="standard") as faulty:
        strayed: list[float] = []

        def measure(sample: Sample) -> list[Sample]:
            if faulty.bench.cell.state is CellState.RUNNING:
                strayed.append(float(np.hypot(*faulty.bench.world.truth()["offset"])))
            return [sample]

        faulty.driver.spoil = measure
        run, outcome = await insert(faulty, TURNED)
        assert (run.state, run.code) == (RunState.FAILED, FaultCode.BOUNDS)
        assert "beside the hole, limit" in run.text
        assert not outcome.inserted
        assert 0.02 < max(strayed) < 0.03, "it went there, and no farther"
        assert faulty.bench.cell.state is CellState.READY


async def test_63_a_policy_that_climbs_ends_at_the_bound_above_its_hole(tmp_path: Path) -> None:
    contract = policies.document(
        observation=(policies.OBSERVATION[1],), dsl=DslParameters(mode="off"), compliance=policies.LAW
    )
    weights = np.zeros((contract.observation_size, len(contract.action)))
    weights[0, 2] = 100.0
    path = policies.save(tmp_path / "up.onnx", policies.linear_model(contract, weights=weights))
    config = cell_config(tmp_path / "state", path, conditions="easy", allow_lock=("off",))
    async with lockstep_cell(config) as bench:
        run = await bench.insert(EASY)
        assert (run.state, run.code) == (RunState.FAILED, FaultCode.BOUNDS)
        assert "above the hole, limit 45.0 mm" in run.text


async def test_a_peg_that_drops_in_without_a_contact_is_proven_by_the_walls(tmp_path: Path) -> None:
    config = cell_config(tmp_path, SHIPPED, clearance_m=1.33e-3, retract=False)
    async with lockstep_cell(config) as bench:
        run = await bench.insert(1035)
        assert run.state is RunState.SUCCEEDED, run.text
        assert np.isnan([float(record.dsl.z_lock) for record in bench.records]).all(), "it never felt a contact"
        assert bench.world.truth()["depth"] > 3e-3, "it was put back"
        assert bench.world.truth()["contained"]
        assert run.peak_force_n < 9.0, "gently"


async def test_32_contact_never_found_search_limit_by_time(tmp_path: Path) -> None:
    lock = replace(policies.LOCK, search_steps=6)
    config = cell_config(tmp_path / "state", policies.still(tmp_path, dsl=lock), conditions="easy")
    async with lockstep_cell(config) as bench:
        run = await bench.insert(EASY)
        assert (run.state, run.code) == (RunState.FAILED, FaultCode.SEARCH_LIMIT)
        assert run.text == "no contact within 6 steps"


async def test_32_contact_never_found_search_limit_by_depth(tmp_path: Path) -> None:
    lock = replace(policies.LOCK, search_depth_m=0.015)
    config = cell_config(tmp_path / "state", policies.still(tmp_path, dsl=lock), conditions="easy")
    async with lockstep_cell(config) as bench:
        run = await bench.insert(EASY)
        assert (run.state, run.code) == (RunState.FAILED, FaultCode.SEARCH_LIMIT)
        assert run.text == "no contact within 15 mm"
        assert bench.world.truth()["depth"] < 0.0


@pytest.mark.parametrize("arm", ["simulated"], indirect=True)
async def test_a_sensor_that_feels_no_contact_gives_no_success(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        await faulty.running()
        noise = np.random.default_rng(0)
        faulty.driver.spoil = lambda sample: [
            with_wrench(sample, **dict(zip(("fx", "fy", "fz"), noise.normal(0.0, 0.3, 3), strict=True)))
        ]
        run = await faulty.bench.ended(faulty.bench.cell.runs.active.accepted)
        assert run.state is not RunState.SUCCEEDED
