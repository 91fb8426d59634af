"""The record of one policy step, which recorders, telemetry and tests read."""

from dataclasses import dataclass

from service.drivers.base import PoseTarget, Sample
from service.safety.bounds import BoundedCommand
from service.safety.dsl import DslOutput
from wire.arrays import Float32Array, FloatArray


@dataclass(frozen=True, slots=True)
class TickRecord:
    """One policy step, from the sample to the target.

    Attributes:
        step: counts from 0.
        sample: the newest one when the observation was built.
        observation: (n,) float32, as the policy got it.
        action: (m,) as the policy gave it.
        displacement: (4,) m and rad, base frame: the action in units, before the lock.
        dsl: output of the lock.
        bounded: output of the bounds.
        target: the target that was sent.
        depth_m: depth of the peg's bottom below the surface, as far as known; NaN otherwise.
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
