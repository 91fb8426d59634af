"""Result of one benchmark, and quantiles of durations."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

QUANTILES = ("p50", "p99", "p99.9", "max")


class UnavailableError(Exception):
    """This machine or checkout cannot make the measurement; the text says what is missing."""


@dataclass(frozen=True, slots=True)
class Result:
    """One table.

    Attributes:
        question: question that the table answers.
        columns: headings, units included.
        rows: one value per column.
        finding: the decisive ratio, in a sentence.
        method: method of measurement, as far as the rows do not show it.
        missing: reason why there are no rows; empty otherwise.
    """

    question: str
    columns: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    finding: str = ""
    method: str = ""
    missing: str = ""


def quantiles(spans_s: Sequence[float], unit_s: float = 1e-6) -> tuple[str, ...]:
    """Return `QUANTILES` of durations in s, as text in units of `unit_s`."""
    values = np.quantile(np.asarray(spans_s), (0.5, 0.99, 0.999, 1.0)) / unit_s
    return tuple(f"{value:.3g}" if value < 100 else f"{value:.0f}" for value in values)


def median(spans_s: Sequence[float]) -> float:
    return float(np.median(np.asarray(spans_s)))
