"""States of the arm in which a run cannot drive it, and the faults that they are."""

from service.cell.orders import Halt
from service.drivers.base import Program, RobotMode, SafetyMode, Sample, StopReason
from service.faults import FaultCode

ARM_STOPS: dict[StopReason, FaultCode] = {
    StopReason.NONE: FaultCode.LINK,
    StopReason.COMMAND: FaultCode.AUTHORITY,
    StopReason.FORCE_CEILING: FaultCode.FORCE_CEILING,
    StopReason.TARGET_AGE: FaultCode.LINK,
    StopReason.TARGET_REJECTED: FaultCode.BOUNDS,
    StopReason.JOINT_LIMIT: FaultCode.KINEMATICS,
    StopReason.KINEMATICS: FaultCode.KINEMATICS,
    StopReason.PROTECTIVE_FORCE: FaultCode.PROTECTIVE_STOP,
    StopReason.LEASE: FaultCode.AUTHORITY,
    StopReason.PROGRAM_ENDED: FaultCode.AUTHORITY,
}
"""Fault of a run for each reason for which the arm's own controller stops."""
ENDED = " (the control program was ended from elsewhere, or by its watchdog because this host was late)"
"""Possible causes of the end of a program that gave no reason."""


def why_not_drive(sample: Sample, *, engaged: bool) -> Halt | None:
    """Return the halt of a run whose arm cannot be driven; None where it can.

    Args:
        sample: of the arm.
        engaged: the run has engaged the arm's control program.
    """
    if sample.program is Program.PROTECTIVE_STOP:
        return Halt(FaultCode.PROTECTIVE_STOP, "the arm is in its protective stop: inspect the cell, then reset")
    if sample.robot_mode != RobotMode.RUNNING or sample.safety_mode != SafetyMode.NORMAL:
        modes = f"robot mode {sample.robot_mode}, safety mode {sample.safety_mode}"
        return Halt(FaultCode.AUTHORITY, f"the arm is not ours to move: {modes}")
    if engaged and sample.program is not Program.ENGAGED:
        reason = sample.stop_reason
        cause = ENDED if reason is StopReason.PROGRAM_ENDED else ""
        return Halt(ARM_STOPS[reason], f"the arm's controller stopped by itself: {reason.name}{cause}")
    return None
