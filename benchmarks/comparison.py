"""Two commits measured by turns, and the ratio of each figure with its interval.

Both are measured with the benchmarks of this checkout. A figure's ratio is taken within each turn, so that a change of
the host's load from one turn to the next cancels. The interval is a percentile bootstrap over the turns.
"""

import io
import json
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

from benchmarks.harness.machine import load
from benchmarks.harness.processes import ROOT

RESAMPLES = 10_000
CONFIDENCE = 0.95
Values = dict[str, tuple[float, str]]
"""Value and unit of each figure."""


class CommitError(Exception):
    """There is no such commit."""


class Change(NamedTuple):
    """One figure of two commits.

    Attributes:
        name: of the figure.
        unit: of the medians.
        before: median over the turns.
        after: the same of the other commit.
        ratio: geometric mean over the turns of after to before.
        interval: lower and upper bound of the ratio.
    """

    name: str
    unit: str
    before: float
    after: float
    ratio: float
    interval: tuple[float, float]

    @property
    def is_clear(self) -> bool:
        """True if the interval does not contain 1."""
        return not self.interval[0] <= 1.0 <= self.interval[1]


def change(name: str, unit: str, before: Sequence[float], after: Sequence[float]) -> Change:
    """Compare one figure.

    Args:
        name: of the figure.
        unit: of the values.
        before: positive values, one per turn.
        after: the same of the other commit, in the same order.
    """
    logs = np.log(np.asarray(after) / np.asarray(before))
    draws = np.random.default_rng(0).integers(len(logs), size=(RESAMPLES, len(logs)))
    rest = 50.0 * (1.0 - CONFIDENCE)
    lower, upper = np.exp(np.percentile(logs[draws].mean(axis=1), (rest, 100.0 - rest))).tolist()
    medians = float(np.median(before)), float(np.median(after))
    return Change(name, unit, *medians, float(np.exp(logs.mean())), (lower, upper))


def compare(
    commits: tuple[str, str], names: Sequence[str], turns: int, tell: Callable[[str], object]
) -> tuple[Change, ...]:
    """Measure two commits by turns.

    Args:
        commits: before and after.
        names: benchmarks to run.
        turns: measurements of each commit.
        tell: takes a line after each measurement.

    Returns:
        One change for each figure that both commits gave in every turn.

    Raises:
        CommitError: a commit is unknown.
    """
    taken: tuple[list[Values], list[Values]] = ([], [])
    with tempfile.TemporaryDirectory() as folder:
        trees = [_check_out(commit, Path(folder) / side) for commit, side in zip(commits, ("a", "b"), strict=True)]
        for turn in range(turns):
            for commit, tree, values in zip(commits, trees, taken, strict=True):
                begun = load()
                values.append(_measure(tree, names))
                tell(f"turn {turn + 1} of {turns}: {commit}, {len(values[-1])} figures, load before {begun}")
    return tuple(
        change(name, unit, [one[name][0] for one in taken[0]], [one[name][0] for one in taken[1]])
        for name, (_, unit) in taken[0][0].items()
        if all(one.get(name, (0.0, ""))[0] > 0.0 for side in taken for one in side)
    )


def table(changes: Sequence[Change], turns: int) -> Table:
    """Return the changes for people."""
    shown = Table("figure", "before", "after", "after / before", f"{CONFIDENCE:.0%} interval", "clear")
    shown.caption = f"{turns} turns; medians; ratio within each turn, geometric mean; interval by bootstrap over turns"
    for one in changes:
        lower, upper = one.interval
        values = f"{one.before:.3g} {one.unit}", f"{one.after:.3g} {one.unit}", f"{one.ratio:.2f}"
        shown.add_row(one.name, *values, f"{lower:.2f} to {upper:.2f}", "yes" if one.is_clear else "no")
    return shown


def _check_out(commit: str, tree: Path) -> Path:
    """Write the files of a commit, with the present benchmarks in place of its own."""
    done = subprocess.run(["git", "archive", commit], cwd=ROOT, capture_output=True)  # noqa: S607  # any git will do
    if done.returncode != 0:
        raise CommitError(f"{commit}: {done.stderr.decode().strip()}")
    with tarfile.open(fileobj=io.BytesIO(done.stdout)) as archive:
        archive.extractall(tree, filter="data")
    shutil.rmtree(tree / "benchmarks", ignore_errors=True)
    shutil.copytree(ROOT / "benchmarks", tree / "benchmarks", ignore=shutil.ignore_patterns("results", "__pycache__"))
    return tree


def _measure(tree: Path, names: Sequence[str]) -> Values:
    """Return the figures of a tree; those of a benchmark that it cannot run are missing."""
    with tempfile.TemporaryDirectory() as out:
        subprocess.run(
            [sys.executable, "-m", "cli", "bench", "--short", "--out", out, *names],
            cwd=tree,
            env=os.environ | {"PYTHONPATH": str(tree)},
            capture_output=True,
        )
        latest = Path(out) / "latest.json"
        results: dict[str, Any] = json.loads(latest.read_text("utf-8"))["results"] if latest.is_file() else {}
    figures = [figure for result in results.values() for figure in result["figures"]]
    return {figure["name"]: (float(figure["value"]), str(figure["unit"])) for figure in figures}
