"""The chapters beside the paper: Table I, both figures, Table II, and where the paper contradicts itself."""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from sim_backend.world.parts import PARTS, proportion
from training.evaluation.results import Block as Measurement
from training.evaluation.results import Through, wilson
from training.report import paper, plots, policies
from training.report.curves import Curve, CurvePoint
from training.report.document import Heading, Judged, Paragraph, Picture, ReportBlock, Table
from training.report.measured import (
    NOT_MEASURED,
    Measured,
    deep_success,
    duration,
    interval,
    peaks,
    percent,
    printed,
    returns,
    signed,
    success,
)
from training.report.paper import Comparison, Gap, Table1Row, Table2, TransferCell

_HOW: dict[Through, str] = {"environment": "", "zenoh": ", service over Zenoh", "rtde": ", service over RTDE"}


def table_1(measured: Measured, comparison: Comparison) -> Iterator[ReportBlock]:
    """Give Table I: per gap, the paper, our runs of its experiment, and our one policy for every clearance."""
    yield Heading("Table I: what is observed, and the lock")
    yield Table(
        ["", "reproduced", "one policy"],
        [
            ["what it is", "the paper's experiment, run by us", "one policy for every clearance"],
            ["trained and tested", "at the clearance of its row, one policy per gap", "over a range of clearances"],
            ["steps", "2 M; 1 M at c = 4.0 and 1.0 mm", "see the last chapter"],
            ["network", "without memory", "with memory"],
            ["reward", "the paper's", "ours"],
            ["kinds of input, lock", "the paper's", "as the row says"],
            ["entries of the observation, compliance law, critic", "ours", "ours"],
        ],
    )
    yield Paragraph(
        "The weights of a reproduction are those that did best in an evaluation, from one training each. Intervals are "
        "over test episodes, not over trainings. Variances are over episodes. FTM plays in the conditions `search`, "
        "the others in `standard`."
    )
    yield Paragraph(
        "Returns are sums of equations 1 and 2, with lengths in m and a scale of 1. The paper does not state its "
        "scale, so only our own returns can be compared with each other."
    )
    for told in _differing(measured, comparison):
        yield Paragraph(told)
    for index, gap in enumerate(comparison.table_1.gaps):
        real, simulated = gap.clearance_mm
        yield Heading(f"Gap {gap.name}: c = {real:g} mm on the real part, {simulated:g} mm in the simulated scene", 3)
        yield _gap_table(measured, comparison.table_1.rows, gap, index)
    yield from _orderings(measured, comparison)


def _differing(measured: Measured, comparison: Comparison) -> list[str]:
    """Say how training and lock of the rows differ from each other and from the paper's."""
    rows, levels = comparison.table_1.rows, [level for gap in comparison.table_1.gaps for level in gap.clearance_mm]
    ours = [row.ours for row in rows]
    reproduced = [row.reproduction(level) for row in rows for level in levels]
    told = (policies.pressing(measured, ours + reproduced), policies.trained(measured, ours))
    return [text for text in told if text]


def _gap_table(measured: Measured, rows: Sequence[Table1Row], gap: Gap, index: int) -> Table:
    lines: list[list[str | Judged]] = []
    groups: set[int] = set()
    for row in rows:
        groups.add(len(lines))
        if index < len(row.printed):
            theirs = row.printed[index]
            told = [printed(theirs.success), "", "", signed(theirs.reward), signed(theirs.reward_variance)]
        else:
            told = ["–", "", "", "–", "–"]
        lines.append([f"**{row.name}**", "the paper", gap.name, *told, ""])
        for label in ("reproduced", "one policy"):
            for clearance in gap.clearance_mm:
                name = row.ours if label == "one policy" else row.reproduction(clearance)
                block = measured.block(name, clearance)
                count = "" if block is None else str(len(block.episodes))
                lines.append(
                    [
                        "",
                        label,
                        f"{clearance:g} mm",
                        success(block),
                        deep_success(block),
                        count,
                        *returns(block),
                        peaks(block),
                    ]
                )
    header = [
        "",
        "",
        "gap or c",
        "success (95 % interval)",
        "10 mm deep",
        "episodes",
        "return, mean",
        "variance",
        "peak force median / p99 / max, N",
    ]
    return Table(header, lines, frozenset(groups))


