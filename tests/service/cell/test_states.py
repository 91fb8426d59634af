import itertools

import pytest

from service.cell.states import TRANSITIONS, WITH_RUN, IllegalTransitionError, StateMachine
from service.messages import CellState

REAL = [state for state in CellState if state is not CellState.UNKNOWN]


def machine_in(state: CellState) -> StateMachine:
    machine = StateMachine(CellState.OFFLINE)
    machine._state = state
    return machine


@pytest.mark.parametrize(("present", "wanted"), list(itertools.product(REAL, REAL)))
def test_a_change_outside_the_table_raises_and_changes_nothing(present: CellState, wanted: CellState) -> None:
    machine = machine_in(present)
    if wanted in TRANSITIONS[present]:
        machine.to(wanted)
        assert machine.state is wanted
    else:
        with pytest.raises(IllegalTransitionError, match=f"{present} cannot become {wanted}"):
            machine.to(wanted)
        assert machine.state is present


def test_every_state_with_a_run_can_be_stopped_and_only_a_stop_latches() -> None:
    assert all(CellState.STOPPING in TRANSITIONS[state] for state in WITH_RUN)
    assert [state for state in REAL if CellState.LATCHED in TRANSITIONS[state]] == [CellState.STOPPING]


def test_a_latched_cell_leads_to_ready_and_nowhere_else() -> None:
    assert TRANSITIONS[CellState.LATCHED] == {CellState.READY}


def test_no_state_leads_to_running_but_the_approach() -> None:
    assert [state for state in REAL if CellState.RUNNING in TRANSITIONS[state]] == [CellState.APPROACH]


def test_every_state_can_be_reached() -> None:
    reached = {CellState.OFFLINE, CellState.LATCHED}
    for _ in REAL:
        reached |= {after for state in reached for after in TRANSITIONS[state]}
    assert reached == set(REAL) == set(TRANSITIONS)


@pytest.mark.parametrize("state", [CellState.READY, CellState.RUNNING, CellState.UNKNOWN])
def test_a_cell_starts_offline_or_latched(state: CellState) -> None:
    with pytest.raises(ValueError, match="starts LATCHED or OFFLINE"):
        StateMachine(state)
