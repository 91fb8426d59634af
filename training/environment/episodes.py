"""Tasks for training: an endless draw, on seeds that no evaluation uses."""

from dataclasses import dataclass

import numpy as np

from wire.task import Conditions, Part, Task

FIRST_TRAINING_SEED = 2**32
"""Smallest seed of a training. Every evaluation uses smaller seeds, so no seed is in both."""


@dataclass(frozen=True, slots=True)
class TaskSource:
    """Source of training tasks.

    Attributes:
        part: peg and hole.
        clearance_m: range of clearances per face; the tight end is likelier (a uniform draw to the power 1.5).
        conditions: name of the conditions of an episode.
        randomise_plant: True: friction, stiffness, delay, mass and contact vary.
    """

    part: Part = "tr"
    clearance_m: tuple[float, float] = (0.8e-3, 2.6e-3)
    conditions: Conditions = "standard"
    randomise_plant: bool = True

    def draw(self, rng: np.random.Generator, count: int) -> list[Task]:
        """Draw `count` tasks, seeds from `FIRST_TRAINING_SEED` up."""
        low, high = self.clearance_m
        seeds = rng.integers(FIRST_TRAINING_SEED, 2**62, count)
        clearances = low + (high - low) * rng.uniform(size=count) ** 1.5
        return [
            Task(int(seed), self.part, float(c), self.conditions, self.randomise_plant)
            for seed, c in zip(seeds, clearances, strict=True)
        ]
