"""What there is to report: results by name, and how a figure is put into words."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from training.evaluation.evaluate import FIRST_TEST_SEED
from training.evaluation.provenance import DIRTY
from training.evaluation.results import Block, Results, Setting, Through
from training.report import curves, paper
from training.report.curves import Curve
from wire.limits import LockMode
from wire.task import Conditions, Part

NOT_MEASURED = "not measured"
EPISODES = 500
"""The paper's count of tests per figure of Table I; a figure from fewer says so."""


@dataclass(frozen=True, slots=True)
class Measured:
    """Everything that was measured.

    Attributes:
        results: by name of the policy's file.
        curves: of trainings.
    """

    results: Mapping[str, Results]
    curves: tuple[Curve, ...]

    @classmethod
    def read(cls, folder: Path) -> "Measured":
        """Read a folder of results; of a measurement that was broken off, the episodes whose seeds follow one another.

        Raises:
            ResultsError: a file that does not hold what it should.
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
        """The measurement of a policy on test seeds, at the standard ceiling, returns the paper's; or None.

        Args:
            name: of its results.
            clearance_mm: per face.
            part: peg and hole.
            conditions: None: the standard ones of its mode.
            lock: None: its own.
            through: what played.
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
    """A rate as text."""
    return f"{share:.1%}".replace("%", " %")


def printed(share: float) -> str:
    """A rate with the digits that the paper prints."""
    return f"{100 * share:.2f} %"


def success(block: Block | None) -> str:
    """A success rate with its interval, and its count where that is less than the paper's."""
    if block is None:
        return NOT_MEASURED
    few = f", n = {len(block.episodes)}" if len(block.episodes) < EPISODES else ""
    return f"**{percent(block.rate)}** {interval(*block.interval)}{few}"


def interval(low: float, high: float) -> str:
    """An interval as text."""
    return f"({100 * low:.1f}–{100 * high:.1f})"


def deep_success(block: Block | None) -> str:
    """The rate at which the policy, left on, went to the depth of the author's code."""
    deep = [] if block is None else [e.success_10mm for e in block.episodes if e.success_10mm is not None]
    return percent(float(np.mean(deep))) if deep else "–"


def peaks(block: Block | None) -> str:
    """Median, 99th percentile and maximum of the peak force, of the episodes in which the policy had a step."""
    played = () if block is None else tuple(episode for episode in block.episodes if episode.steps)
    if block is None or not played:
        return "–"
    return " / ".join(f"{value:.1f}" for value in block.model_copy(update={"episodes": played}).peaks)


def mean_steps(block: Block | None) -> str:
    """Steps of the policy per episode."""
    return "–" if block is None else f"{np.mean([e.steps for e in block.episodes]):.0f}"


def returns(block: Block | None) -> tuple[str, str]:
    """Mean and variance of the return."""
    found = [] if block is None else [e.episode_return for e in block.episodes if e.episode_return is not None]
    return (signed(float(np.mean(found))), signed(float(np.var(found)))) if found else ("–", "–")


def signed(value: float) -> str:
    """A return as text."""
    return f"{value:.4f}".replace("-", "−")


def commit_name(commit: str | None) -> str:
    """A commit, shortened, with its mark."""
    return "unknown" if commit is None else commit[:9] + (DIRTY if commit.endswith(DIRTY) else "")


def duration(seconds: float) -> str:
    """A wall-clock time as text."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"
