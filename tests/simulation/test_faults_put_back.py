"""A test of the tests: each mend is taken out, and the universes must find the fault that it mends.

A mend is taken out by replacing the function that does it. The seeds are drawn from the story in which the fault shows.
"""

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import pytest
from pydantic import ValidationError

import api.application
import api.cell
import api.control_process
import api.protection
import service.cell.admission
import service.cell.intake
import service.cell.process
import service.cell.reception
import service.cell.starting
from service.cell.journal.journal import Journal
from service.cell.journal.latch_file import LatchFile
from service.cell.journal.ledger import Ledger
from service.cell.policies import PolicyShelf
from service.cell.reception import Reception, _signed, read
from service.cell.runs import Runs
from service.cell.starting import Starting
from service.cell.tickets import Tickets, Use
from service.envelope import Envelope
from service.logs import LogWriter
from service.safety.seating import Finding, Seating
from service.safety.verdict import PASSED
from service.safety.witness import Witness
from sim_backend.holding import Holding
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


def _validity_is_not_checked_after_the_disk() -> list[Change]:
    why_not, checked = Starting._why_not_now, list[Any]()

    def once(starting: Any, request: Any) -> Any:
        if any(one is request for one in checked):
            return None
        checked.append(request)
        return why_not(starting, request)

    return [(Starting, "_why_not_now", once)]


def _whatever_reaches_a_key_is_a_command() -> list[Change]:
    def command(_: Any, _asked: str, _key: str, payload: bytes, model: Any) -> Any:
        try:
            envelope = Envelope[model].model_validate_json(payload)
        except ValidationError:
            return read(payload or b"{}", model)
        return _signed(envelope.request, envelope.sender)

    return [(service.cell.reception, "_check_address", lambda *_: None), (Reception, "command", command)]


def _a_number_is_good_for_many_uses() -> list[Change]:
    return [(Tickets, "use", lambda *_: Use.FRESH)]


def _a_run_is_told_before_it_is_one() -> list[Change]:
    draft = Runs.draft

    def told(runs: Any, *arguments: Any) -> Any:
        runs._last = run = draft(runs, *arguments)
        return run

    return [(Runs, "draft", told)]


def _a_run_is_found_before_it_is_one() -> list[Change]:
    draft = Runs.draft

    def found(runs: Any, *arguments: Any) -> Any:
        run = draft(runs, *arguments)
        runs._journal.admit(run)
        return run

    return [(Runs, "draft", found)]


def _a_cell_waits_for_its_policies() -> list[Change]:
    return [(service.cell.process, "PARTS_S", math.inf)]


def _an_action_may_come_at_any_time() -> list[Change]:
    planned = service.cell.starting.plan_insertion

    def patient(*arguments: Any) -> Any:
        return replace(planned(*arguments), policy_deadline_s=math.inf)

    return [(service.cell.starting, "plan_insertion", patient)]


def _a_policy_that_hangs_is_not_killed() -> list[Change]:
    return [(PolicyShelf, "close", lambda _: None)]


def _a_log_line_is_written_where_it_is_logged() -> list[Change]:
    def put(writer: Any, line: Any) -> None:
        writer._write((line if isinstance(line, str) else line()).encode())

    return [(LogWriter, "put", put)]


def _a_cancellation_is_lost() -> list[Change]:
    async def end_once(tasks: Any, _within_s: float) -> set[Any]:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        return set()

    async def wait_alive(cell: Any, timeout_s: float) -> bool:
        deadline = cell._clock() + timeout_s
        while cell.is_silent and cell._clock() < deadline:
            await asyncio.wait_for(asyncio.sleep(0.02), 1.0)
        return not cell.is_silent

    async def may_be_joined(_: Any) -> bool:
        return True

    return [
        (api.application, "end_tasks", end_once),
        (api.control_process.ControlProcess, "may_be_joined", may_be_joined),
        (api.cell.FollowedCell, "wait_alive", wait_alive),
        (api.control_process.ControlProcess, "end_soon", lambda _: None),
    ]


def _a_stop_is_a_request_like_any_other() -> list[Change]:
    return [(api.protection, "is_stop", lambda *_: False)]


def _a_world_obeys_everybody() -> list[Change]:
    return [(Holding, "admits", lambda *_: True)]


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
    Fault(
        "a start is not judged after its wait for the disk",
        plan.waiting_for_disk,
        ("motion after a stop",),
        _validity_is_not_checked_after_the_disk,
    ),
    Fault(
        "a start moves the arm of a client that was told no",
        plan.waiting_for_disk,
        ("late start",),
        _validity_is_not_checked_after_the_disk,
    ),
    Fault("a reading stops", plan.strangers, ("stopped by nobody",), _whatever_reaches_a_key_is_a_command),
    Fault("a reading acknowledges", plan.strangers, ("latch",), _whatever_reaches_a_key_is_a_command),
    Fault("a copy stops", plan.strangers, ("stopped by nobody",), _a_number_is_good_for_many_uses),
    Fault("a copy acknowledges", plan.strangers, ("latch",), _a_number_is_good_for_many_uses),
    Fault("a copy starts", plan.strangers, ("started by nobody",), _a_number_is_good_for_many_uses),
    Fault("a run is told before it is one", plan.waiting_for_disk, ("phantom",), _a_run_is_told_before_it_is_one),
    Fault("a run is found before it is one", plan.waiting_for_disk, ("record",), _a_run_is_found_before_it_is_one),
    Fault("a hung model keeps the cell down", plan.hanging_policy, ("never at rest",), _a_cell_waits_for_its_policies),
    Fault("a hung model is waited for", plan.hanging_policy, ("hanging policy",), _an_action_may_come_at_any_time),
    Fault("a hung model outlives SIGTERM", plan.hanging_policy, ("never ends",), _a_policy_that_hangs_is_not_killed),
    Fault("a stop is refused", plan.stop_in_run, ("stop refused",), _a_stop_is_a_request_like_any_other),
    Fault("a log raises", plan.lost_logs, ("crash",), _a_log_line_is_written_where_it_is_logged),
    Fault("a world obeys everybody", plan.strangers, ("stopped by a stranger",), _a_world_obeys_everybody),
    Fault("a log blocks", plan.lost_logs, ("late answer",), _a_log_line_is_written_where_it_is_logged),
    Fault("a cancellation is lost", plan.told_to_end, ("never ends",), _a_cancellation_is_lost),
    Fault("something starts after SIGTERM", plan.told_to_end, ("start after the end",), _a_cancellation_is_lost),
)
IN_CI = (1, 3, 4, 7, 9, 14, 17, 19, 20)


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
