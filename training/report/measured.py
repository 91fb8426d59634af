"""Results by name, and figures as text."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from training.evaluation.evaluate import FIRST_TEST_SEED
from training.evaluation.provenance import DIRTY
from training.evaluation.results import Block, Results, Setting, Through
from training.report import curves, paper
from training.report.curves import Curve
from wire.modes import LockMode
from wire.task import Conditions, Part

NOT_MEASURED = "not measured"
EPISODES = 500
"""Number of tests per figure of the paper's Table I; a figure from fewer names its count."""


@dataclass(frozen=True, slots=True)
class Measured:
    """Everything that was measured.

    Attributes:
        results: results by name of their file.
        curves: learning curves.
    """

    results: Mapping[str, Results]
    curves: tuple[Curve, ...]

    @classmethod
    def read(cls, folder: Path) -> "Measured":
        """Read a folder of results; a measurement that was broken off counts up to its first missing seed.

        Raises:
            ResultsError: a file does not hold what it should.
        """
        results = {path.stem: Results.load(path).unbroken() for path in sorted(folder.glob("*.json"))}
        return cls(results, tuple(curves.load(folder)))

    def block(
        self,
        name: str,
        clearance_mm: float,
        part: Part = "tr",
        *,
        conditions: Conditions | None = None,
        lock: LockMode | None = None,
        through: Through = "environment",
    ) -> Block | None:
        """Return the measurement of a policy on test seeds, at the standard ceiling, in the paper's reward; or None.

        Args:
            name: name of its results.
            clearance_mm: clearance per face.
            part: peg and hole.
            conditions: distributions of the episodes; None: the standard ones of its mode.
            lock: lock that it ran with; None: its own.
            through: player of the episodes.
        """
        results = self.results.get(name)
        if results is None:
            return None
        block = results.block(
            Setting(
                part=part,
                clearance_m=paper.metres(clearance_mm),
                conditions=conditions or paper.conditions_for(results.mode),
                lock=lock or results.lock,
                through=through,
                first_seed=FIRST_TEST_SEED,
            )
        )
        return block if block.episodes else None


def percent(share: float) -> str:
    """Return a rate as text."""
    return f"{share:.1%}".replace("%", " %")


def printed(share: float) -> str:
    """Return a rate with the digits that the paper prints."""
    return f"{100 * share:.2f} %"


def success(block: Block | None) -> str:
    """Return a success rate with its interval, and its count if that is less than the paper's."""
    if block is None:
        return NOT_MEASURED
    few = f", n = {len(block.episodes)}" if len(block.episodes) < EPISODES else ""
    return f"**{percent(block.rate)}** {interval(*block.interval)}{few}"


def interval(low: float, high: float) -> str:
    """Return an interval as text."""
    return f"({100 * low:.1f}–{100 * high:.1f})"


def deep_success(block: Block | None) -> str:
    """Return the rate at which the policy, left on, went to the depth of the author's code."""
    deep = [] if block is None else [e.success_10mm for e in block.episodes if e.success_10mm is not None]
    return percent(float(np.mean(deep))) if deep else "–"


def peaks(block: Block | None) -> str:
    """Return median, 99th percentile and maximum of the peak force, over episodes with a step of the policy."""
    played = () if block is None else tuple(episode for episode in block.episodes if episode.steps)
    if block is None or not played:
        return "–"
    return " / ".join(f"{value:.1f}" for value in block.model_copy(update={"episodes": played}).peaks)


def mean_steps(block: Block | None) -> str:
    """Return the mean steps of the policy per episode."""
    return "–" if block is None else f"{np.mean([e.steps for e in block.episodes]):.0f}"


def returns(block: Block | None) -> tuple[str, str]:
    """Return mean and variance of the return."""
    found = [] if block is None else [e.episode_return for e in block.episodes if e.episode_return is not None]
    return (signed(float(np.mean(found))), signed(float(np.var(found)))) if found else ("–", "–")


def signed(value: float) -> str:
    """Return a signed number as text."""
    return f"{value:.4f}".replace("-", "−")


def commit_name(commit: str | None) -> str:
    """Return a commit, shortened, with its mark."""
    return "unknown" if commit is None else commit[:9] + (DIRTY if commit.endswith(DIRTY) else "")


def duration(seconds: float) -> str:
    """Return a wall-clock time as text."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"
