"""What the measured policies are: rate, law, lock and file, and how each was trained."""

from collections.abc import Iterable, Iterator

from training.evaluation.results import Results
from training.report import accounts
from training.report.accounts import Account
from training.report.document import Block, Judged, Paragraph, Table
from training.report.measured import Measured, duration


def misnamed(measured: Measured) -> Iterator[Block]:
    """Say which results are of a policy of another name than theirs, by which tables place them."""
    named = {name: results.policy for name, results in measured.results.items()}
    found = [f"`{name}` holds `{policy}`" for name, policy in named.items() if policy != name]
    if found:
        yield Paragraph(
            f"**Results under another name than their policy's own:** {', '.join(found)}. "
            "Tables place them by the first."
        )


def tables(measured: Measured) -> Iterator[Block]:
    """All policies, folded: what decides their figures, and how they were trained."""
    lines: list[list[str | Judged]] = []
    for name, results in measured.results.items():
        episodes = sum(len(block.episodes) for block in results.blocks)
        lines.append(
            [
                f"`{name}`",
                "the same" if results.policy == name else Judged(f"`{results.policy}`", "bad"),
                results.mode,
                results.lock,
                f"{results.press_m * 1e3:g} mm, {results.seek_step_m * 1e3:g} mm",
                f"{1 / results.period_s:g} Hz, {results.max_steps} steps",
                " / ".join(f"{value:g}" for value in results.stiffness),
                ", ".join(sorted({f"{b.setting.force_ceiling_n:g} N" for b in results.blocks})),
                str(episodes),
                f"`{results.sha256[:12]}`",
                f"`{results.sources[:12]}`",
            ]
        )
    header = ["results", "name in the file", "observes", "lock", "press below the lock, step before contact", "rate"]
    header += [
        "stiffness x y z, N/m, and about them, N·m/rad",
        "ceiling",
        "episodes",
        "SHA-256 of the file",
        "of the sources",
    ]
    yield Table(header, lines, folded=f"Rate, law, lock and file of all {len(lines)} policies")
    sources = {results.sources for results in measured.results.values()}
    if len(sources) > 1:
        yield Paragraph(
            f"**Not all were measured with the same sources**: what decides an episode differs in {len(sources)} ways "
            "(last column)."
        )
    rows = [[f"`{name}`", *_trained_row(results)] for name, results in measured.results.items()]
    header = ["results", "experiment", "seed", "begun with", "own steps", "wall-clock", "c of the training"]
    yield Table(header, rows, folded=f"Training of all {len(rows)} policies")


def trained(measured: Measured, names: Iterable[str]) -> str:
    """One sentence on how those of these policies that are measured were trained; empty if there are none."""
    told = [f"`{name}` {_in_short(results)}" for name, results in _measured(measured, names).items()]
    return f"How they were trained differs, too: {'; '.join(told)}." if told else ""


def pressing(measured: Measured, names: Iterable[str]) -> str:
    """On what those of these policies that have the paper's lock do below it; empty if none is measured."""
    locked = {name: results for name, results in _measured(measured, names).items() if results.lock == "paper"}
    if not locked:
        return ""
    below = [f"`{name}` by {results.press_m * 1e3:g} mm" for name, results in locked.items() if results.press_m]
    steps = sorted({f"{results.seek_step_m * 1e3:g} mm" for results in locked.values()})
    return (
        f"The paper's lock lets no command go below it; of ours {', '.join(below) or 'none'} may. Before contact ours "
        f"steps down by {' or '.join(steps)}."
    )


def _measured(measured: Measured, names: Iterable[str]) -> dict[str, Results]:
    return {name: measured.results[name] for name in names if name in measured.results}


def _trained_row(results: Results) -> list[str]:
    known = accounts.account(results.provenance)
    if known is None:
        return ["by hand" if "script" in results.provenance else "not told", "–", "–", "–", "–", "–"]
    return [
        f"`{known.experiment.name}`",
        str(known.seed),
        known.began_with or "nothing",
        _steps(known),
        "–" if known.elapsed_s is None else duration(known.elapsed_s),
        _clearances(known),
    ]


def _in_short(results: Results) -> str:
    known = accounts.account(results.provenance)
    if known is None:
        return "by hand" if "script" in results.provenance else "does not tell"
    after = f" after {known.began_with}" if known.began_with else " from nothing"
    return f"{_steps(known)} steps{after} at c = {_clearances(known)}"


def _steps(known: Account) -> str:
    return f"{known.steps / 1e6:.2f} M"


def _clearances(known: Account) -> str:
    low, high = known.experiment.task.clearance_mm
    return f"{low:g} mm" if low == high else f"{low:g} to {high:g} mm"
