"""The states of a cell and the one table of allowed transitions; the API's 409s come from it."""

from service.messages import CellState

TRANSITIONS: dict[CellState, frozenset[CellState]] = {
    CellState.OFFLINE: frozenset({CellState.CONNECTING}),
    CellState.CONNECTING: frozenset({CellState.READY, CellState.OFFLINE}),
    CellState.READY: frozenset({CellState.PREFLIGHT, CellState.OFFLINE, CellState.STOPPING}),
    CellState.PREFLIGHT: frozenset({CellState.APPROACH, CellState.READY, CellState.STOPPING}),
    CellState.APPROACH: frozenset({CellState.RUNNING, CellState.RETRACT, CellState.STOPPING}),
    CellState.RUNNING: frozenset({CellState.RETRACT, CellState.STOPPING}),
    CellState.RETRACT: frozenset({CellState.READY, CellState.STOPPING}),
    CellState.STOPPING: frozenset({CellState.LATCHED}),
    # Only an acknowledged reset leaves LATCHED; a lost link does not.
    CellState.LATCHED: frozenset({CellState.READY}),
}
INITIAL = frozenset({CellState.OFFLINE, CellState.LATCHED})
"""A cell starts LATCHED when the latch on disk is set."""
WITH_RUN = frozenset({CellState.PREFLIGHT, CellState.APPROACH, CellState.RUNNING, CellState.RETRACT})
"""States in which a run is under way, so that a stop latches."""


class IllegalTransitionError(Exception):
    """The table does not allow this transition; the cell's state is unchanged."""

    def __init__(self, present: CellState, wanted: CellState) -> None:
        allowed = ", ".join(sorted(TRANSITIONS.get(present, ()))) or "nothing"
        super().__init__(f"{present} cannot become {wanted}; from {present} a cell goes to {allowed}")
        self.present, self.wanted = present, wanted


class StateMachine:
    """Holds the state of one cell and refuses transitions that the table does not allow."""

    def __init__(self, initial: CellState) -> None:
        if initial not in INITIAL:
            raise ValueError(f"a cell starts {' or '.join(sorted(INITIAL))}, not {initial}")
        self._state = initial

    @property
    def state(self) -> CellState:
        return self._state

    def allows(self, wanted: CellState) -> bool:
        return wanted in TRANSITIONS[self._state]

    def to(self, wanted: CellState) -> None:
        """Change the state.

        Raises:
            IllegalTransitionError: the table does not allow it.
        """
        if not self.allows(wanted):
            raise IllegalTransitionError(self._state, wanted)
        self._state = wanted
