"""What one insertion says: its orders to the cell, and one record per policy step for recorder, telemetry and tests."""

from dataclasses import dataclass

from service.drivers.base import PoseTarget, Sample
from service.faults import FaultCode
from service.messages import CellState
from service.safety.bounds import BoundedCommand
from service.safety.dsl import DslOutput
from wire.arrays import Float32Array, FloatArray
from wire.law import ComplianceLaw, ControlLimits


@dataclass(frozen=True, slots=True)
class TickRecord:
    """Everything of one policy step, from the sample to the target.

    Attributes:
        step: counts from 0.
        sample: the newest one when the observation was built.
        observation: (n,) float32, as the policy got it.
        action: (m,) as the policy gave it.
        displacement: (4,) m and rad, base frame: the action in units, before the lock.
        dsl: what the lock made of it.
        bounded: what the bounds made of that.
        target: what was sent.
        depth_m: of the peg's bottom below the surface, as far as known; NaN otherwise.
    """

    step: int
    sample: Sample
    observation: Float32Array
    action: FloatArray
    displacement: FloatArray
    dsl: DslOutput
    bounded: BoundedCommand
    target: PoseTarget
    depth_m: float


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
class Enter:
    """The cell's state changes."""

    state: CellState


@dataclass(frozen=True, slots=True)
class Disengage:
    """Stop the control program: the ordinary end of a run, to be confirmed by measurement."""


@dataclass(frozen=True, slots=True)
class Fail:
    """The run has failed without danger: it will not succeed, nothing latches."""

    code: FaultCode
    text: str


@dataclass(frozen=True, slots=True)
class Succeed:
    """The peg is in the hole."""

    depth_m: float


@dataclass(frozen=True, slots=True)
class Halt:
    """Stop at once and latch."""

    code: FaultCode
    text: str


Order = ZeroFt | Engage | Move | Infer | Enter | Disengage | Fail | Succeed | Halt
