"""Faults of the policy, in its file and in its answers: rows 2, 24, 25, 27 to 29, 68 and 73."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import helper

from service.cell.insertion import Insertion
from service.drivers.base import Sample
from service.faults import FaultCode
from service.messages import CellState, RunState
from service.policy.model import Policy
from service.policy.step import Seen
from service.safety import dsl
from service.safety.dsl import DslParameters
from service.testing import RECIPE, cell_config, lockstep_cell
from tests.service.cell import policies
from tests.service.cell.conftest import EASY, FaultyCell
from tests.service.policy.model_files import linear_model
from training.environment import design
from training.environment.design import LAW


async def test_02_a_policy_that_presses_on_goes_no_deeper_than_the_lock(
    faulty_cell: FaultyCell, tmp_path: Path
) -> None:
    beside_the_hole = 1
    async with faulty_cell(policies.pressing(tmp_path)) as faulty:
        run = await faulty.bench.insert(beside_the_hole)
        assert (run.state, run.code) == (RunState.FAILED, FaultCode.SEARCH_LIMIT)
        assert faulty.bench.cell.journal.latch is None
        pressed = [record for record in faulty.bench.records if record.displacement[2] < 0]
        locked = [record for record in pressed if record.dsl.phase == dsl.Phase.LOCKED]
        assert len(locked) > 20
        assert all(record.dsl.clamped for record in locked), "each limit is on record"
        one_step_m = design.LOCK.seek_step_m - min(record.displacement[2] for record in pressed)
        for record in locked:
            assert record.target.position[2] >= record.dsl.z_lock - 1e-9
        for record in pressed:
            deeper_m = record.sample.tcp_position[2] - record.target.position[2]
            assert deeper_m <= one_step_m + 1e-9


@pytest.mark.parametrize("bad", [np.nan, np.inf])
async def test_24_policy_answers_nan_policy_invalid(
    faulty_cell: FaultyCell, monkeypatch: pytest.MonkeyPatch, bad: float
) -> None:
    async with faulty_cell() as faulty:
        run = await faulty.running()
        sent = len(faulty.driver.said("target"))
        whole = Policy.act
        monkeypatch.setattr(Policy, "act", lambda self, *given: (np.full_like(whole(self, *given)[0], bad), None))
        await faulty.assert_latched(run, FaultCode.POLICY_INVALID)
        assert len(faulty.driver.said("target")) == sent, "nothing of it was sent"


async def test_25_actions_times_100_are_clamped_then_latch_bounds(
    faulty_cell: FaultyCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with faulty_cell() as faulty:
        run = await faulty.running()
        before, whole = len(faulty.bench.records), Policy.act

        def times_100(policy: Policy, *given: np.ndarray) -> tuple[np.ndarray, None]:
            action, _ = whole(policy, *given)
            return 100.0 * np.where(np.abs(action) > 0.2, action, 1.0), None

        monkeypatch.setattr(Policy, "act", times_100)
        await faulty.assert_latched(run, FaultCode.BOUNDS)
        wild = faulty.bench.records[before:]
        limits = faulty.bench.cell.config.limits
        assert len(wild) == limits.clamped_steps
        previous = faulty.bench.records[before - 1].target.position
        for record in wild:
            assert np.linalg.norm(record.target.position - previous) <= limits.max_step_m + 1e-12
            assert np.abs(record.displacement).max() < 0.2
            previous = record.target.position


async def test_a_command_that_is_no_pose_is_a_fault_of_the_policy(
    faulty_cell: FaultyCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with faulty_cell() as faulty:
        run = await faulty.running()
        sent, whole = len(faulty.driver.said("target")), Insertion._see

        def nowhere(insertion: Insertion, sample: Sample) -> Seen:
            seen = whole(insertion, sample)
            return replace(seen, position=seen.position + 2e6)

        monkeypatch.setattr(Insertion, "_see", nowhere)
        await faulty.assert_latched(run, FaultCode.POLICY_INVALID)
        assert len(faulty.driver.said("target")) == sent, "nothing of it was sent"


async def test_an_estimate_that_strays_in_the_run_latches_and_one_that_stays_out_does_not(
    faulty_cell: FaultyCell,
) -> None:
    async with faulty_cell() as faulty:
        run = await faulty.running()
        faulty.driver.spoil = lambda sample: [replace(sample, hole_estimate=None)]
        before = len(faulty.bench.records)
        await faulty.bench.until(lambda: len(faulty.bench.records) >= before + 3)
        assert faulty.bench.cell.journal.latch is None
        x, y, z = faulty.bench.cell.config.recipes[RECIPE].nominal_hole_m
        faulty.driver.spoil = lambda sample: [replace(sample, hole_estimate=np.array([x, y + 0.061, z]))]
        ended = await faulty.assert_latched(run, FaultCode.BOUNDS)

        assert "61.0" in ended.text


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda data: b"", "CORRUPT"),
        (lambda data: data[: len(data) // 2], "CORRUPT"),
        (lambda data: b"\0" * (17 * 2**20), "TOO_LARGE"),
        (None, "UNREADABLE"),
    ],
    ids=["empty", "half", "oversized", "missing"],
)
async def test_29_a_broken_policy_refuses_its_recipe_and_the_cell_is_well(
    tmp_path: Path, spoil: object, reason: str
) -> None:
    policy = policies.still(tmp_path)
    if callable(spoil):
        policy.write_bytes(spoil(policy.read_bytes()))
    else:
        policy.unlink()
    async with lockstep_cell(cell_config(tmp_path / "state", policy)) as bench:
        with pytest.raises(AssertionError, match=f"POLICY_REFUSED: {reason}"):
            await bench.start()
        assert bench.cell.state is CellState.READY
        assert bench.cell.journal.latch is None
        assert bench.cell.journal.newest(10) == ()


async def test_27_a_contract_that_does_not_fit_is_refused_with_the_mismatch(tmp_path: Path) -> None:
    policy = policies.still(tmp_path, parts=("cir",))
    async with lockstep_cell(cell_config(tmp_path / "state", policy)) as bench:
        with pytest.raises(AssertionError, match="the policy is for cir, the cell assembles tr"):
            await bench.start()
        assert bench.cell.state is CellState.READY


async def test_27_a_graph_of_another_shape_than_its_contract_is_refused_with_both(tmp_path: Path) -> None:
    asked = policies.document()
    other = linear_model(asked, observation_size=asked.observation_size + 1)
    policy = policies.save(tmp_path / "other.onnx", other)
    async with lockstep_cell(cell_config(tmp_path / "state", policy)) as bench:
        with pytest.raises(AssertionError, match=r"SIGNATURE: .*observation is tensor.* want tensor"):
            await bench.start()
        assert bench.cell.state is CellState.READY
        assert bench.cell.journal.newest(10) == ()


async def test_29_weights_in_another_file_refuse_the_recipe_and_the_cell_is_well(tmp_path: Path) -> None:
    path = tmp_path / "p.onnx"
    onnx.save(linear_model(policies.document()), path, save_as_external_data=True, location="w.bin", size_threshold=0)
    async with lockstep_cell(cell_config(tmp_path / "state", path)) as bench:
        with pytest.raises(AssertionError, match="POLICY_REFUSED: EXTERNAL_DATA"):
            await bench.start()
        assert bench.cell.state is CellState.READY


async def test_73_a_graph_that_samples_refuses_its_recipe(tmp_path: Path) -> None:
    noise = helper.make_node("RandomNormalLike", ["product"], ["noise"])
    policy = policies.save(tmp_path / "noisy.onnx", linear_model(policies.document(), extra_nodes=[noise]))
    async with lockstep_cell(cell_config(tmp_path / "state", policy)) as bench:
        with pytest.raises(AssertionError, match=r"POLICY_REFUSED: RANDOM: .*\(RandomNormalLike\)"):
            await bench.start()
        assert bench.cell.state is CellState.READY


async def test_68_a_law_that_swings_within_the_numeric_limits_is_refused_with_its_damping_ratio(tmp_path: Path) -> None:
    swings = replace(LAW, damping=(380.0, 380.0, 60.0, 1.0, 1.0, 0.5), inertia=(2.5, 2.5, 0.5, 0.06, 0.06, 0.03))
    policy = policies.still(tmp_path, compliance=swings)
    async with lockstep_cell(cell_config(tmp_path / "state", policy)) as bench:
        with pytest.raises(AssertionError, match=r"compliance z swings on a contact .* damping ratio -0\.39, at least"):
            await bench.start()
        assert bench.cell.state is CellState.READY
        assert bench.cell.journal.newest(10) == ()


async def test_28_a_policy_replaced_on_disk_runs_on_and_is_refused_next_time(
    faulty_cell: FaultyCell, tmp_path: Path
) -> None:
    policy = policies.straight(tmp_path)
    async with faulty_cell(policy) as faulty:
        run = await faulty.running()
        policy.write_bytes(policies.still(tmp_path).read_bytes())
        assert (await faulty.bench.ended(run)).state is RunState.SUCCEEDED
        with pytest.raises(AssertionError, match=r"POLICY_REFUSED.*was replaced"):
            await faulty.bench.start()
        assert faulty.bench.cell.state is CellState.READY


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"dsl": DslParameters(mode="off")}, "mode 'off', this recipe runs paper"),
        ({"dsl": DslParameters(mode="sliding")}, "mode 'sliding', this recipe runs paper"),
        ({"dsl": DslParameters(mode="paper", press_m=1.0)}, "presses at most 5 mm"),
        ({"compliance": replace(LAW, damping=(1.0,) * 6)}, r"compliance.damping\[0\] is 1"),
        ({"compliance": replace(LAW, inertia=(1e-3,) * 6)}, r"compliance.inertia\[0\] is 0.001"),
    ],
)
async def test_a_contract_without_its_guards_is_refused(tmp_path: Path, changes: dict, reason: str) -> None:
    async with lockstep_cell(cell_config(tmp_path / "state", policies.still(tmp_path, **changes))) as bench:
        with pytest.raises(AssertionError, match=f"POLICY_REFUSED.*{reason}"):
            await bench.start()
        assert bench.cell.state is CellState.READY


async def test_a_recipe_that_allows_it_runs_without_the_lock(tmp_path: Path) -> None:
    policy = policies.still(tmp_path, dsl=DslParameters(mode="off"))
    config = cell_config(tmp_path / "state", policy, allow_lock=("off",), max_steps=2, conditions="easy")
    async with lockstep_cell(config) as bench:
        assert (await bench.insert(EASY)).steps == 2


async def test_a_hole_that_the_camera_has_far_from_the_recipes_fails_the_run_unmoved_bounds(
    faulty_cell: FaultyCell,
) -> None:
    async with faulty_cell() as faulty:
        wrong = np.array([0.09, 0.0, 0.0])
        faulty.driver.spoil = lambda sample: [replace(sample, hole_estimate=sample.hole_estimate + wrong)]
        run = await faulty.bench.insert(EASY)
        assert (run.state, run.code) == (RunState.FAILED, FaultCode.BOUNDS)
        assert "from the recipe's hole" in run.text
        assert faulty.driver.said("engage") == []
