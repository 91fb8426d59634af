"""Model cards: a page that says of every policy file what it is for, what it does and how well.

The cards are written from the contracts and the results. Use and known weakness of a model are in `cards.toml`.
"""

import math
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from pydantic import BaseModel, ConfigDict

from service.policy.contract import EvaluationFigure, PolicyContract
from service.policy.model import Policy
from service.policy.observation import ENTRIES, Need
from training import files
from training.evaluation.results import Block as Measurement
from training.evaluation.results import Results, ResultsError
from training.report import accounts, pages, paper
from training.report.document import Document, Heading, Judged, Paragraph, ReportBlock, Table
from training.report.measured import NOT_MEASURED, Measured, commit_name, interval, mean_steps, peaks, percent
from training.report.own_chapters import THROUGH
from wire.modes import LockMode
from wire.task import Part

TITLE = "Models"
PAGE = "models.md"
GLANCE_MM = (1.33, 0.33)
"""Clearances per face of the first table: the paper's two gaps."""
USUAL_LOCKS: tuple[LockMode, ...] = ("paper",)
"""Locks that a recipe runs without asking for them by `allow_lock`."""

MODES = {
    "VFTM": "knows hole and contact",
    "FTM": "knows the contact; for the hole stands its nominal centre",
    "VM": "knows the hole and nothing of the contact",
}
LOCKS: Mapping[LockMode, str] = {
    "paper": "the paper's Algorithm 1, creeping down until contact and from there limiting how deep the policy may ask",
    "sliding": "creeps down until contact; from there the policy owns z, and the lock limits nothing",
    "off": "the command is the policy's from the beginning",
}
NEEDS = {
    Need.FORCE_TORQUE: "a force/torque sensor",
    Need.HOLE: "a camera's estimate of the hole",
    Need.LAST_JOINT: "the last joint's angle",
}


class Note(BaseModel):
    """The part of a card that a person writes."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    use: str = ""
    weakness: str = ""


UNKNOWN = Note()


@dataclass(frozen=True, slots=True)
class Card:
    """A policy file with what is known of it.

    Attributes:
        name: name of the file without its ending.
        size_bytes: size of the file.
        sha256: digest of the file.
        contract: read from the file.
        results: measured with this very file; None: there are none.
        note: written by a person.
    """

    name: str
    size_bytes: int
    sha256: str
    contract: PolicyContract
    results: Results | None
    note: Note = UNKNOWN

    @property
    def needs(self) -> list[str]:
        """Equipment that a cell must have to run it."""
        needed = {need for entry in self.contract.observation for need in ENTRIES[entry.name].needs}
        if self.contract.dsl.mode != "off":
            needed.add(Need.FORCE_TORQUE)
        if not self.contract.uses_estimate:
            needed.discard(Need.HOLE)
        return [text for need, text in NEEDS.items() if need in needed]

    @property
    def blocks(self) -> tuple[Measurement, ...]:
        """Measurements with at least one episode."""
        return () if self.results is None else tuple(block for block in self.results.blocks if block.episodes)

    @property
    def recorded(self) -> list[EvaluationFigure]:
        """Evaluation figures in the file that its results do not confirm."""
        known = [block.figure() for block in self.blocks]
        return [figure for figure in self.contract.evaluation if figure not in known]


def notes() -> dict[str, Note]:
    """Read `cards.toml`: notes by the name of the model's file."""
    document = tomllib.loads(Path(paper.__file__).with_name("cards.toml").read_text())
    return {name: Note.model_validate(note) for name, note in document.items()}


def read(models: Path, measured: Measured) -> list[Card]:
    """Read every ONNX file of a folder; none if there is no such folder.

    Raises:
        PolicyError: a cell would refuse one of them.
        ResultsError: results of that name are of another file.
    """
    said = notes()
    found: list[Card] = []
    for path in sorted(models.glob("*.onnx"), key=lambda path: path.stem):
        policy = Policy.load(path)
        results = measured.results.get(path.stem)
        if results is not None and results.sha256 != policy.sha256:
            raise ResultsError(
                f"the results {path.stem}.json are not of {path} as it is now: measure it anew (evaluate --anew)"
            )
        found.append(
            Card(
                name=path.stem,
                size_bytes=path.stat().st_size,
                sha256=policy.sha256,
                contract=policy.contract,
                results=results,
                note=said.get(path.stem, UNKNOWN),
            )
        )
    return found


def write(cards: Sequence[Card], folder: Path) -> Path:
    """Write the page of all cards; returns its file."""
    path = folder / PAGE
    files.write(path, document(cards).to_markdown(Path("pictures")).encode())
    return path


def document(cards: Sequence[Card]) -> Document:
    """Return the page of all cards: a table of them, and a section for each."""
    return Document(TITLE, [*_glance(cards), *(block for card in cards for block in _section(card))])


