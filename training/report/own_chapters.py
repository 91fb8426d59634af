"""The chapters of our own: at a glance, conditions, strength, force, the service, and all that was measured."""

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from training.evaluation.results import Block as Measurement
from training.evaluation.results import Results, wilson
from training.report import plots, policies
from training.report.document import Block, Heading, Judged, Paragraph, Picture, Table
from training.report.measured import (
    NOT_MEASURED,
    Measured,
    commit_name,
    deep_success,
    duration,
    interval,
    mean_steps,
    peaks,
    percent,
    printed,
    success,
)
from training.report.paper import Comparison, Level, Locked, Strength
from wire.limits import LockMode

THROUGH = {"environment": "environment", "zenoh": "service over Zenoh", "rtde": "service over RTDE"}


def glance(measured: Measured, comparison: Comparison) -> Iterator[Block]:
    """What was asked for, and what came of it."""
    strength, table = comparison.strength, comparison.table_2
    lines: list[list[str | Judged]] = []
    for level in strength.levels:
        block = measured.block(strength.results, level.clearance_mm)
        lines.append(
            [
                f"success at {level.clearance_mm:g} mm per face",
                f"{level.target:.0%}".replace("%", " %"),
                success(block),
                NOT_MEASURED if block is None else _met(block.rate >= level.target),
            ]
        )
        if level.paper is not None:
            lines.append(
                [
                    f"above the paper at {level.clearance_mm:g} mm (lower end of the interval)",
                    printed(level.paper),
                    NOT_MEASURED if block is None else percent(block.interval[0]),
                    NOT_MEASURED if block is None else _met(block.interval[0] > level.paper),
                ]
            )
    cells = [
        (cell, measured.block(table.results, cell.clearance_mm, cell.part, conditions=table.conditions))
        for cell in table.cells
    ]
    found = [(cell.larger, block) for cell, block in cells if block is not None]
    above = sum(block.rate > larger for larger, block in found)
    surely = sum(block.interval[0] > larger for larger, block in found)
    few = min((len(block.episodes) for _, block in found), default=0)
    told = f"{above} of {len(found)} measured, {surely} with the whole interval; n ≥ {few}" if found else NOT_MEASURED
    all_in = len(found) == len(cells)
    lines.append(
        [
            "cells of Table II above the paper's larger figure, by their rate, in the environment",
            f"{len(cells)} of {len(cells)}",
            told,
            _met(above == len(cells)) if all_in else NOT_MEASURED,
        ]
    )
    ftm = strength.ftm
    block = measured.block(ftm.results, ftm.clearance_mm)
    lines.append(
        [
            f"FTM-DSL at {ftm.clearance_mm:g} mm (`search`)",
            f"{ftm.target:.0%}".replace("%", " %"),
            success(block),
            NOT_MEASURED if block is None else _met(block.rate >= ftm.target),
        ]
    )
    levels = [measured.block(strength.results, level.clearance_mm) for level in strength.levels]
    forces = [block.peaks[1] for block in levels if block is not None]
    told = f"**{max(forces):.1f} N** ({len(forces)} of {len(levels)} clearances measured)" if forces else NOT_MEASURED
    low_enough = max(forces, default=0.0) <= strength.peak_force_p99_n
    lines.append(
        [
            "p99 of the peak force, at the clearance where it is largest",
            f"at most {strength.peak_force_p99_n:g} N",
            told,
            _met(low_enough) if len(forces) == len(levels) or not low_enough else NOT_MEASURED,
        ]
    )
    yield Paragraph(
        "What this project's policies do in its simulated cell, beside what the paper reports. `dsl-assembly report` "
        "writes this page and its tables from the folder `results/`."
    )
    yield from policies.misnamed(measured)
    yield Heading("At a glance")
    yield Table(["", "wanted", "measured", "verdict"], lines)


def conditions(measured: Measured) -> Iterator[Block]:
    """Under what everything here was measured."""
    yield Heading("Conditions")
    yield Paragraph(
        "Deterministic policies, each seed played once, test seeds from 2 000 000 up: training draws its seeds from "
        "2³² up and chooses models by seeds from 500 000 to 999 999. Success: the peg's bottom at least 2.5 mm below "
        "the hole's mouth with the peg's axis inside the hole, at the episode's end. Intervals are 95 % Wilson "
        "intervals. Peak force is the largest resultant over every 2 ms sample of an episode, as the cell's sensor "
        "has it, noise included; tables give median / 99th percentile / maximum over episodes. That sensor ends at 30"
        " N per channel, so what is said to be more than 30 N was at least that: the load behind the largest of the "
        "conditions `stiff`, 52.6 N, was 128 N. c is the clearance per face. The distributions `standard`, `search`, "
        "`stiff` and `transfer` are in [conditions.md](reference/conditions.md)."
    )
    sessions = [s for results in measured.results.values() for block in results.blocks for s in block.sessions]
    if sessions:
        days = sorted(session.ended[:10] for session in sessions)
        span = days[0] if days[0] == days[-1] else f"{days[0]} to {days[-1]}"
        packages = sorted({f"{name} {number}" for s in sessions for name, number in s.versions.items()})
        machines = sorted({session.machine for session in sessions})
        commits = sorted({f"`{commit_name(session.commit)}`" for session in sessions})
        yield Paragraph(
            f"Measured {span} on {' and '.join(machines)}, with {', '.join(packages)}, at {', '.join(commits)}."
        )
    yield from policies.tables(measured)


