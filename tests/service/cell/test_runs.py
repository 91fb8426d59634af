"""The cell's state follows the stage of its insertion."""

from itertools import pairwise

from service.cell.stages import STATE_IN, Stage
from service.cell.states import TRANSITIONS, WITH_RUN
from service.drivers.base import PoseTarget
from service.messages import CellState, RunState
from tests.service.cell.conftest import EASY, FaultyCell


def test_every_stage_has_a_state_of_a_run_and_the_table_allows_their_order() -> None:
    assert set(STATE_IN) == set(Stage)
    assert set(STATE_IN.values()) == WITH_RUN
    for before, after in pairwise(STATE_IN[stage] for stage in Stage):
        assert after is before or after in TRANSITIONS[before]


async def test_the_last_target_of_the_policy_leaves_before_the_retract_is_told(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        driver, cell = faulty.driver, faulty.bench.cell
        sent: list[tuple[PoseTarget, CellState]] = []
        send = driver.send_target

        def note(target: PoseTarget) -> int:
            sent.append((target, cell.state))
            return send(target)

        driver.send_target = note
        run = await faulty.bench.insert(EASY)
        assert run.state is RunState.SUCCEEDED
        last = faulty.bench.records[-1].target
        assert [state for target, state in sent if target is last] == [CellState.RUNNING]