def _orderings(measured: Measured, comparison: Comparison) -> Iterator[ReportBlock]:
    """Say whether the paper's two orderings appear among our runs of its experiments."""
    lines: list[list[str | Judged]] = []
    for clearance in sorted({level for gap in comparison.table_1.gaps for level in gap.clearance_mm}, reverse=True):
        found = {row.name: measured.block(row.reproduction(clearance), clearance) for row in comparison.table_1.rows}
        for names in (("VFTM-DSL", "FTM-DSL", "VM"), ("VFTM-DSL", "VFTM-sliding")):
            blocks = [block for name in names if (block := found.get(name)) is not None]
            if len(blocks) == len(names):
                told = ", ".join(f"{name} {percent(block.rate)}" for name, block in zip(names, blocks, strict=True))
                lines.append([f"{clearance:g} mm", " > ".join(names), told, _in_order(blocks)])
    if lines:
        yield Heading("Does the paper's order appear?", 3)
        yield Table(["c", "the paper's order", "reproduced", "verdict"], lines)


def _in_order(blocks: Sequence[Measurement]) -> Judged:
    pairs = list(pairwise(blocks))
    if all(one.interval[0] > other.interval[1] for one, other in pairs):
        return Judged("yes", "good")
    if all(one.rate > other.rate for one, other in pairs):
        return Judged("yes, but intervals overlap", "good")
    return Judged("no", "bad")


def learning_curves(measured: Measured, comparison: Comparison) -> Iterator[ReportBlock]:
    """Draw the figures of the paper: success and return of evaluations as training goes on."""
    yield Heading("Learning curves")
    yield Paragraph(
        "The deterministic policy is evaluated on the validation's seeds, which are used for neither training nor "
        "test. Thin lines are single seeds. The thick line is their mean."
    )
    for figure in comparison.curves:
        series: list[tuple[str, list[Curve], float | None]] = []
        for run in figure.runs:
            curves = [curve for curve in measured.curves if curve.experiment == run.experiment and curve.evaluations]
            if curves and figure.by_clearance:
                levels = sorted({point.clearance_mm for curve in curves for point in curve.evaluations}, reverse=True)
                series += [(f"{run.name}, {level:g} mm", curves, level) for level in levels]
            elif curves:
                series.append((run.name, curves, None))
        yield Heading(figure.title, 3)
        known = {curve.experiment for curve in measured.curves}
        missing = [run.experiment for run in figure.runs if run.experiment not in known]
        if missing:
            yield Paragraph(f"No curve yet of {', '.join(f'`{name}`' for name in missing)}.")
        if not series:
            continue
        rewards = sorted({curve.reward for _, curves, _ in series for curve in curves})
        told = "; ".join(
            f"{name}: {len(curves)} seed{'s' if len(curves) > 1 else ''}, {_last(curves, level)}"
            for name, curves, level in series
        )
        svg = plots.learning(
            [_line(name, curves, level, "success") for name, curves, level in series],
            [_line(name, curves, level, "return_mean") for name, curves, level in series],
            " and ".join(rewards),
        )
        yield Picture(f"curves-{figure.name}", svg, f"{figure.title}. {told}.")
    yield from _time_to_the_paper(measured, comparison)