def strength(measured: Measured, comparison: Comparison) -> Iterator[Block]:
    """Success and force over clearances, in the standard conditions."""
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


def _hardened(measured: Measured, wanted: Strength) -> Iterator[Block]:
    """The same policy where it is harder."""
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


def _rates(measured: Measured, name: str, levels: Sequence[Level]) -> list[plots.Rate]:
    blocks = [(level.clearance_mm, measured.block(name, level.clearance_mm)) for level in levels]
    return [plots.Rate(level, block.rate, *block.interval) for level, block in blocks if block is not None]


def force(measured: Measured, comparison: Comparison) -> Iterator[Block]:
    """What the lock does to forces, at equal success."""
    yield Heading("Force: DSL against sliding and no lock, at equal success")
    first, *others = comparison.force.rows
    yield Paragraph(
        "The same worlds under different locks. Success and forces of all episodes come first. At equal success: of "
        f"the seeds that both {first.name} and the other insert, the peak forces of each, and in how many of them "
        f"{first.name} has the lower peak. Policies put under another lock were not trained for it. "
        + policies.trained(measured, [row.results for row in comparison.force.rows])
    )
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
        caption = "How many of the episodes that every lock inserts stay below a peak force; dotted: our limit for p99."
        yield Picture("force", plots.peak_forces(panels, comparison.strength.peak_force_p99_n), caption)


def _locked(measured: Measured, row: Locked, clearance: float) -> Measurement | None:
    return measured.block(row.results, clearance, lock=row.lock)


def _inserted(block: Measurement) -> dict[int, float]:
    """Peak forces by seed, of the episodes that ended in the hole."""
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


def service(measured: Measured) -> Iterator[Block]:
    """The deployed service on the same seeds."""
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
        "The control process with its own configuration, watchdogs and criterion, as a process of its own, and the "
        "world in another one: the simulated arm over Zenoh, in lockstep, or an emulated UR controller over RTDE, in "
        "real time. Success is the simulator's truth where the tool stood at the end, and no fault stopped the run: a "
        "peg that is in when the cell latches counts as a failure. The peak is the service's own, from the start on, "
        "so the sensor's bias before it is zeroed is in it, as it is not in the environment's; runs that ended before "
        "the policy's first step are left out of it. SHA-256 of the sources: "
        + "; ".join(
            f"`{name}` `{results.deployed_sources[:12]}`"
            for name, results in measured.results.items()
            if results.deployed_sources is not None
        )
        + "."
    )
    header = ["policy", "part", "c", "conditions", "through", "episodes", "success", "environment, same seeds"]
    yield Table([*header, "peak force, N", "outcome ≠ truth", "ended by"], lines)


def everything(measured: Measured) -> Iterator[Block]:
    """Every block that was measured, and every training."""
    yield Heading("What was measured, where, and how long it took")
    lines = [_row(name, results, block) for name, results in measured.results.items() for block in results.blocks]
    wall = sum(block.wall_s for results in measured.results.values() for block in results.blocks)
    count = sum(len(block.episodes) for results in measured.results.values() for block in results.blocks)
    yield Paragraph(f"{count} episodes in {duration(wall)} of wall-clock.")
    header = ["policy", "part", "c", "conditions", "lock", "through", "seeds from", "success", "10 mm deep", "steps"]
    header += ["peak force, N", "faults", "wall-clock", "commit", "machine"]
    yield Table(header, lines, folded=f"All {len(lines)} measurements")
    if measured.curves:
        trained: list[list[str | Judged]] = [
            [
                curve.label,
                str(curve.seed),
                f"{curve.steps / 1e6:.2f} M",
                duration(curve.elapsed_s),
                f"{curve.steps / curve.elapsed_s:.0f}" if curve.elapsed_s else "–",
                f"`{commit_name(curve.commit)}`",
                curve.machine,
            ]
            for curve in measured.curves
        ]
        total = sum(curve.elapsed_s for curve in measured.curves)
        yield Paragraph(
            f"{len(trained)} trainings in {duration(total)} of wall-clock; those are not counted whose weights a first "
            "one began with."
        )
        header = ["experiment", "seed", "steps", "wall-clock", "steps/s", "commit", "machine"]
        yield Table(header, trained, folded=f"All {len(trained)} trainings")


def _row(name: str, results: Results, block: Measurement) -> list[str | Judged]:
    setting = block.setting
    commits = dict.fromkeys(f"`{commit_name(session.commit)}`" for session in block.sessions)
    machines = dict.fromkeys(session.machine for session in block.sessions)
    lock: LockMode = setting.lock
    return [
        f"`{name}`",
        setting.part,
        f"{setting.clearance_m * 1e3:.2f} mm",
        setting.conditions,
        lock if lock == results.lock else f"{lock} (trained: {results.lock})",
        THROUGH[setting.through],
        f"{setting.first_seed}, {len(block.episodes)}",
        success(block) if block.episodes else "–",
        deep_success(block),
        mean_steps(block) if block.episodes else "–",
        peaks(block) if block.episodes else "–",
        str(sum(e.fault for e in block.episodes)),
        duration(block.wall_s),
        ", ".join(commits) or "–",
        ", ".join(machines) or "–",
    ]


def _met(met: bool) -> Judged:
    return Judged("met", "good") if met else Judged("missed", "bad")
