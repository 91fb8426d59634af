"""The chapters of this project's own: strength, force and the deployed service."""

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from training.evaluation.results import Block as Measurement
from training.evaluation.results import wilson
from training.report import plots, policies
from training.report.document import Heading, Judged, Paragraph, Picture, ReportBlock, Table
from training.report.measured import (
    Measured,
    deep_success,
    interval,
    mean_steps,
    peaks,
    percent,
    printed,
    success,
)
from training.report.paper import ClearanceLevel, Comparison, Locked, Strength

THROUGH = {"environment": "environment", "zenoh": "service over Zenoh", "rtde": "service over RTDE"}


def strength(measured: Measured, comparison: Comparison) -> Iterator[ReportBlock]:
    """Give success and force over clearances, in the standard conditions."""
    wanted = comparison.strength
    yield Heading("Strength: success over clearances")
    yield Paragraph(f"The triangle in the standard conditions (FTM: `search`), `{wanted.results}` against our targets.")
    lines: list[list[str | Judged]] = []
    for level in wanted.levels:
        block = measured.block(wanted.results, level.clearance_mm)
        lines.append(
            [
                f"{level.clearance_mm:g} mm",
                printed(level.paper) if level.paper is not None else "–",
                percent(level.target),
                success(block),
                deep_success(block),
                "–" if block is None else str(len(block.episodes)),
                mean_steps(block),
                peaks(block),
                "–" if block is None else str(sum(e.fault for e in block.episodes)),
            ]
        )
    header = ["c", "the paper", "target", "success", "10 mm deep", "episodes", "steps", "peak force, N", "faults"]
    yield Table(header, lines)
    yield from _hardened(measured, wanted)
    names = [name for name in (wanted.results, *wanted.beside) if name in measured.results]
    series = [(name, _rates(measured, name, wanted.levels)) for name in names]
    series = [(name, rates) for name, rates in series if rates]
    if series:
        papers = [(level.clearance_mm, level.paper) for level in wanted.levels if level.paper is not None]
        targets = [(level.clearance_mm, level.target) for level in wanted.levels]
        caption = "Success against clearance per face, with 95 % intervals."
        yield Picture("strength", plots.success_by_clearance(series, papers, targets), caption)
    if len(series) > 1:
        yield Heading("All policies", 3)
        rows: list[list[str | Judged]] = []
        for name, _ in series:
            blocks = [measured.block(name, level.clearance_mm) for level in wanted.levels]
            rows.append([f"`{name}`", *("–" if block is None else success(block) for block in blocks)])
            rows.append(["peak force, N", *(peaks(block) for block in blocks)])
        header = ["", *(f"{level.clearance_mm:g} mm" for level in wanted.levels)]
        yield Table(header, rows, frozenset(range(0, len(rows), 2)))


def _hardened(measured: Measured, wanted: Strength) -> Iterator[ReportBlock]:
    """Give the same policy in harder conditions."""
    levels = [level.clearance_mm for level in wanted.levels]
    blocks = [(level, measured.block(wanted.results, level, conditions=wanted.hardened)) for level in levels]
    lines: list[list[str | Judged]] = [
        [f"{level:g} mm", success(block), peaks(block), str(sum(e.fault for e in block.episodes))]
        for level, block in blocks
        if block is not None
    ]
    if lines:
        yield Paragraph(f"The same policy in the conditions `{wanted.hardened}`:")
        yield Table(["c", "success", "peak force, N", "faults"], lines)


def _rates(measured: Measured, name: str, levels: Sequence[ClearanceLevel]) -> list[plots.Rate]:
    blocks = [(level.clearance_mm, measured.block(name, level.clearance_mm)) for level in levels]
    return [plots.Rate(level, block.rate, *block.interval) for level, block in blocks if block is not None]


