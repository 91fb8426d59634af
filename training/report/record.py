"""The last chapter: every measurement, machine, training and digest, for those who check or repeat them."""

from collections.abc import Iterator

from training.evaluation.results import Block as Measurement
from training.evaluation.results import Carried, Results
from training.report import policies
from training.report.document import Heading, Judged, Paragraph, ReportBlock, Table
from training.report.measured import Measured, commit_name, deep_success, duration, mean_steps, peaks, success
from training.report.own_chapters import THROUGH


def record(measured: Measured) -> Iterator[ReportBlock]:
    """Give every block that was measured, every training, every policy, and the digests of files and sources."""
    yield Heading("What was measured, where, and how long it took")
    yield from _measurements(measured)
    yield from _trainings(measured)
    yield from policies.trainings(measured)
    yield Heading("Files and sources", 3)
    yield from _machines(measured)
    yield from policies.files(measured)
    yield from _deployed(measured)
    yield from _carried(measured)


def _measurements(measured: Measured) -> Iterator[ReportBlock]:
    lines = [_row(name, results, block) for name, results in measured.results.items() for block in results.blocks]
    wall = sum(block.wall_s for results in measured.results.values() for block in results.blocks)
    count = sum(len(block.episodes) for results in measured.results.values() for block in results.blocks)
    yield Paragraph(f"{count} episodes in {duration(wall)} of wall-clock.")
    header = ["policy", "part", "c", "conditions", "lock", "through", "seeds from", "success", "10 mm deep", "steps"]
    header += ["peak force, N", "faults", "wall-clock", "commit", "machine"]
    yield Table(header, lines, folded=f"All {len(lines)} measurements")


def _trainings(measured: Measured) -> Iterator[ReportBlock]:
    if not measured.curves:
        return
    lines: list[list[str | Judged]] = [
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
        f"{len(lines)} trainings in {duration(total)} of wall-clock. Where a training began with the weights of an "
        "earlier one whose curve is not kept, that one is not counted."
    )
    yield Table(
        ["experiment", "seed", "steps", "wall-clock", "steps/s", "commit", "machine"],
        lines,
        folded=f"All {len(lines)} trainings",
    )


def _machines(measured: Measured) -> Iterator[ReportBlock]:
    sessions = [s for results in measured.results.values() for block in results.blocks for s in block.sessions]
    if not sessions:
        return
    days = sorted(session.ended[:10] for session in sessions)
    yield Table(
        ["", "measured"],
        [
            ["days", days[0] if days[0] == days[-1] else f"{days[0]} to {days[-1]}"],
            ["machines", " and ".join(sorted({session.machine for session in sessions}))],
            [
                "versions",
                ", ".join(sorted({f"{name} {number}" for s in sessions for name, number in s.versions.items()})),
            ],
            ["commits", ", ".join(sorted({f"`{commit_name(session.commit)}`" for session in sessions}))],
        ],
    )


def _deployed(measured: Measured) -> Iterator[ReportBlock]:
    lines = [
        [f"`{name}`", f"`{results.deployed_sources[:12]}`"]
        for name, results in measured.results.items()
        if results.deployed_sources is not None
        and any(block.setting.through != "environment" for block in results.blocks)
    ]
    if lines:
        yield Table(["results", "SHA-256 of the service's sources"], lines)


def _carried(measured: Measured) -> Iterator[ReportBlock]:
    """Say which changes of the sources the results were carried over, and what was compared."""
    every = [(name, carried) for name, results in measured.results.items() for carried in results.carried]
    if not every:
        return
    yield Paragraph(
        "The sources changed after these measurements, and the changes alter no episode. For each change, episodes of "
        "every block were played with the earlier and with the later sources and compared. Where the measured policy "
        "does not ship, another one stood in for it. An episode on file may differ in its figures where it was played "
        "on another processor or in another batch, which rounds otherwise."
    )
    yield Table(
        ["results", "carried", "sources", "through", "played by", "compared", "agree", "as on file"],
        [line for name, carried in every for line in _replays(name, carried)],
        folded=f"All {len(every)} carried results",
    )


def _replays(name: str, carried: Carried) -> Iterator[list[str]]:
    for replay in carried.replays:
        of_service = replay.through != "environment" and carried.to_deployed_sources is not None
        before = carried.from_deployed_sources if of_service else carried.from_sources
        after = carried.to_deployed_sources if of_service else carried.to_sources
        yield [
            f"`{name}`",
            f"{carried.date[:10]}, `{commit_name(carried.from_commit)}` to `{commit_name(carried.to_commit)}`",
            f"`{(before or '')[:12]}` to `{(after or '')[:12]}`",
            THROUGH[replay.through],
            f"`{replay.policy}`",
            replay.compared,
            f"{replay.agreed} of {replay.episodes} episodes of {replay.blocks} blocks",
            "–" if replay.as_on_file is None else f"{replay.as_on_file} of {replay.episodes}",
        ]


def _row(name: str, results: Results, block: Measurement) -> list[str | Judged]:
    setting = block.setting
    commits = dict.fromkeys(f"`{commit_name(session.commit)}`" for session in block.sessions)
    machines = dict.fromkeys(session.machine for session in block.sessions)
    lock: str = setting.lock
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
