"""The report's pictures as SVG text; the same data give the same bytes."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7a5c3e")
"""Colours that colour-blind readers can tell apart (Okabe and Ito); further series repeat them, dashed."""
DASHES = ("-", "--", ":")
PAPER = "#333333"
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "report",
    "font.family": "sans-serif",
    "font.size": 10.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#8a94a1",
    "axes.labelcolor": "#1c2430",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.titlelocation": "left",
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "grid.color": "#e4e8ed",
    "xtick.color": "#5b6675",
    "ytick.color": "#5b6675",
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
}


@dataclass(frozen=True, slots=True)
class Rate:
    """A success rate with its interval, at a clearance in mm."""

    clearance_mm: float
    rate: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class PlotLine:
    """One curve: `x` (k,), and `y` (seeds, k) where each row is a seed's."""

    name: str
    x: Sequence[float]
    y: Sequence[Sequence[float]]


@dataclass(frozen=True, slots=True)
class Compared:
    """A row of a dot plot: the paper's span of printed values with its interval, and ours by name."""

    name: str
    paper: tuple[float, float]
    paper_interval: tuple[float, float]
    ours: Sequence[tuple[str, float, float, float]]


def success_by_clearance(
    series: Sequence[tuple[str, Sequence[Rate]]],
    paper: Sequence[tuple[float, float]],
    targets: Sequence[tuple[float, float]],
) -> str:
    """Draw success against clearance on a logarithmic axis.

    Args:
        series: name and rates of each policy.
        paper: clearance in mm and printed rate.
        targets: clearance in mm and our target.
    """
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(9.2, 4.2))
        axes = figure.subplots()
        for number, (name, rates) in enumerate(series):
            x = [rate.clearance_mm for rate in rates]
            y = np.array([rate.rate for rate in rates])
            reach = np.abs(np.array([[rate.low, rate.high] for rate in rates]).T - y)
            axes.errorbar(
                x, y, reach, **_look(number), marker="o", markersize=4.5, linewidth=1.6, capsize=3, label=name
            )
        if targets:
            axes.scatter(*zip(*targets, strict=True), marker="_", s=260, linewidth=2, color="#8a94a1", label="target")
        if paper:
            axes.scatter(*zip(*paper, strict=True), marker="D", s=42, color=PAPER, zorder=3, label="the paper")
        levels = sorted({rate.clearance_mm for _, rates in series for rate in rates} | {c for c, _ in targets})
        axes.set_xscale("log")
        axes.set_xticks(levels, [f"{level:g}" for level in levels])
        axes.minorticks_off()
        axes.set_xlabel("clearance per face, mm")
        _as_rate(axes)
        _legend(figure, axes)
        return _svg(figure)


def learning(lines: Sequence[PlotLine], returns: Sequence[PlotLine], reward: str) -> str:
    """Draw success and return of the evaluations over a training; seeds thin, their mean thick.

    Args:
        lines: success of the evaluations.
        returns: mean return of the same evaluations.
        reward: name of the reward.
    """
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(9.2, 3.6))
        left, right = figure.subplots(1, 2)
        for axes, many in ((left, lines), (right, returns)):
            for number, line in enumerate(many):
                x = np.array(line.x) / 1e6
                if len(line.y) > 1:
                    for row in line.y:
                        axes.plot(x, row, **_look(number), linewidth=0.7, alpha=0.4)
                axes.plot(x, np.mean(line.y, axis=0), **_look(number), linewidth=2.0, label=line.name)
            axes.set_xlabel("environment steps, millions")
            axes.set_xlim(left=0)
        left.set_title("success")
        _as_rate(left)
        right.set_title(f"mean return ({reward} reward)")
        _legend(figure, left)
        return _svg(figure)


def against_paper(rows: Sequence[Compared]) -> str:
    """Draw one line per cell of a table: the paper's printed span and our rates, each with its interval."""
    with mpl.rc_context(_STYLE):
        names = list(dict.fromkeys(name for row in rows for name, *_ in row.ours))
        figure = Figure(figsize=(9.2, 0.9 + 0.5 * len(rows)))
        axes = figure.subplots()
        lift = 0.5 / (len(names) + 1)
        for number, row in enumerate(rows):
            y = number - 0.25 + lift / 2
            axes.hlines(y, *row.paper_interval, color=PAPER, linewidth=1.0)
            axes.scatter(row.paper, [y] * 2, marker="D", s=26, color=PAPER, zorder=3, label="the paper")
            for name, rate, low, high in row.ours:
                place = names.index(name)
                level = y + lift * (place + 1)
                look = _look(place)
                axes.hlines(level, low, high, **look, linewidth=1.6)
                axes.scatter([rate], [level], s=30, color=look["color"], zorder=3, label=name)
        axes.set_yticks(range(len(rows)), [row.name for row in rows])
        axes.set_ylim(len(rows) - 0.5, -0.5)
        axes.grid(visible=False, axis="y")
        axes.set_xlim(-0.02, 1.02)
        axes.xaxis.set_major_formatter(PercentFormatter(1.0))
        axes.set_xlabel("success")
        _legend(figure, axes)
        return _svg(figure)


def peak_forces(panels: Sequence[tuple[str, Sequence[tuple[str, Sequence[float]]]]], limit_n: float) -> str:
    """Draw the share of episodes whose peak force stays below a force, one panel per clearance.

    Args:
        panels: title of each panel, and name and peak forces in N of each policy.
        limit_n: force to mark.
    """
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(9.2, 3.5))
        many = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
        series_names = list(dict.fromkeys(name for _, series in panels for name, _ in series))
        for axes, (title, series) in zip(many, panels, strict=True):
            for name, peaks in series:
                if len(peaks):
                    axes.ecdf(peaks, **_look(series_names.index(name)), linewidth=1.8, label=name)
            axes.axvline(limit_n, color="#8a94a1", linestyle=":", linewidth=1.2)
            axes.set_title(title)
            axes.set_xlabel("peak force of an episode, N")
            axes.set_xlim(left=0)
            _as_rate(axes)
        many[0].set_ylabel("episodes below it")
        _legend(figure, *many)
        return _svg(figure)


def _look(number: int) -> dict[str, Any]:
    """Return colour and dashes of a series."""
    again, colour = divmod(number, len(COLOURS))
    return {"color": COLOURS[colour], "linestyle": DASHES[again % len(DASHES)]}


def _as_rate(axes: Axes) -> None:
    axes.set_ylim(-0.02, 1.02)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))


def _legend(figure: Figure, *panels: Axes) -> None:
    """Name every series once, to the right of the panels."""
    once: dict[str, Any] = {}
    for axes in panels:
        handles, names = axes.get_legend_handles_labels()
        once = dict(zip(names, handles, strict=True)) | once
    figure.legend(once.values(), once.keys(), loc="outside right upper", fontsize=9.5)


def _svg(figure: Figure) -> str:
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    return text.getvalue()[text.getvalue().index("<svg") :]