def _glance(cards: Sequence[Card]) -> Iterator[ReportBlock]:
    size = sum(card.size_bytes for card in cards) / 1e3
    yield Paragraph(
        f"The project ships {len(cards)} policies, {size:.0f} kB in all. `dsl-assembly report` writes this page from "
        f"the contract in each file ([policy contract]({pages.POLICY_CONTRACT})) and from `results/`. Use and "
        "known weakness of a model are in `training/report/cards.toml`. Only results of the very file count."
    )
    yield Paragraph(
        "All results are from simulation. Policies are deterministic. Clearances are per face. Intervals are 95 % "
        "Wilson intervals. Peak force is the largest resultant over every 2 ms sample of an episode. "
        f"[Conditions]({pages.CONDITIONS}) describes the named conditions. "
        f"[Results]({pages.RESULTS}) compares the policies with the paper."
    )
    yield Heading("All models")
    yield Paragraph(
        "Success is that of the first of a policy's parts, under its own lock, in the conditions `standard` (FTM: "
        "`search`), in the batched environment."
    )
    header = ["model", "mode", "lock", "parts", "clearance, mm", "memory", "kB"]
    yield Table([*header, *(f"success at {level:g} mm" for level in GLANCE_MM)], [_glance_row(card) for card in cards])


def _glance_row(card: Card) -> list[str | Judged]:
    contract = card.contract
    return [
        f"[{card.name}](#{_github_anchor(card.name)})",
        contract.mode,
        contract.dsl.mode,
        ", ".join(contract.parts),
        _span_mm(contract.clearance_m),
        str(contract.hidden_size or "none"),
        f"{card.size_bytes / 1e3:.0f}",
        *(_success(card, level) for level in GLANCE_MM),
    ]


def _success(card: Card, clearance_mm: float) -> str:
    """Return the success at a clearance by the results, or else by the file itself."""
    part, clearance_m = cast(Part, card.contract.parts[0]), paper.metres(clearance_mm)
    if card.results is not None:
        block = Measured({card.name: card.results}, ()).block(card.name, clearance_mm, part)
        if block is not None:
            return _rate(block.figure())
    conditions = paper.conditions_for(card.contract.mode)
    for figure in card.recorded:
        if figure.conditions == conditions and math.isclose(figure.clearance_m, clearance_m):
            return f"{_rate(figure)}, recorded in the file"
    return NOT_MEASURED


def _section(card: Card) -> Iterator[ReportBlock]:
    yield Heading(card.name)
    yield from _use(card)
    yield Heading("What it observes and does", 3)
    yield from _behaviour(card.contract)
    yield Heading("Lock and compliance", 3)
    yield from _limits(card.contract)
    yield Heading("How it was trained", 3)
    yield from accounts.told(card.contract.provenance)
    yield Heading("What was measured", 3)
    yield from _measured(card)
    yield Heading("Known limits", 3)
    yield Paragraph(" ".join(_known_limits(card)))
    renamed = f" (`{card.contract.name}` in its contract)" if card.contract.name != card.name else ""
    yield Paragraph(f"File: `{card.name}.onnx`{renamed}, {card.size_bytes} bytes, SHA-256 `{card.sha256}`.")


def _use(card: Card) -> Iterator[ReportBlock]:
    contract = card.contract
    if card.note.use:
        yield Paragraph(card.note.use)
    cell = f" in a cell with {' and '.join(card.needs)}" if card.needs else ""
    text = (
        f"**For** {', '.join(contract.parts)} at {_span_mm(contract.clearance_m)} mm{cell}. "
        "**Not for** other parts or clearances, nor for a cell that lacks what it needs: such a cell refuses it."
    )
    if contract.dsl.mode not in USUAL_LOCKS:
        text += f' The recipe must ask for its lock by `allow_lock = ["{contract.dsl.mode}"]`.'
    yield Paragraph(text)


def _behaviour(contract: PolicyContract) -> Iterator[ReportBlock]:
    felt = contract.wrench_window_ticks * contract.tick_s * 1e3
    memory = (
        f"It has a recurrent memory of {contract.hidden_size} numbers" if contract.hidden_size else "It has no memory"
    )
    yield Paragraph(
        f"Mode {contract.mode}: it {MODES[contract.mode]}. {memory}; it is given {contract.observation_size} numbers. "
        f"Force and torque, where it is given them, come from the newest {felt:g} ms of a step."
    )
    yield Table(
        ["it observes", "unit", "axes", "frames", "meaning"],
        [
            [f"`{entry.name}`", entry.unit, entry.frame, str(entry.history), ENTRIES[entry.name].meaning]
            for entry in contract.observation
        ],
    )
    moves = [_move(entry.name, entry.limit, entry.frame) for entry in contract.action]
    finer = [f"`{entry.name}`" for entry in contract.action if entry.map == "signed_square"]
    longest = contract.max_steps * contract.period_s
    yield Paragraph(
        f"Every {contract.period_s:g} s, at most {contract.max_steps} times ({longest:g} s), it asks for a "
        f"displacement from the measured pose: {', '.join(moves)}"
        + (f"; finer near zero in {', '.join(finer)}." if finer else ".")
    )


def _move(name: str, limit: float, frame: str) -> str:
    if name == "dyaw":
        return f"`dyaw` up to {math.degrees(limit):.1f}°"
    axes = f" in {frame} axes" if name != "dz" else ""
    return f"`{name}` up to {limit * 1e3:g} mm{axes}"