def _time_to_the_paper(measured: Measured, comparison: Comparison) -> Iterator[ReportBlock]:
    """Say how long trainings took to reach the paper's success."""
    yield Heading("How soon the paper's success is reached", 3)
    lines: list[list[str | Judged]] = []
    for level in comparison.strength.levels:
        for curve in measured.curves:
            judged = [p for p in curve.evaluations if p.part == "tr" and p.clearance_mm == level.clearance_mm]
            if level.paper is None or curve.mode != "VFTM" or not judged:
                continue
            if not judged[0].steps and judged[0].success >= level.paper:
                continue  # it began with weights that had it
            point = curve.reached(level.paper, level.clearance_mm)
            reached = (
                ("not reached", "–") if point is None else (f"{point.steps / 1e6:.2f} M", duration(point.elapsed_s))
            )
            where = f"{level.clearance_mm:g} mm, `{judged[0].conditions}`"
            about = (where, printed(level.paper), curve.label, str(curve.seed))
            rate = f"{curve.steps / curve.elapsed_s:.0f}" if curve.elapsed_s else "–"
            episodes = str(max(point.episodes for point in judged))
            lines.append([*about, *reached, episodes, rate, curve.machine])
    if not lines:
        yield Paragraph("Not measured.")
        return
    yield Paragraph(
        "A level counts as reached at the first of two evaluations of the triangle in a row, or at the last "
        "evaluation, with at least the success of the paper's VFTM-DSL. Only policies that observe the same as that "
        "one are listed. The wall-clock includes evaluations and other work on the machine."
    )
    yield Paragraph(
        "An evaluation has few episodes and a training has many evaluations, so chance reaches such a level too soon. "
        "Where a training began with the weights of another one, the other's steps and time come on top. Trainings "
        "that had the level from the start are left out. The author's trainings took 3 to 5 hours for 2 M steps."
    )
    header = [
        "c, conditions",
        "the paper",
        "experiment",
        "seed",
        "reached after, steps",
        "wall-clock",
        "episodes per evaluation",
        "steps/s",
        "machine",
    ]
    yield Table(header, lines)


def _line(name: str, curves: Sequence[Curve], level: float | None, field: str) -> plots.PlotLine:
    """Return the evaluations that all seeds have, averaged over what was evaluated at each."""
    every = {point.steps for curve in curves for point in _of(curve, level)}
    steps = sorted(step for step in every if all(any(p.steps == step for p in _of(c, level)) for c in curves))
    rows = [
        [float(np.mean([getattr(p, field) for p in _of(curve, level) if p.steps == step])) for step in steps]
        for curve in curves
    ]
    return plots.PlotLine(name, steps, rows)


def _of(curve: Curve, level: float | None) -> list[CurvePoint]:
    return [point for point in curve.evaluations if level in (None, point.clearance_mm)]


def _last(curves: Sequence[Curve], level: float | None) -> str:
    """Say the success at the last evaluation that all seeds have, and its step."""
    line = _line("", curves, level, "success")
    if not line.x:
        return "no evaluation that all have"
    return f"{percent(float(np.mean([row[-1] for row in line.y])))} after {line.x[-1] / 1e6:.2f} M steps"


def table_2(measured: Measured, comparison: Comparison) -> Iterator[ReportBlock]:
    """Give Table II: other shapes, sizes and gaps, on a plant that nobody trained on."""
    table = comparison.table_2
    yield Heading("Table II: transfer to other shapes, sizes and another plant")
    others = ", ".join(f"`{name}`" for name in table.beside)
    yield Paragraph(
        f"`{table.results}` is trained on the triangle alone, like the paper's policy; {others} on all shapes. The "
        "paper tested each cell about 50 times on a real arm. Our cells are simulated in the conditions "
        f"`{table.conditions}`: a plant of its own in friction, stiffness, delay, sensor noise and bias."
    )
    yield Paragraph(
        "Where the paper's table and text differ, both figures stand here and the larger one has to be beaten. The "
        "interval of a figure of the paper follows from the count of tests that gives the figure."
    )
    lines: list[list[str | Judged]] = []
    compared: list[plots.Compared] = []
    groups: set[int] = set()
    for cell in table.cells:
        ours = float(proportion(PARTS[cell.part], paper.metres(cell.clearance_mm)))
        blocks = _cell_blocks(measured, comparison.table_2, cell)
        theirs = printed(cell.printed) + (f", in the text {printed(cell.text)}" if cell.text is not None else "")
        groups.add(len(lines))
        interval_of_paper = wilson(*cell.count)
        named = f"**{cell.part}**, {100 * cell.proportion:.4g} %"
        lines.append([named, "the paper", theirs + f" {interval(*interval_of_paper)}", "", "", "", ""])
        for number, (name, block) in enumerate(blocks.items()):
            first = "" if number else f"{100 * ours:.2f} % at c = {cell.clearance_mm:.2f} mm"
            count = "" if block is None else str(len(block.episodes))
            lines.append(
                [first, name, success(block), deep_success(block), count, peaks(block), beaten(block, cell.larger)]
            )
        compared.append(
            plots.Compared(
                f"{cell.part}, {cell.clearance_mm:.2f} mm",
                (cell.printed, cell.text if cell.text is not None else cell.printed),
                interval_of_paper,
                [
                    (name.replace("`", ""), block.rate, *block.interval)
                    for name, block in blocks.items()
                    if block is not None
                ],
            )
        )
    header = [
        "part, proportion",
        "",
        "success (95 % interval)",
        "10 mm deep",
        "episodes",
        "peak force, N",
        "against the paper",
    ]
    yield Table(header, lines, frozenset(groups))
    if any(row.ours for row in compared):
        caption = "Success per cell with 95 % intervals; diamonds are the paper's, two where its table and text differ."
        yield Picture("table-2", plots.against_paper(compared), caption)
    yield Paragraph(
        "The walls of the simulated hole yield a little. Of 9 insertions of b-trm at 0.33 mm that were looked at, one "
        "ended 0.63 mm in a wall, one 0.28 mm and seven less than 0.2 mm."
    )
    yield from _usual(measured, table)


