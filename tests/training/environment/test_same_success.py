"""The environment's criterion, the cell's and the world's truth agree about every episode."""

from pathlib import Path

import numpy as np
import pytest

from service.messages import RunState
from service.policy.model import Policy
from service.testing import cell_config, lockstep_cell
from training.environment.insertion import SUCCESS_DEPTH_M, Insertions
from training.evaluation.evaluate import play
from wire.task import Conditions, Task

MODELS = Path(__file__).parents[3] / "models"
LOCKS = {"allow_lock": ("paper", "sliding")}


@pytest.mark.parametrize(
    ("policy", "conditions", "clearance_mm", "seeds"),
    [
        ("vftm-dsl", "standard", 1.33, range(1031, 1039)),
        ("vftm-dsl", "standard", 0.33, range(2000, 2006)),
        ("scripted-search", "standard", 2.0, range(3000, 3006)),
        ("ftm-dsl", "search", 1.33, range(1001, 1007)),
    ],
)
async def test_cell_and_environment_count_the_same_episodes_as_inserted(
    tmp_path: Path, policy: str, conditions: Conditions, clearance_mm: float, seeds: range
) -> None:
    """The environment ends an episode deeper than the cell, so a peg that one of both leaves on its way may differ.

    No episode here does.
    """
    model = MODELS / f"{policy}.onnx"
    tasks = [Task(seed, "tr", 1e-3 * clearance_mm, conditions) for seed in seeds]
    actor = Policy.load(model)
    counted = [result.success for result in play(actor, Insertions(actor.contract, len(tasks)), tasks)]
    config = cell_config(
        tmp_path, model, clearance_m=1e-3 * clearance_mm, conditions=conditions, retract=False, **LOCKS
    )
    told: list[bool] = []
    true: list[bool] = []
    async with lockstep_cell(config) as bench:
        for task in tasks:
            run = await bench.insert(task.seed)
            truth = bench.world.truth()
            told.append(run.state is RunState.SUCCEEDED)
            true.append(truth["depth"] >= SUCCESS_DEPTH_M and truth["contained"])
    assert told == true == counted
    assert np.any(told), "some were inserted"
