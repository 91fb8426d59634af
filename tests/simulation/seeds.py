"""Lives through many seeds on all cores."""

import gc
import multiprocessing
import os
import sys
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field

from tests.simulation.story import Outcome, tell


@dataclass
class Report:
    """Outcome of many seeds.

    Attributes:
        failed: seed and its violations.
        simulated_s: simulated time of all seeds together.
        computed_s: processor time of all seeds together.
    """

    failed: list[tuple[int, tuple[str, ...]]] = field(default_factory=list)
    count: int = 0
    simulated_s: float = 0.0
    computed_s: float = 0.0

    def add(self, outcome: Outcome) -> None:
        self.count += 1
        self.simulated_s += outcome.simulated_s
        self.computed_s += outcome.took_s
        if outcome.violations:
            self.failed.append((outcome.seed, outcome.violations))

    def text(self, wall_s: float) -> str:
        lines = [
            f"seed {seed}: {'; '.join(violations)}\n    replay: python -m tests.simulation --seed {seed}"
            for seed, violations in self.failed
        ]
        speed = self.simulated_s / self.computed_s if self.computed_s else 0.0
        lines.append(
            f"{self.count} seeds, {len(self.failed)} with violations; {self.simulated_s:.0f} s simulated in "
            f"{self.computed_s:.0f} s of processor time ({speed:.0f} times real time), {wall_s:.0f} s by the clock"
        )
        return "\n".join(lines)


def _begin() -> None:
    gc.collect()
    gc.freeze()  # what is imported stays: a collection after each seed is then short
    gc.disable()  # each universe collects at its end


def live_through(seeds: Iterable[int], workers: int | None = None, *, progress: bool = False) -> Report:
    """Live through seeds in processes of their own; return what came of them."""
    report = Report()
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers or os.cpu_count(), context, initializer=_begin) as pool:
        for outcome in pool.map(_told, seeds, chunksize=8):
            report.add(outcome)
            if progress:
                print(f"\r{report.count} seeds, {len(report.failed)} with violations", end="", file=sys.stderr)
    if progress:
        print(file=sys.stderr)
    return report


def _told(seed: int) -> Outcome:
    return tell(seed).without_trace()
