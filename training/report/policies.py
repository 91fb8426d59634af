"""Tables of the measured policies: rate, law, lock and file, and how each was trained."""

from collections.abc import Iterable, Iterator

from training.evaluation.results import Results
from training.report import accounts
from training.report.accounts import Account
from training.report.document import Judged, Paragraph, ReportBlock, Table
from training.report.measured import Measured, duration


def misnamed(measured: Measured) -> Iterator[ReportBlock]:
    """Name results whose policy has another name than the results."""
    named = {name: results.policy for name, results in measured.results.items()}
    found = [f"`{name}` holds `{policy}`" for name, policy in named.items() if policy != name]
    if found:
        yield Paragraph(
            f"**Results under another name than their policy's own:** {', '.join(found)}. "
            "The tables use the first name."
        )


def files(measured: Measured) -> Iterator[ReportBlock]:
    """List all policies, folded: rate, law, lock, and the digests of file and sources."""
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


def trainings(measured: Measured) -> Iterator[ReportBlock]:
    """List how all policies were trained, folded."""
    rows = [[f"`{name}`", *_trained_row(results)] for name, results in measured.results.items()]
    header = ["results", "experiment", "seed", "begun with", "own steps", "wall-clock", "c of the training"]
    yield Table(header, rows, folded=f"Training of all {len(rows)} policies")


def trained(measured: Measured, names: Iterable[str]) -> str:
    """Say in one sentence how the measured ones of these policies were trained; empty if none is measured."""
    told = [f"`{name}` {_in_short(results)}" for name, results in _measured(measured, names).items()]
    return f"How they were trained differs, too: {'; '.join(told)}." if told else ""


def pressing(measured: Measured, names: Iterable[str]) -> str:
    """Say how far the measured policies under the paper's lock may go below it; empty if there are none."""
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