def _usual(measured: Measured, table: Table2) -> Iterator[ReportBlock]:
    """Give the parts of Table II on the usual plant, which tells the shape's share from the plant's."""
    yield Heading(f"The other parts in the conditions `{table.usual}`", 3)
    yield Paragraph("The same parts and clearances on the plant that the policies were trained on.")
    names = [name for name in (table.results, *table.beside) if name in measured.results]
    lines: list[list[str | Judged]] = []
    for cell in table.usual_cells:
        blocks = [measured.block(name, cell.clearance_mm, cell.part, conditions=table.usual) for name in names]
        told = [text for block in blocks for text in (success(block), peaks(block))]
        lines.append([f"**{cell.part}**, {cell.clearance_mm:.2f} mm", *told])
    header = ["part, c", *(text for name in names for text in (f"`{name}`", "peak force, N"))]
    yield Table(header, lines)


def _cell_blocks(measured: Measured, table: Table2, cell: TransferCell) -> dict[str, Measurement | None]:
    """Return the measurements of a cell by policy, and through the service where there are any."""
    found: dict[str, Measurement | None] = {}
    for name in (table.results, *table.beside):
        for through, how in _HOW.items():
            block = measured.block(name, cell.clearance_mm, cell.part, conditions=table.conditions, through=through)
            if block is not None or (through == "environment" and name == table.results):
                found[f"`{name}`{how}"] = block
    return found


def beaten(block: Measurement | None, larger: float) -> str | Judged:
    """Compare a measured rate with the paper's larger figure."""
    if block is None:
        return NOT_MEASURED
    if block.interval[0] > larger:
        return Judged("above", "good")
    return Judged("above, interval overlaps", "good") if block.rate > larger else Judged("below", "bad")


def contradictions(comparison: Comparison) -> Iterator[ReportBlock]:
    """List where the paper contradicts itself, and how its figures are read."""
    yield Heading("The paper's figures and how they are read here")
    lines: list[list[str | Judged]] = [
        [f"Table I, {row.name}", row.note] for row in comparison.table_1.rows if row.note
    ]
    for cell in comparison.table_2.cells:
        where = f"Table II, {cell.part} at {cell.proportion * 100:.4g} %"
        if cell.text is not None:
            differs = f"table {printed(cell.printed)}, text {printed(cell.text)}: {cell.note}"
            lines.append([where, differs])
    yield Table(["figure", "reading"], lines)
    yield Paragraph(
        "The simulated rates of Table I are not multiples of 1/500, so they can only guide. The paper's gap is read "
        "as the growth of the triangle's height, which fits its area proportions: 4 mm is a clearance of 1.33 mm per "
        "face, 1 mm is 0.33 mm."
    )
    yield Paragraph(
        "Success is the paper's: 2.5 mm below the hole's surface with the peg's axis inside the hole. The author's "
        "code asks for 10 mm, so that rate is shown beside it."
    )
