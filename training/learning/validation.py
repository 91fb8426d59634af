"""Validation during training: the deterministic policy, as it would be exported, on seeds of its own."""

from dataclasses import dataclass
from functools import partial

import numpy as np

from service.policy.model import Policy
from training.environment.reward import RewardName
from training.environment.vector import EndlessCells
from training.evaluation.evaluate import evaluate
from training.evaluation.results import EpisodeResult
from training.learning.experiment import Experiment
from wire.task import Conditions, Part

FIRST_VALIDATION_SEED = 500_000
"""First of the seeds that choose between models; they end below the first test seed."""


@dataclass(frozen=True, slots=True)
class Validation:
    """Results of one part at one clearance."""

    part: Part
    clearance_m: float
    conditions: Conditions
    episodes: tuple[EpisodeResult, ...]

    @property
    def success(self) -> float:
        """Success rate."""
        return float(np.mean([episode.success for episode in self.episodes]))

    @property
    def returns(self) -> list[float]:
        """Returns of the episodes."""
        return [episode.episode_return or 0.0 for episode in self.episodes]

    def record(self) -> dict[str, str | int | float]:
        """Return the line for `progress.jsonl`."""
        peaks = np.percentile([episode.peak_force_n for episode in self.episodes], [50, 99, 100]).round(3).tolist()
        return {
            "part": self.part,
            "clearance_m": self.clearance_m,
            "conditions": self.conditions,
            "episodes": len(self.episodes),
            "successes": sum(episode.success for episode in self.episodes),
            "faults": sum(episode.fault for episode in self.episodes),
            "return_mean": round(float(np.mean(self.returns)), 4),
            "return_std": round(float(np.std(self.returns)), 4),
            "steps_mean": round(float(np.mean([episode.steps for episode in self.episodes])), 2),
            "peak_force_median_n": peaks[0],
            "peak_force_p99_n": peaks[1],
            "peak_force_max_n": peaks[2],
        }


def validate(experiment: Experiment, model: bytes, cells: EndlessCells) -> list[Validation]:
    """Play the experiment's evaluation.

    Args:
        experiment: sets the parts, the clearances and the number of episodes of each.
        model: contents of the policy's ONNX file.
        cells: cells of the training; their processes play the episodes.
    """
    evaluation, task = experiment.evaluation, experiment.task
    conditions = evaluation.conditions or task.conditions
    settings: list[tuple[Part, float]] = [
        (part, level * 1e-3) for part in task.parts for level in evaluation.clearances_mm
    ]
    shares = np.array_split(
        np.arange(FIRST_VALIDATION_SEED, FIRST_VALIDATION_SEED + evaluation.episodes), cells.workers
    )
    jobs = [
        partial(_play, model, part, clearance, conditions, int(seeds[0]), len(seeds), task.force_ceiling_n, task.reward)
        for part, clearance in settings
        for seeds in shares
        if len(seeds)
    ]
    played = cells.run(jobs)
    each = len(played) // len(settings)
    return [
        Validation(part, clearance, conditions, tuple(sum(played[each * i : each * (i + 1)], ())))
        for i, (part, clearance) in enumerate(settings)
    ]


def score(validations: list[Validation]) -> tuple[float, float]:
    """Return the order of models: mean success rate, and at equal success the mean return."""
    return (
        float(np.mean([validation.success for validation in validations])),
        float(np.mean([np.mean(validation.returns) for validation in validations])),
    )


def _play(
    model: bytes,
    part: Part,
    clearance_m: float,
    conditions: Conditions,
    first_seed: int,
    episodes: int,
    force_ceiling_n: float,
    reward: RewardName,
) -> tuple[EpisodeResult, ...]:
    block = evaluate(
        Policy(model),
        clearance_m,
        episodes,
        part=part,
        conditions=conditions,
        first_seed=first_seed,
        cells=episodes,
        threads=1,
        force_ceiling_n=force_ceiling_n,
        reward_name=reward,
    )
    return block.episodes
