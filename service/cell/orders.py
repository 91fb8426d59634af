"""Orders that an insertion gives; its run carries them out on the arm."""

from dataclasses import dataclass

from service.drivers.base import PoseTarget
from service.faults import FaultCode
from wire.arrays import Float32Array
from wire.law import ComplianceLaw, ControlLimits


@dataclass(frozen=True, slots=True)
class ZeroFt:
    """Zero the sensor."""


@dataclass(frozen=True, slots=True)
class Engage:
    """Start the control program on the arm."""

    law: ComplianceLaw
    limits: ControlLimits


@dataclass(frozen=True, slots=True)
class Move:
    """Send a target."""

    target: PoseTarget


@dataclass(frozen=True, slots=True)
class Infer:
    """Ask the policy; the answer goes to `Insertion.take_action`."""

    observation: Float32Array


@dataclass(frozen=True, slots=True)
class Disengage:
    """Stop the control program: the ordinary end of a run, to be confirmed by measurement."""


@dataclass(frozen=True, slots=True)
class Fail:
    """Let the run fail without danger: it will not succeed, and nothing latches."""

    code: FaultCode
    text: str


@dataclass(frozen=True, slots=True)
class Succeed:
    """Let the run succeed: the peg is in the hole."""

    depth_m: float


@dataclass(frozen=True, slots=True)
class Halt:
    """Stop at once and latch."""

    code: FaultCode
    text: str


Order = ZeroFt | Engage | Move | Infer | Disengage | Fail | Succeed | Halt
