"""What is compared with the paper: its tables, the levels of our own, and which results and runs stand in each row.

The figures themselves are in `paper.toml`; this is their shape.
"""

import tomllib
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from service.policy.observation import Mode
from service.safety import dsl
from wire.task import Conditions, Part

Share = Annotated[float, Field(ge=0, le=1)]
Millimetres = Annotated[float, Field(gt=0)]


class TablePlan(StrEnum):
    """What one table needs of a policy."""

    STRENGTH = "strength"
    TABLE_1 = "table-1"
    TABLE_2 = "table-2"


class PaperSection(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Printed(PaperSection):
    """One pair of columns of Table I."""

    reward: float
    reward_variance: float
    success: Share
    success_variance: float


class Gap(PaperSection):
    """A gap of Table I by the paper's name, and the clearances that it may stand for: real part, simulated scene."""

    name: str
    clearance_mm: tuple[Millimetres, Millimetres]


class Table1Row(PaperSection):
    """A row of Table I.

    Attributes:
        name: the paper's.
        reproduced: name of our runs of it, one policy per clearance, without the clearance.
        ours: name of our one policy for every clearance.
        printed: per gap, as far as the paper has it.
        note: what the reader must know of the printed figures.
    """

    name: str
    reproduced: str
    ours: str
    printed: tuple[Printed, ...]
    note: str = ""

    def reproduction(self, clearance_mm: float) -> str:
        """Name of the experiment that reproduces this row at a clearance."""
        return f"{self.reproduced}-c{round(clearance_mm * 100):03d}"


class Table1(PaperSection):
    gaps: tuple[Gap, ...]
    rows: tuple[Table1Row, ...]


class TransferCell(PaperSection):
    """A cell of Table II.

    Attributes:
        part: peg and hole.
        clearance_mm: at which our part has the proportion.
        proportion: hole area minus peg area over hole area.
        printed: success in the table.
        text: success in the running text, where it differs.
        count: successes and tests that give a printed figure.
        note: on the contradiction.
    """

    part: Part
    clearance_mm: Millimetres
    proportion: Share
    printed: Share
    text: Share | None = None
    count: tuple[int, int]
    note: str = ""

    @property
    def larger(self) -> float:
        """The larger of what table and text say: what has to be beaten."""
        return self.printed if self.text is None else max(self.printed, self.text)


class Table2(PaperSection):
    """Table II.

    Attributes:
        results: name of our policy that was trained on the triangle alone, as the paper's.
        beside: names of others.
        conditions: of the transfer.
        usual: conditions that the other parts than the triangle are also played in: shape apart from plant.
        cells: in the paper's order.
    """

    results: str
    beside: tuple[str, ...]
    conditions: Conditions
    usual: Conditions
    cells: tuple[TransferCell, ...]

    @property
    def usual_cells(self) -> tuple[TransferCell, ...]:
        """What is also played in the usual conditions: not the triangle, which `Strength` has at every level."""
        return tuple(cell for cell in self.cells if cell.part != "tr")


class ClearanceLevel(PaperSection):
    """A clearance with our target of success, and the paper's success where it has one."""

    clearance_mm: Millimetres
    target: Share
    paper: Share | None = None


class FtmTarget(PaperSection):
    results: str
    clearance_mm: Millimetres
    target: Share


class Strength(PaperSection):
    """Our own levels.

    Attributes:
        results: name of the policy that they are set for.
        beside: names of others.
        hardened: conditions that the policy is measured in beside its standard ones.
        ftm: what the policy without a camera is to reach.
        peak_force_p99_n: largest 99th percentile of the peak force wanted.
        levels: in falling order of clearance.
    """

    results: str
    beside: tuple[str, ...]
    hardened: Conditions
    ftm: FtmTarget
    peak_force_p99_n: float
    levels: tuple[ClearanceLevel, ...]


class Locked(PaperSection):
    """A policy under a lock: its own, unless another one is named."""

    name: str
    results: str
    lock: dsl.Mode | None = None


class Force(PaperSection):
    """What is compared in force; every row with the first."""

    rows: tuple[Locked, ...]
    clearance_mm: tuple[Millimetres, ...]


class CurveRun(PaperSection):
    name: str
    experiment: str


class Curves(PaperSection):
    """A figure of learning curves.

    Attributes:
        title: above it.
        name: of its file.
        by_clearance: one curve per clearance of its evaluations; else a run has one, of all of them.
        runs: their seeds are shown thin, the mean of them thick.
    """

    title: str
    name: str
    by_clearance: bool = False
    runs: tuple[CurveRun, ...]


class Comparison(PaperSection):
    """All of `paper.toml`."""

    table_1: Table1
    table_2: Table2
    strength: Strength
    force: Force
    curves: tuple[Curves, ...]


@cache
def comparison() -> Comparison:
    """Read `paper.toml`."""
    return Comparison.model_validate(tomllib.loads(Path(__file__).with_name("paper.toml").read_text()))


def metres(millimetres: float) -> float:
    """A clearance in m, the same number wherever it comes from."""
    return round(millimetres * 1e-3, 9)


def conditions_for(mode: Mode) -> Conditions:
    """The standard conditions of a mode: FTM, which knows the nominal centre only, has a search domain about it."""
    return "search" if mode == "FTM" else "standard"


def cells_of(plan: TablePlan, mode: Mode) -> list[tuple[Part, float, Conditions]]:
    """What a plan measures of a policy: part, clearance per face in m, conditions."""
    everything = comparison()
    if plan is TablePlan.TABLE_2:
        table = everything.table_2
        return [(cell.part, metres(cell.clearance_mm), table.conditions) for cell in table.cells]
    if plan is TablePlan.TABLE_1:
        levels = [level for gap in everything.table_1.gaps for level in gap.clearance_mm]
    else:
        levels = [level.clearance_mm for level in everything.strength.levels]
    return [("tr", metres(level), conditions_for(mode)) for level in levels]


def reported(name: str, mode: Mode) -> list[tuple[Part, float, Conditions, dsl.Mode | None]]:
    """What all tables together say of the policy of this name: as `cells_of`, and the lock, None for its own."""
    everything = comparison()
    strength, transfer = everything.strength, everything.table_2
    rows = everything.table_1.rows
    plans = [
        (TablePlan.STRENGTH, name in (strength.results, *strength.beside)),
        (TablePlan.TABLE_1, name in [row.ours for row in rows]),
        (TablePlan.TABLE_2, name in (transfer.results, *transfer.beside)),
    ]
    found: list[tuple[Part, float, Conditions, dsl.Mode | None]] = [
        (*cell, None) for plan, wanted in plans if wanted for cell in cells_of(plan, mode)
    ]
    if name == strength.results:
        for part, level, _ in cells_of(TablePlan.STRENGTH, mode):
            found.append((part, level, strength.hardened, None))
    if name in (transfer.results, *transfer.beside):
        for cell in transfer.usual_cells:
            found.append((cell.part, metres(cell.clearance_mm), transfer.usual, None))
    drawn = conditions_for(mode)
    for level in sorted({level for gap in everything.table_1.gaps for level in gap.clearance_mm}):
        if name in [row.reproduction(level) for row in rows]:
            found.append(("tr", metres(level), drawn, None))
    for locked in everything.force.rows:
        if locked.results == name:
            for level in everything.force.clearance_mm:
                found.append(("tr", metres(level), drawn, locked.lock))
    return found
