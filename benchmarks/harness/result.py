"""Result of one benchmark, its figures with their limits, and quantiles of durations."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

QUANTILES = ("p50", "p99", "p99.9", "max")


class UnavailableError(Exception):
    """This machine or checkout cannot make the measurement; the text says what is missing."""


@dataclass(frozen=True, slots=True)
class Figure:
    """One number that two runs can be compared by.

    Attributes:
        name: what was measured.
        value: as measured.
        unit: of `value` and `limit`; a ratio says to what.
        limit: bound that the project sets itself.
        at_least: True if the limit is a lower bound.
    """

    name: str
    value: float
    unit: str
    limit: float
    at_least: bool = False

    @property
    def holds(self) -> bool:
        return self.value >= self.limit if self.at_least else self.value <= self.limit


@dataclass(frozen=True, slots=True)
class Result:
    """One table.

    Attributes:
        question: question that the table answers.
        columns: headings, units included.
        rows: one value per column.
        finding: the decisive ratio, in a sentence.
        method: method of measurement, as far as the rows do not show it.
        figures: decisive numbers, each with its limit.
        missing: reason why there are no rows; empty otherwise.
    """

    question: str
    columns: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    finding: str = ""
    method: str = ""
    figures: tuple[Figure, ...] = ()
    missing: str = ""


def quantiles(spans_s: Sequence[float], unit_s: float = 1e-6) -> tuple[str, ...]:
    """Return `QUANTILES` of durations in s, as text in units of `unit_s`."""
    values = np.quantile(np.asarray(spans_s), (0.5, 0.99, 0.999, 1.0)) / unit_s
    return tuple(f"{value:.3g}" if value < 100 else f"{value:.0f}" for value in values)


def quantile_figures(
    name: str, spans_s: Sequence[float], limits: Mapping[str, float], unit_s: float = 1e-6, unit: str = "µs"
) -> tuple[Figure, ...]:
    """Return one figure per limit.

    Args:
        name: of what lasted.
        spans_s: durations, s.
        limits: largest value by its quantile, such as `p99`, in `unit`.
        unit_s: one `unit`, s.
        unit: for people.
    """
    shares = {quantile: float(quantile[1:]) / 100.0 for quantile in limits}
    return tuple(
        Figure(f"{name}, {quantile}", float(np.quantile(spans_s, share)) / unit_s, unit, limits[quantile])
        for quantile, share in shares.items()
    )


def median(spans_s: Sequence[float]) -> float:
    return float(np.median(np.asarray(spans_s)))
