"""A test of the tests: each mend is taken out, and the universes must find the fault that it mends.

A mend is taken out by replacing the function that does it. The seeds are drawn from the story in which the fault shows.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import pytest

import api.cell
import service.cell.admission
import service.cell.intake
import service.cell.journal.journal
from service.cell.journal.journal import Journal
from service.cell.journal.latch_file import LatchFile
from service.cell.journal.ledger import Ledger
from service.safety.seating import Finding, Seating
from service.safety.verdict import PASSED
from service.safety.witness import Witness
from tests.simulation import plan
from tests.simulation.plan import Story, drawn
from tests.simulation.story import tell

SEEDS = 60
"""Seeds in which each fault must be found."""
Change = tuple[Any, str, Any]


@dataclass(frozen=True)
class Fault:
    """A fault that was mended.

    Attributes:
        item: what it was, in words.
        story: in which it shows.
        finds: beginning of the violations that show it.
        changes: replacements that take its mend out.
    """

    item: str
    story: Story
    finds: tuple[str, ...]
    changes: Callable[[], list[Change]]


class Equal(int):
    """A number that no other differs from."""

    def __ne__(self, other: object) -> bool:
        return False

    __hash__ = int.__hash__


def _starts_forget_stops() -> list[Change]:
    why_not, receive = service.cell.admission._why_not_this_start, api.cell.FollowedCell.receive

    def forgetful(situation: Any, request: Any, *others: Any) -> Any:
        return why_not(situation, request.model_copy(update={"after": None}), *others)

    def received(cell: Any) -> Any:
        return replace(receive(cell), stops_asked=Equal())

    return [
        (service.cell.admission, "_why_not_this_start", forgetful),
        (api.cell.FollowedCell, "receive", received),
    ]


def _channels_may_stand_still() -> list[Change]:
    planned = service.cell.intake.plan_monitor

    def blind(*arguments: Any) -> Any:
        return replace(planned(*arguments), stuck_samples=10**9, stuck_channel_samples=10**9)

    return [(service.cell.intake, "plan_monitor", blind), (Witness, "check", lambda *_: PASSED)]


def _joints_are_not_asked() -> list[Change]:
    return [(Witness, "check", lambda *_: PASSED)]


def _a_handle_is_taken_for_the_file() -> list[Change]:
    return [(Ledger, "_is_ours", lambda _: True)]


def _the_wall_clock_orders_runs() -> list[Change]:
    return [(Journal, "next_seq", lambda journal: max(1, int(journal.time_of_day() * 1e3)))]


def _a_latch_is_not_written() -> list[Change]:
    return [(LatchFile, "_replace", lambda *_: None), (Journal, "_latch_by_ledger", lambda _: None)]


def _depth_alone_is_success() -> list[Change]:
    observe = Seating.observe

    def deep(seating: Any, *arguments: Any) -> Any:
        seat, settled = observe(seating, *arguments)
        deep = seat.depth_m > seating._parameters.success_depth_m
        return (replace(seat, finding=Finding.SEATED), True) if deep else (seat, settled)

    return [(Seating, "observe", deep)]


FAULTS = (
    Fault("depth alone is success", plan.wrong_camera, ("false success",), _depth_alone_is_success),
    Fault("a start outlives a stop", plan.stop_beside_start, ("motion after a stop",), _starts_forget_stops),
    Fault("frozen channels pass", plan.lying_sensor, ("force", "false success"), _channels_may_stand_still),
    Fault("no second witness", plan.lying_sensor, ("force", "false success"), _joints_are_not_asked),
    Fault(
        "a handle is taken for the ledger's file",
        plan.moved_files,
        ("record", "endless run", "history"),
        _a_handle_is_taken_for_the_file,
    ),
    Fault("the wall clock orders the runs", plan.clock_set, ("order",), _the_wall_clock_orders_runs),
    Fault("a latch is forgotten", plan.killed_while_latched, ("latch",), _a_latch_is_not_written),
)
IN_CI = (1, 3, 4)


def found(fault: Fault, monkeypatch: pytest.MonkeyPatch) -> int | None:
    """The first seed of the story that finds the fault; None where none does."""
    for owner, name, value in fault.changes():
        monkeypatch.setattr(owner, name, value)
    for seed in range(SEEDS):
        outcome = tell(seed, drawn(seed, fault.story))
        if any(violation.partition(" ")[2].startswith(fault.finds) for violation in outcome.violations):
            return seed
    return None


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "fault",
    [
        pytest.param(fault, id=fault.item, marks=() if number in IN_CI else pytest.mark.nightly)
        for number, fault in enumerate(FAULTS)
    ],
)
def test_a_fault_that_is_put_back_is_found(fault: Fault, monkeypatch: pytest.MonkeyPatch) -> None:
    assert found(fault, monkeypatch) is not None
