"""Judging models while they are trained: which episodes, and which model is the better one."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from service.policy.model import Policy
from training.evaluation.evaluate import FIRST_TEST_SEED, evaluate
from training.evaluation.results import EpisodeResult
from training.learning.experiment import EvaluationSection, Experiment
from training.learning.parallel import start
from training.learning.validation import FIRST_VALIDATION_SEED, Validation, score, validate
from training.learning.worker import make_cells


def experiment(workers: int) -> Experiment:
    return Experiment.model_validate(
        {
            "name": "judged",
            "title": "Judged",
            "task": {"clearance_mm": [2.0, 2.0], "conditions": "easy", "max_steps": 30, "reward": "paper"},
            "algorithm": {"memory": "none", "steps": 8, "cells": 2, "workers": workers, "minibatches": 1},
            "evaluation": {"every_steps": 8, "episodes": 3, "clearances_mm": [3.0, 1.0]},
        }
    )


def test_no_validation_reaches_the_seeds_of_a_test() -> None:
    most = EvaluationSection.model_fields["episodes"].metadata
    (limit,) = [bound.le for bound in most if hasattr(bound, "le")]
    assert FIRST_VALIDATION_SEED + limit <= FIRST_TEST_SEED


@pytest.mark.parametrize("workers", [1, 2])
def test_every_part_and_clearance_is_played_on_the_same_seeds_however_many_workers_share_them(
    workers: int, model_path: Path
) -> None:
    asked = experiment(workers)
    cells = start(partial(make_cells, asked, 0, 0), workers)
    try:
        judged = validate(asked, model_path.read_bytes(), cells)
    finally:
        cells.close()
    assert [(one.part, one.clearance_m, one.conditions) for one in judged] == [
        ("tr", 3e-3, "easy"),
        ("tr", 1e-3, "easy"),
    ]
    for one in judged:
        alone = evaluate(
            Policy.load(model_path),
            one.clearance_m,
            3,
            conditions="easy",
            first_seed=FIRST_VALIDATION_SEED,
            threads=1,
            reward_name="paper",
        )
        for mine, theirs in zip(one.episodes, alone.episodes, strict=True):
            assert (mine.seed, mine.success, mine.steps) == (theirs.seed, theirs.success, theirs.steps)
            np.testing.assert_allclose(mine.episode_return or 0, theirs.episode_return or 0, atol=1e-3)


def of(successes: list[bool], earned: float) -> Validation:
    episodes = tuple(EpisodeResult(seed, success, False, 10, 5.0, earned) for seed, success in enumerate(successes))
    return Validation("tr", 1e-3, "standard", episodes)


def test_success_counts_before_return_and_every_setting_counts_the_same() -> None:
    good, bad = of([True, True], -1.0), of([False, False], 3.0)
    assert score([good]) > score([bad])
    assert score([good, bad]) == score([bad, good])
    assert score([of([True, False], 1.0)]) > score([of([False, True], 0.5)])


def test_a_record_sums_up_the_episodes() -> None:
    record = of([True, False, False, True], 2.0).record()
    assert (record["successes"], record["episodes"], record["faults"]) == (2, 4, 0)
    assert (record["return_mean"], record["return_std"], record["peak_force_p99_n"]) == (2.0, 0.0, 5.0)