def _limits(contract: PolicyContract) -> Iterator[ReportBlock]:
    lock, law = contract.dsl, contract.compliance
    text = f"The lock `{lock.mode}`: {LOCKS[lock.mode]}."
    if lock.mode != "off":
        text += (
            f" While it seeks it goes down by {lock.seek_step_m * 1e3:g} mm a step; contact counts from "
            f"{lock.contact_threshold * lock.force_clip_n:g} N."
        )
    if lock.mode == "paper":
        text += f" A command may go {lock.press_m * 1e3:g} mm below the lock."
    yield Paragraph(text)
    yield Table(
        ["compliance law about the TCP", "x", "y", "z", "about x", "about y", "about z"],
        [
            ["stiffness, N/m and N·m/rad", *(f"{value:g}" for value in law.stiffness)],
            ["damping, N·s/m and N·m·s/rad", *(f"{value:g}" for value in law.damping)],
            ["inertia, kg and kg·m²", *(f"{value:g}" for value in law.inertia)],
        ],
    )


def _measured(card: Card) -> Iterator[ReportBlock]:
    if not card.blocks and not card.recorded:
        yield Paragraph("Not measured.")
    if card.blocks:
        sessions = [session for block in card.blocks for session in block.sessions]
        commits = ", ".join(sorted({f"`{commit_name(session.commit)}`" for session in sessions}))
        days = sorted({session.ended[:10] for session in sessions})
        yield Paragraph(
            (f"Measured {' to '.join(dict.fromkeys((days[0], days[-1])))} at {commits}. " if days else "")
            + "Success: the peg's bottom more than 2.5 mm below the hole's mouth with the peg's axis inside the hole. "
            "Faults: episodes that the force ceiling, or another fault, stopped."
        )
        header = ["part", "clearance", "conditions", "lock", "through", "ceiling", "seeds from", "success", "steps"]
        yield Table(
            [*header, "peak force, median / p99 / max, N", "faults"], [_block_row(block) for block in card.blocks]
        )
    if card.recorded:
        yield Paragraph("Recorded in the file, which names neither part, lock and ceiling nor the measured version:")
        yield Table(
            ["clearance", "conditions", "success", "peak force, median / max, N"],
            [
                [f"{figure.clearance_m * 1e3:.2f} mm", f"`{figure.conditions}`", _rate(figure), _recorded_peaks(figure)]
                for figure in card.recorded
            ],
        )


def _block_row(block: Measurement) -> list[str | Judged]:
    setting = block.setting
    return [
        setting.part,
        f"{setting.clearance_m * 1e3:.2f} mm",
        f"`{setting.conditions}`",
        setting.lock,
        THROUGH[setting.through],
        f"{setting.force_ceiling_n:g} N",
        str(setting.first_seed),
        _rate(block.figure()),
        mean_steps(block),
        peaks(block),
        str(sum(episode.fault for episode in block.episodes)),
    ]


def _recorded_peaks(figure: EvaluationFigure) -> str:
    values = (figure.peak_force_median_n, figure.peak_force_max_n)
    return " / ".join("–" if value is None else f"{value:.1f}" for value in values)


def _known_limits(card: Card) -> Iterator[str]:
    contract = card.contract
    if card.note.weakness:
        yield card.note.weakness
    account = accounts.account(contract.provenance)
    if account is not None:
        task = account.experiment.task
        beyond = [part for part in contract.parts if part not in task.parts]
        low, high = task.clearance_mm
        least, most = (value * 1e3 for value in contract.clearance_m)
        before = " (what it began with aside)" if account.began_with else ""
        if beyond:
            yield f"Admitted for parts that it was not trained on{before}: {', '.join(beyond)}."
        if least < low * (1 - 1e-9) or most > high * (1 + 1e-9):
            yield f"Admitted at {_span_mm(contract.clearance_m)} mm, trained at {low:g} to {high:g} mm{before}."
    played = [block.setting for block in card.blocks]
    unplayed = [part for part in contract.parts if part not in {setting.part for setting in played}]
    missing = [
        f"for {', '.join(unplayed)}" if unplayed else "",
        f"below {min(s.clearance_m for s in played) * 1e3:.2f} mm" if played else "",
        f"above {max(s.clearance_m for s in played) * 1e3:.2f} mm" if played else "",
        "" if any(s.conditions == "transfer" for s in played) else "on the plant of `transfer`",
        "" if any(s.through != "environment" for s in played) else "through the deployed service",
        "on a robot",
    ]
    yield f"The results have nothing {'; '.join(text for text in missing if text)}."


def _rate(figure: EvaluationFigure) -> str:
    share = figure.successes / figure.episodes
    return f"**{percent(share)}** {interval(figure.low, figure.high)}, {figure.successes} of {figure.episodes}"


def _span_mm(clearance_m: tuple[float, float]) -> str:
    low, high = (f"{value * 1e3:g}" for value in clearance_m)
    return low if low == high else f"{low} to {high}"


def _github_anchor(text: str) -> str:
    """Return the anchor of a heading on a page of Markdown."""
    return re.sub(r"[^\w\- ]", "", text.lower()).replace(" ", "-")
