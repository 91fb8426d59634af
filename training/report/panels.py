"""The page of the panels: how every policy does on plants with errors, line by line."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from training import files
from training.evaluation.results import Block as Measurement
from training.evaluation.results import Results
from training.report import pages
from training.report.document import Document, Heading, Paragraph, ReportBlock, Table
from training.report.measured import commit_name, interval, percent

TITLE = "Policies on plants with errors"
PAGE = "panels.md"


def document(results: Mapping[str, Mapping[str, Results]]) -> Document:
    """Return the page of all results on panels, by name of the panel and of the policy's file."""
    blocks: list[ReportBlock] = [
        Paragraph(
            "The report's other figures are of a nominal plant. Here the same policies meet plants with errors that "
            "they were not told of, one kind at a time and then all at once. "
            f"[Conditions of an episode]({pages.CONDITIONS}#errors-of-the-plant) describes every error."
        ),
        Paragraph(
            "A line is a size of an error. Its direction is drawn for each episode. The lines play the same seeds, so "
            "they differ in nothing but the error. Success is given with its 95 % Wilson interval, the peak force as "
            "median / 99th percentile / maximum of the episodes. The panel `plant` is a test: policies are chosen on "
            "`plant-validation` alone."
        ),
    ]
    for name, policies in results.items():
        blocks.append(Heading(f"Panel {name}"))
        for policy, found in policies.items():
            blocks += _policy(policy, found)
    return Document(TITLE, blocks)


def table(measurements: Sequence[Measurement]) -> Table:
    """Return the table of a policy's measurements on a panel: a row per line, three columns per clearance."""
    clearances = list(dict.fromkeys(each.setting.clearance_m for each in measurements))
    lines: dict[str, dict[float, Measurement]] = {}
    for each in measurements:
        lines.setdefault(each.setting.line, {})[each.setting.clearance_m] = each
    header = ["plant"]
    for clearance in clearances:
        header += [f"success, c = {clearance * 1e3:.2f} mm", "peak force, N", "faults"]
    return Table(header, [[line, *_cells(row, clearances)] for line, row in lines.items()])


def write(results: Mapping[str, Mapping[str, Results]], folder: Path) -> Path:
    """Write the page; return its path."""
    path = folder / PAGE
    files.write(path, document(results).to_markdown(folder).encode())
    return path


def _policy(name: str, results: Results) -> Iterator[ReportBlock]:
    measured = [block for block in results.blocks if block.episodes]
    if not measured:
        return
    counts = sorted({len(block.episodes) for block in measured})
    commits = sorted({commit_name(session.commit) for block in measured for session in block.sessions})
    yield Heading(name, 3)
    yield Paragraph(
        f"{' to '.join(map(str, dict.fromkeys((counts[0], counts[-1]))))} episodes a line and clearance, "
        f"seeds from {measured[0].setting.first_seed} up, part `{measured[0].setting.part}`, measured at "
        f"{', '.join(f'`{commit}`' for commit in commits)}."
    )
    yield table(measured)
    yield from _plants(measured)


def _plants(measurements: Sequence[Measurement]) -> Iterator[ReportBlock]:
    """Give the success on each of the plants among which a line's seeds are shared out."""
    for each in measurements:
        plant = each.setting.plant
        if plant is None or not plant.plants:
            continue
        rates: list[float] = []
        for number in range(plant.plants):
            own = [episode.success for episode in each.episodes if episode.seed % plant.plants == number]
            if own:
                rates.append(sum(own) / len(own))
        yield Paragraph(
            f"{each.setting.line}, c = {each.setting.clearance_m * 1e3:.2f} mm, plant by plant: "
            f"{', '.join(percent(rate) for rate in sorted(rates))}."
        )


def _cells(row: Mapping[float, Measurement], clearances: Sequence[float]) -> Iterator[str]:
    for clearance in clearances:
        found = row.get(clearance)
        if found is None:
            yield from ("–", "–", "–")
            continue
        yield f"{percent(found.rate)} {interval(*found.interval)}"
        yield " / ".join(f"{value:.1f}" for value in found.peaks)
        yield str(sum(episode.fault for episode in found.episodes))
