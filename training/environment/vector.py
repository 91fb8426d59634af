"""Cells that play one episode after another, with privileged features for the critic."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from training.environment.episodes import TaskSource
from training.environment.insertion import PRIVILEGED_SIZE, Insertions
from wire.arrays import BoolArray, Float32Array, FloatArray

WorkerJob = Callable[[], Any]
"""Work to do beside the training. The job and its result must be picklable."""


@dataclass(frozen=True, slots=True)
class Ended:
    """Episodes that ended in one step or in several; arrays (k,).

    Attributes:
        success: the peg was inserted.
        fault: the force ceiling or the arm's controller ended the episode.
        steps: number of steps taken.
        peak_force: largest resultant over every sample, N.
        episode_return: sum of the rewards.
    """

    success: BoolArray
    fault: BoolArray
    steps: npt.NDArray[np.int64]
    peak_force: FloatArray
    episode_return: FloatArray

    @classmethod
    def joined(cls, parts: "list[Ended]") -> "Ended":
        """Join the episodes of `parts`, which must not be empty."""
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in cls.__slots__))

    def latest(self, count: int) -> "Ended":
        """Return the last `count` episodes."""
        return Ended(*(getattr(self, name)[-count:] for name in self.__slots__))

    def __len__(self) -> int:
        return len(self.success)


@dataclass(frozen=True, slots=True)
class Step:
    """One step of every cell; arrays (n, …).

    Attributes:
        features: (n, size) float32: the policy's observation in raw units, then `PRIVILEGED_SIZE` numbers for the
            critic. Where an episode has ended, they are those of the next episode's beginning.
        reward: (n,) float32.
        done: (n,) True where an episode ended, by success, fault or time.
        ended: the episodes that ended.
    """

    features: Float32Array
    reward: Float32Array
    done: BoolArray
    ended: Ended


class EndlessCells(Protocol):
    """Cells that begin a new episode as soon as one ends, in this process or in others.

    Attributes:
        n: number of cells.
        feature_size: number of features of each cell.
        action_size: number of action components of each cell.
        workers: number of processes that the cells are spread over, this one included.
    """

    n: int
    feature_size: int
    action_size: int
    workers: int

    def reset(self) -> Float32Array:
        """Begin an episode in every cell; return the features (n, feature_size)."""
        ...

    def step(self, action: npt.NDArray[Any]) -> Step:
        """Run one policy step of every cell; `action` (n, action_size) in [-1, 1]."""
        ...

    def run(self, jobs: Sequence[WorkerJob]) -> list[Any]:
        """Run `jobs` in the processes of the cells, which stand still meanwhile; return the results in order."""
        ...

    def close(self) -> None:
        """End the processes of the cells; may be called again."""
        ...


class EndlessInsertions:
    """`EndlessCells` in this process.

    Args:
        insertions: the cells.
        tasks: source of the episodes.
        seed: seed of their draw.
    """

    def __init__(self, insertions: Insertions, tasks: TaskSource, seed: int | list[int] = 0) -> None:
        self._cells = insertions
        self._tasks = tasks
        self._rng = np.random.default_rng(seed)
        self._returns = np.zeros(insertions.n)
        self.n = insertions.n
        self.workers = 1
        self.feature_size = insertions.observation_size + PRIVILEGED_SIZE
        self.action_size = insertions.action_size

    def reset(self) -> Float32Array:
        self._cells.reset(np.arange(self.n), self._tasks.draw(self._rng, self.n))
        self._returns[:] = 0.0
        return self._features()

    def step(self, action: npt.NDArray[Any]) -> Step:
        outcome = self._cells.step(action)
        done = outcome.terminated | outcome.truncated
        self._returns += outcome.reward
        over = np.flatnonzero(done)
        ended = Ended(
            outcome.success[over],
            outcome.fault[over],
            self._cells.steps[over],
            outcome.peak_force[over],
            self._returns[over],
        )
        if over.size:
            self._returns[over] = 0.0
            self._cells.reset(over, self._tasks.draw(self._rng, over.size))
        return Step(self._features(), outcome.reward.astype(np.float32), done, ended)

    def run(self, jobs: Sequence[WorkerJob]) -> list[Any]:
        return [job() for job in jobs]

    def close(self) -> None:
        """Do nothing: there is no process to end."""

    def _features(self) -> Float32Array:
        return np.concatenate([self._cells.observation, self._cells.privileged()], axis=1)
