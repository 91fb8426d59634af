"""The comparison with the paper: its tables, our own levels, and the results and runs of each row.

`paper.toml` holds the figures. This module holds their types.
"""

import tomllib
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from service.policy.observation import ObservationMode
from wire.modes import LockMode
from wire.task import Conditions, Part

Share = Annotated[float, Field(ge=0, le=1)]
Millimetres = Annotated[float, Field(gt=0)]


class TablePlan(StrEnum):
    """Cells that one table needs of a policy."""

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
        name: the paper's name.
        reproduced: name of our runs of it, one policy per clearance, without the clearance.
        ours: name of our one policy for every clearance.
        printed: the paper's figures per gap, as far as it has them.
        note: remark on the printed figures.
    """

    name: str
    reproduced: str
    ours: str
    printed: tuple[Printed, ...]
    note: str = ""

    def reproduction(self, clearance_mm: float) -> str:
        """Return the name of the experiment that reproduces this row at a clearance."""
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
        note: remark on the contradiction.
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
        """Larger figure of table and text, which has to be beaten."""
        return self.printed if self.text is None else max(self.printed, self.text)


class Table2(PaperSection):
    """Table II.

    Attributes:
        results: name of our policy that was trained on the triangle alone, like the paper's.
        beside: names of other policies.
        conditions: conditions of the transfer.
        usual: conditions in which the parts other than the triangle are also played, to tell shape from plant.
        cells: cells in the paper's order.
    """

    results: str
    beside: tuple[str, ...]
    conditions: Conditions
    usual: Conditions
    cells: tuple[TransferCell, ...]

    @property
    def usual_cells(self) -> tuple[TransferCell, ...]:
        """Cells that are also played in the usual conditions: all but the triangle, which `Strength` covers."""
        return tuple(cell for cell in self.cells if cell.part != "tr")


class ClearanceLevel(PaperSection):
    """A clearance with our target of success, and the paper's success if it has one."""

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
        beside: names of other policies.
        hardened: harder conditions in which the policy is also measured.
        ftm: target of the policy without a camera.
        peak_force_p99_n: limit for the 99th percentile of the peak force.
        levels: levels in falling order of clearance.
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
    lock: LockMode | None = None


class Force(PaperSection):
    """Comparison of forces: every row with the first."""

    rows: tuple[Locked, ...]
    clearance_mm: tuple[Millimetres, ...]


class CurveRun(PaperSection):
    name: str
    experiment: str


class Curves(PaperSection):
    """A figure of learning curves.

    Attributes:
        title: title above it.
        name: name of its file.
        by_clearance: draw one curve per clearance of the evaluations; else one curve per run, over all of them.
        runs: runs; each seed is drawn thin, their mean thick.
    """

    title: str
    name: str
    by_clearance: bool = False
    runs: tuple[CurveRun, ...]


class Comparison(PaperSection):
    """Contents of `paper.toml`."""

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
    """Return a clearance in m, rounded so that it is the same number wherever it comes from."""
    return round(millimetres * 1e-3, 9)


def conditions_for(mode: ObservationMode) -> Conditions:
    """Return the standard conditions of a mode; FTM, which knows only the nominal centre, has a search domain."""
    return "search" if mode == "FTM" else "standard"


def cells_of(plan: TablePlan, mode: ObservationMode) -> list[tuple[Part, float, Conditions]]:
    """Return the cells of a plan: part, clearance per face in m, conditions."""
    everything = comparison()
    if plan is TablePlan.TABLE_2:
        table = everything.table_2
        return [(cell.part, metres(cell.clearance_mm), table.conditions) for cell in table.cells]
    if plan is TablePlan.TABLE_1:
        levels = [level for gap in everything.table_1.gaps for level in gap.clearance_mm]
    else:
        levels = [level.clearance_mm for level in everything.strength.levels]
    return [("tr", metres(level), conditions_for(mode)) for level in levels]


def reported(name: str, mode: ObservationMode) -> list[tuple[Part, float, Conditions, LockMode | None]]:
    """Return the cells of all tables for the policy of this name: as `cells_of`, and the lock, None for its own."""
    everything = comparison()
    strength, transfer = everything.strength, everything.table_2
    rows = everything.table_1.rows
    plans = [
        (TablePlan.STRENGTH, name in (strength.results, *strength.beside)),
        (TablePlan.TABLE_1, name in [row.ours for row in rows]),
        (TablePlan.TABLE_2, name in (transfer.results, *transfer.beside)),
    ]
    found: list[tuple[Part, float, Conditions, LockMode | None]] = [
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