def force(measured: Measured, comparison: Comparison) -> Iterator[ReportBlock]:
    """Compare the forces of locks, at equal success."""
    yield Heading("Force: DSL against sliding and no lock, at equal success")
    first, *others = comparison.force.rows
    yield Paragraph(
        "The same worlds are played under different locks. The first columns hold all episodes. The others hold the "
        f"seeds that both {first.name} and the other insert: the peak forces of each, and in how many of them "
        f"{first.name} has the lower peak. A policy that is put under another lock was not trained for it."
    )
    told = policies.trained(measured, [row.results for row in comparison.force.rows])
    if told:
        yield Paragraph(told)
    panels: list[tuple[str, list[tuple[str, list[float]]]]] = []
    for clearance in comparison.force.clearance_mm:
        reference = _locked(measured, first, clearance)
        lines: list[list[str | Judged]] = []
        shown = [(row, block) for row in (first, *others) if (block := _locked(measured, row, clearance)) is not None]
        for row, block in shown:
            line: list[str | Judged] = [row.name, success(block), peaks(block)]
            if row is first or reference is None:
                line += ["", "", "", ""]
            else:
                line += _paired(reference, block)
            lines.append(line)
        yield Heading(f"c = {clearance:g} mm", 3)
        if len(shown) < len(comparison.force.rows):
            names = [row.name for row in (first, *others) if row not in [known for known, _ in shown]]
            yield Paragraph(f"Not measured: {', '.join(names)}.")
        if lines:
            header = ["", "success", "peak force, N", "both insert", f"peak force of {first.name} there, N"]
            yield Table([*header, "of this one there, N", f"{first.name} lower in"], lines)
        trained = [(row, block) for row, block in shown if row.lock is None]
        if len(trained) > 1:
            inserted = [(row.name, _inserted(block)) for row, block in trained]
            common = [seed for seed in inserted[0][1] if all(seed in peaks_of for _, peaks_of in inserted)]
            series = [(name, [peaks_of[seed] for seed in common]) for name, peaks_of in inserted]
            panels.append((f"c = {clearance:g} mm, {len(common)} seeds that all insert", series))
    if panels:
        caption = (
            "Share of the episodes that every lock inserts whose peak force stays below a force. Dotted: the limit "
            "for p99."
        )
        yield Picture("force", plots.peak_forces(panels, comparison.strength.peak_force_p99_n), caption)


def _locked(measured: Measured, row: Locked, clearance: float) -> Measurement | None:
    return measured.block(row.results, clearance, lock=row.lock)


def _inserted(block: Measurement) -> dict[int, float]:
    """Return the peak force of every episode that ended in the hole, by seed."""
    return {episode.seed: episode.peak_force_n for episode in block.episodes if episode.success}


def _paired(reference: Measurement, block: Measurement) -> list[str | Judged]:
    one, other = _inserted(reference), _inserted(block)
    common = sorted(one.keys() & other.keys())
    if not common:
        return ["0", "–", "–", "–"]
    lower = sum(one[seed] < other[seed] for seed in common)
    spans = [np.percentile([peak[seed] for seed in common], [50, 99, 100]) for peak in (one, other)]
    told = [" / ".join(f"{value:.1f}" for value in span) for span in spans]
    share = f"{percent(lower / len(common))} {interval(*wilson(lower, len(common)))}"
    return [str(len(common)), *told, share]


def service(measured: Measured) -> Iterator[ReportBlock]:
    """Compare the deployed service with the environment on the same seeds."""
    lines: list[list[str | Judged]] = []
    for name, results in measured.results.items():
        for block in results.blocks:
            setting = block.setting
            if setting.through == "environment" or not block.episodes:
                continue
            batched = measured.block(
                name, setting.clearance_m * 1e3, setting.part, conditions=setting.conditions, lock=setting.lock
            )
            seeds = {episode.seed for episode in block.episodes}
            same = [e for e in batched.episodes if e.seed in seeds] if batched is not None else []
            wrong = sum(e.claimed != e.success for e in block.episodes)
            codes = Counter(e.code for e in block.episodes if e.code is not None)
            lines.append(
                [
                    f"`{name}`",
                    setting.part,
                    f"{setting.clearance_m * 1e3:.2f} mm",
                    setting.conditions,
                    THROUGH[setting.through],
                    str(len(block.episodes)),
                    success(block),
                    f"{percent(sum(e.success for e in same) / len(same))} of {len(same)}" if same else "–",
                    peaks(block),
                    str(wrong),
                    ", ".join(f"{code} {count}" for code, count in sorted(codes.items())) or "–",
                ]
            )
    yield Heading("Through the deployed service")
    if not lines:
        yield Paragraph("Not measured.")
        return
    yield Paragraph(
        "The control process runs as a process of its own, with its own configuration, watchdogs and criterion. The "
        "world runs in another process: the simulated arm over Zenoh, in lockstep, or an emulated UR controller over "
        "RTDE, in real time."
    )
    yield Paragraph(
        "Success is the simulator's truth where the tool stood at the end. A peg that is in when the cell latches "
        "counts as a failure. The peak force is the service's own, from the start of the run: unlike the "
        "environment's it includes the sensor's bias before the sensor is zeroed. Runs that ended before the policy's "
        "first step are left out of it."
    )
    header = ["policy", "part", "c", "conditions", "through", "episodes", "success", "environment, same seeds"]
    yield Table([*header, "peak force, N", "outcome ≠ truth", "ended by"], lines)
