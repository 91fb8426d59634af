"""The stages of an insertion, and the state of the cell in each."""

from enum import StrEnum

from service.messages import CellState


class Stage(StrEnum):
    """Stages of an insertion, in their order."""

    ZEROING = "ZEROING"
    CHECKING = "CHECKING"
    ENGAGING = "ENGAGING"
    APPROACHING = "APPROACHING"
    INSERTING = "INSERTING"
    PROBING = "PROBING"
    """The walls are asked whether the peg is in, where no contact has told it."""
    RETRACTING = "RETRACTING"


DRIVEN = frozenset({Stage.APPROACHING, Stage.INSERTING, Stage.PROBING, Stage.RETRACTING})
"""Stages in which the arm's control program is engaged."""

STATE_IN: dict[Stage, CellState] = {
    Stage.ZEROING: CellState.PREFLIGHT,
    Stage.CHECKING: CellState.PREFLIGHT,
    Stage.ENGAGING: CellState.APPROACH,
    Stage.APPROACHING: CellState.APPROACH,
    Stage.INSERTING: CellState.RUNNING,
    Stage.PROBING: CellState.RUNNING,
    Stage.RETRACTING: CellState.RETRACT,
}
"""State of the cell in each stage."""
