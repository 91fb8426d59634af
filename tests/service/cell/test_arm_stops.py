"""An arm that cannot be driven ends a run by the fault that its state means, and says so."""

from types import SimpleNamespace
from typing import Any

import pytest

from service.cell.arm_stops import ARM_STOPS, why_not_drive
from service.cell.orders import Halt
from service.drivers.base import Program, RobotMode, SafetyMode, StopReason
from service.faults import FaultCode


def judged(*, engaged: bool, **state: Any) -> Halt | None:
    """Return the halt of an arm that is fit to be driven but for `state`."""
    sample = {
        "program": Program.ENGAGED,
        "stop_reason": StopReason.NONE,
        "robot_mode": RobotMode.RUNNING,
        "safety_mode": SafetyMode.NORMAL,
    }
    return why_not_drive(SimpleNamespace(**sample | state), engaged=engaged)  # type: ignore[arg-type]


@pytest.mark.parametrize("engaged", [False, True])
def test_an_arm_in_order_is_driven(engaged: bool) -> None:
    assert judged(engaged=engaged) is None


def test_a_program_that_is_idle_is_in_order_before_it_was_engaged() -> None:
    assert judged(engaged=False, program=Program.IDLE) is None


@pytest.mark.parametrize("engaged", [False, True])
def test_33_a_protective_stop_is_told_as_one(engaged: bool) -> None:
    halt = judged(engaged=engaged, program=Program.PROTECTIVE_STOP, safety_mode=3)
    assert halt == Halt(FaultCode.PROTECTIVE_STOP, "the arm is in its protective stop: inspect the cell, then reset")


@pytest.mark.parametrize("engaged", [False, True])
@pytest.mark.parametrize(
    ("modes", "told"),
    [({"robot_mode": 5}, "robot mode 5, safety mode 1"), ({"safety_mode": 3}, "robot mode 7, safety mode 3")],
)
def test_35_an_arm_in_another_mode_is_not_ours(engaged: bool, modes: dict[str, int], told: str) -> None:
    halt = judged(engaged=engaged, **modes)
    assert halt == Halt(FaultCode.AUTHORITY, f"the arm is not ours to move: {told}")


@pytest.mark.parametrize("reason", StopReason)
def test_an_arm_that_stopped_by_itself_says_why(reason: StopReason) -> None:
    halt = judged(engaged=True, program=Program.IDLE, stop_reason=reason)
    assert halt is not None
    assert halt.code is ARM_STOPS[reason]
    said, _, cause = halt.text.partition(" (")
    assert said == f"the arm's controller stopped by itself: {reason.name}"
    assert ("this host was late" in cause) == (reason is StopReason.PROGRAM_ENDED)
