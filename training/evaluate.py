"""How good a policy is: independent episodes, a fixed number per cell, deterministic, on seeds never trained on."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.policy.contract import EvaluationFigure
from service.policy.model import Policy
from sim_backend.protocol.task import Conditions, Part, Task
from training.insertion import Insertions

FIRST_TEST_SEED = 1_000_000
"""Seeds of the test: from here up. Seeds below choose between models; seeds of training are above 2³²."""
WILSON_Z = 1.959964
"""For a 95 % interval."""


@dataclass(frozen=True, slots=True)
class EpisodeResult:
    """How one episode ended."""

    seed: int
    success: bool
    fault: bool
    steps: int
    peak_force_n: float
    episode_return: float


@dataclass(frozen=True, slots=True)
class Report:
    """Results of one condition."""

    clearance_m: float
    conditions: Conditions
    episodes: tuple[EpisodeResult, ...]

    @property
    def successes(self) -> int:
        return sum(e.success for e in self.episodes)

    @property
    def rate(self) -> float:
        return self.successes / len(self.episodes)

    @property
    def interval(self) -> tuple[float, float]:
        """95 % Wilson interval of the success rate."""
        return wilson(self.successes, len(self.episodes))

    def figure(self) -> EvaluationFigure:
        """For the policy's contract."""
        peaks = np.array([e.peak_force_n for e in self.episodes])
        low, high = self.interval
        return EvaluationFigure(
            clearance_m=self.clearance_m,
            conditions=self.conditions,
            episodes=len(self.episodes),
            successes=self.successes,
            low=round(low, 4),
            high=round(high, 4),
            peak_force_median_n=round(float(np.median(peaks)), 2),
            peak_force_max_n=round(float(peaks.max()), 2),
        )

    def line(self) -> str:
        """One row of a table."""
        peaks = np.percentile([e.peak_force_n for e in self.episodes], [50, 99, 100])
        low, high = self.interval
        steps = np.mean([e.steps for e in self.episodes])
        success = f"{self.successes}/{len(self.episodes)} = {self.rate:.1%} ({low:.1%} to {high:.1%})"
        return (
            f"| {self.clearance_m * 1e3:.2f} | {self.conditions} | {success} | {steps:.0f} | "
            f"{peaks[0]:.1f} / {peaks[1]:.1f} / {peaks[2]:.1f} | {sum(e.fault for e in self.episodes)} |"
        )


HEADER = (
    "| clearance, mm | conditions | success (95 % interval) | mean steps | peak force median/p99/max, N | faults |\n"
    "|---|---|---|---|---|---|"
)


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """95 % Wilson score interval of a proportion (Wilson 1927).

    Raises:
        ValueError: no trials.
    """
    if trials < 1:
        raise ValueError("an interval needs at least one trial")
    z2 = WILSON_Z**2
    share = successes / trials
    centre = (share + z2 / (2 * trials)) / (1 + z2 / trials)
    half = WILSON_Z / (1 + z2 / trials) * np.sqrt(share * (1 - share) / trials + z2 / (4 * trials**2))
    return max(0.0, float(centre - half)), min(1.0, float(centre + half))


def evaluate(
    policy: Policy,
    clearance_m: float,
    episodes: int = 500,
    *,
    part: Part = "tr",
    conditions: Conditions = "standard",
    first_seed: int = FIRST_TEST_SEED,
    cells: int = 100,
    threads: int = 0,
    force_ceiling_n: float = 30.0,
    on_episodes: Callable[[int], object] = lambda _: None,
) -> Report:
    """Play `episodes` episodes, seeds from `first_seed` up, one after another in each of `cells` cells.

    `on_episodes` is told how many episodes have ended since the last time.

    Every cell plays the same number, whatever becomes of them: a window of time would count fast successes more often.

    Raises:
        ValueError: the episodes do not divide evenly over the cells.
    """
    cells = min(cells, episodes)
    if episodes % cells:
        raise ValueError(f"{episodes} episodes do not divide evenly over {cells} cells")
    insertions = Insertions(policy.contract, cells, part, threads, force_ceiling_n)
    results: list[EpisodeResult] = []
    for begin in range(first_seed, first_seed + episodes, cells):
        results += _round(insertions, policy, [Task(begin + i, part, clearance_m, conditions) for i in range(cells)])
        on_episodes(cells)
    return Report(clearance_m, conditions, tuple(results))


def _round(insertions: Insertions, policy: Policy, tasks: list[Task]) -> list[EpisodeResult]:
    """One episode in every cell; a cell that has finished idles until the others have."""
    everyone = np.arange(insertions.n)
    observation = insertions.reset(everyone, tasks)
    hidden = policy.initial_hidden((insertions.n,))
    running: npt.NDArray[np.bool_] = np.ones(insertions.n, np.bool_)
    results: dict[int, EpisodeResult] = {}
    returns = np.zeros(insertions.n)
    while running.any():
        action, hidden = policy.act(observation, hidden)
        outcome = insertions.step(np.where(running[:, None], action, 0.0))
        observation = outcome.observation
        returns += np.where(running, outcome.reward, 0.0)
        for cell in np.flatnonzero(running & (outcome.terminated | outcome.truncated)):
            results[int(cell)] = EpisodeResult(
                seed=tasks[cell].seed,
                success=bool(outcome.success[cell]),
                fault=bool(outcome.fault[cell]),
                steps=int(insertions.steps[cell]),
                peak_force_n=float(outcome.peak_force[cell]),
                episode_return=float(returns[cell]),
            )
        ended = outcome.terminated | outcome.truncated
        insertions.world.stop(np.flatnonzero(running & ended))
        running &= ~ended
    return [results[cell] for cell in range(insertions.n)]
