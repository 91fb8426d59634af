"""The first chapters: what was found, beside the targets, and under which conditions."""

from collections.abc import Iterator

from training.evaluation.results import Block as Measurement
from training.report import pages, policies
from training.report.document import Heading, Judged, Paragraph, ReportBlock, Table
from training.report.measured import NOT_MEASURED, Measured, percent, printed, success
from training.report.paper import Comparison, Strength, TransferCell

Line = list[str | Judged]


def found(measured: Measured, comparison: Comparison) -> Iterator[ReportBlock]:
    """Say what was found, then every target with what was measured and the verdict."""
    lines = [
        *_levels(measured, comparison.strength),
        _transfer(measured, comparison),
        _without_camera(measured, comparison.strength),
        _force(measured, comparison.strength),
    ]
    yield Heading("What was found")
    yield Paragraph(" ".join(_sentences(measured, comparison, lines)))
    yield Table(["", "wanted", "measured", "verdict"], lines)
    yield from policies.misnamed(measured)
    yield Paragraph("`dsl-assembly report` writes this page from the folder `results/`.")


def conditions() -> Iterator[ReportBlock]:
    """Say under what everything was measured, and what the words of the tables mean."""
    yield Heading("Conditions")
    yield Table(
        ["term", "meaning on this page"],
        [
            ["policy", "The policy is deterministic. It plays each seed once."],
            [
                "seeds",
                "Tests use seeds from 2 000 000 up. Training draws seeds from 2³² up, and it chooses between models by "
                "seeds from 500 000 to 999 999.",
            ],
            [
                "success",
                "At the end of the episode the peg's bottom is at least 2.5 mm below the hole's mouth, and the peg's "
                "axis is inside the hole.",
            ],
            ["10 mm deep", "The policy is left on after the end of the episode, and the peg goes 10 mm deep in time."],
            ["interval", "95 % Wilson interval, in brackets."],
            ["c", "Clearance per face."],
            [
                "peak force",
                "Largest resultant over every 2 ms sample of an episode, as the cell's sensor reads it, with noise. "
                "Tables give median / 99th percentile / maximum over the episodes.",
            ],
            [
                "above 30 N",
                "The sensor ends at 30 N per channel, so a force above 30 N was at least that large. The load behind "
                "the largest reading in the conditions `stiff`, 52.6 N, was 128 N.",
            ],
            [
                "conditions",
                "The distributions `standard`, `search`, `stiff` and `transfer` are described in "
                f"[conditions]({pages.CONDITIONS}).",
            ],
        ],
    )


def _sentences(measured: Measured, comparison: Comparison, lines: list[Line]) -> Iterator[str]:
    strength, table = comparison.strength, comparison.table_2
    known = [
        (level.clearance_mm, block)
        for level in strength.levels
        if (block := measured.block(strength.results, level.clearance_mm)) is not None
    ]
    if known:
        rates = [block.rate for _, block in known]
        clearances = [clearance for clearance, _ in known]
        yield (
            f"`{strength.results}` inserts the triangle in {_span(rates)} of the episodes at clearances of "
            f"{min(clearances):g} to {max(clearances):g} mm per face."
        )
    cells = _cells(measured, comparison)
    missed = [f"{cell.part} at c = {cell.clearance_mm:.2f} mm" for cell, block in cells if not block.rate > cell.larger]
    if cells:
        yield (
            f"In the conditions `{table.conditions}`, with other parts and on another plant, it inserts "
            f"{_span([block.rate for _, block in cells])}. There its rate is above the paper's in "
            f"{len(cells) - len(missed)} of {len(cells)} measured cells of Table II."
        )
    if missed:
        yield f"It is below the paper's for {_listed(missed)}."
    verdicts = [line[-1].text for line in lines if isinstance(line[-1], Judged)]
    if verdicts:
        yield f"Of {len(verdicts)} measured targets {verdicts.count('met')} are met."
    else:
        yield "No target is measured yet."
    yield "All figures are from simulation: no robot has run these policies yet."


def _levels(measured: Measured, strength: Strength) -> Iterator[Line]:
    for level in strength.levels:
        block = measured.block(strength.results, level.clearance_mm)
        yield [
            f"success at {level.clearance_mm:g} mm per face",
            f"{level.target:.0%}".replace("%", " %"),
            success(block),
            NOT_MEASURED if block is None else _met(block.rate >= level.target),
        ]
        if level.paper is not None:
            yield [
                f"above the paper at {level.clearance_mm:g} mm (lower end of the interval)",
                printed(level.paper),
                NOT_MEASURED if block is None else percent(block.interval[0]),
                NOT_MEASURED if block is None else _met(block.interval[0] > level.paper),
            ]


def _transfer(measured: Measured, comparison: Comparison) -> Line:
    total = len(comparison.table_2.cells)
    cells = _cells(measured, comparison)
    above = sum(block.rate > cell.larger for cell, block in cells)
    surely = sum(block.interval[0] > cell.larger for cell, block in cells)
    few = min((len(block.episodes) for _, block in cells), default=0)
    told = f"{above} of {len(cells)} measured, {surely} with the whole interval; n ≥ {few}" if cells else NOT_MEASURED
    return [
        "cells of Table II above the paper's larger figure, by their rate, in the environment",
        f"{total} of {total}",
        told,
        _met(above == total) if len(cells) == total else NOT_MEASURED,
    ]


def _cells(measured: Measured, comparison: Comparison) -> list[tuple[TransferCell, Measurement]]:
    """Return the cells of Table II that were measured in the environment."""
    table = comparison.table_2
    return [
        (cell, block)
        for cell in table.cells
        if (block := measured.block(table.results, cell.clearance_mm, cell.part, conditions=table.conditions))
        is not None
    ]


def _without_camera(measured: Measured, strength: Strength) -> Line:
    ftm = strength.ftm
    block = measured.block(ftm.results, ftm.clearance_mm)
    return [
        f"FTM-DSL at {ftm.clearance_mm:g} mm (`search`)",
        f"{ftm.target:.0%}".replace("%", " %"),
        success(block),
        NOT_MEASURED if block is None else _met(block.rate >= ftm.target),
    ]


def _force(measured: Measured, strength: Strength) -> Line:
    levels = [measured.block(strength.results, level.clearance_mm) for level in strength.levels]
    forces = [block.peaks[1] for block in levels if block is not None]
    told = f"**{max(forces):.1f} N** ({len(forces)} of {len(levels)} clearances measured)" if forces else NOT_MEASURED
    low_enough = max(forces, default=0.0) <= strength.peak_force_p99_n
    return [
        "p99 of the peak force, at the clearance where it is largest",
        f"at most {strength.peak_force_p99_n:g} N",
        told,
        _met(low_enough) if len(forces) == len(levels) or not low_enough else NOT_MEASURED,
    ]


def _span(rates: list[float]) -> str:
    low, high = percent(min(rates)), percent(max(rates))
    return low if low == high else f"{low} to {high}"


def _listed(names: list[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _met(met: bool) -> Judged:
    return Judged("met", "good") if met else Judged("missed", "bad")
