"""Compares the force/torque sensor with the force that the arm's joints feel.

The sensor feeds the compliance law, the lock and both ceilings; a sensor that lies blinds all of them at once. The
torques of the joints show the same contact force by other means: coarser, since the gears' friction is in them, and
without any part in common with the sensor. The two must agree within the joints' own error.
"""

from dataclasses import dataclass
from math import hypot, isfinite

import numpy as np

from service.faults import FaultCode
from service.safety.verdict import PASSED, Verdict
from wire.arrays import FloatArray

FELT_STUCK_SAMPLES = 25
"""Samples in a row, bit-identical in what the joints feel, at which they are no witness. Their noise never rests."""


@dataclass(frozen=True, slots=True)
class WitnessParameters:
    """Conditions under which the sensor is believed; the configuration sets the values.

    Attributes:
        force_n: largest difference between the force of the sensor and that of the joints, N. It is above the joints'
            own error, so that a healthy sensor never differs by it.
        time_s: time constant of the mean over which they are compared, s: the sensor is late, and an arm that
            accelerates carries its own mass.
        rest_force_n: largest force that the joints of a resting arm with a free tool may feel, N. A larger one means a
            load on the tool, or another payload than the configured one.
    """

    force_n: float
    time_s: float
    rest_force_n: float

    def __post_init__(self) -> None:
        """Refuse limits that compare nothing.

        Raises:
            ValueError: a field is out of range; the text names it.
        """
        for name in ("force_n", "time_s", "rest_force_n"):
            value = getattr(self, name)
            if not (isfinite(value) and value > 0):
                raise ValueError(f"witness.{name} must be finite and above zero, not {value!r}")


class Witness:
    """Compares the samples of one run.

    Args:
        parameters: conditions.
        tick_s: period of the samples, s.
        offset: (3,) what the joints feel more than the sensor while the arm rests with a free tool, N, base frame.
    """

    __slots__ = ("_equal", "_felt", "_limit", "_mean", "_offset", "_share")

    def __init__(self, parameters: WitnessParameters, tick_s: float, offset: FloatArray) -> None:
        self._limit = parameters.force_n
        self._share = tick_s / (tick_s + parameters.time_s)
        self._offset: tuple[float, float, float] = tuple(offset.tolist())
        self._mean = (0.0, 0.0, 0.0)
        self._felt: list[float] = []
        self._equal = 0

    def check(self, wrench: FloatArray, joint_force: FloatArray | None) -> Verdict:
        """Judge one sample.

        Args:
            wrench: (6,) N and N·m at the TCP, base frame, zeroed.
            joint_force: (3,) force that the joints feel, N, base frame; None if it is missing.

        Returns:
            SENSOR_INVALID, SENSOR_STUCK where the joints' force does not change by a bit, or passed.
        """
        if joint_force is None:
            return Verdict(FaultCode.SENSOR_INVALID, text="the force that the joints feel is missing from a sample")
        sensed, felt = wrench.tolist()[:3], joint_force.tolist()
        self._equal = self._equal + 1 if felt == self._felt else 1
        self._felt = felt
        if self._equal >= FELT_STUCK_SAMPLES:
            return Verdict(
                FaultCode.SENSOR_STUCK,
                self._equal,
                FELT_STUCK_SAMPLES,
                f"the force that the joints feel is bit-identical in {self._equal} samples in a row, limit "
                f"{FELT_STUCK_SAMPLES}: nothing checks the force/torque sensor",
            )
        share = self._share
        x, y, z = (
            mean + share * (f - o - s - mean)
            for mean, f, o, s in zip(self._mean, felt, self._offset, sensed, strict=True)
        )
        self._mean = (x, y, z)
        apart = hypot(x, y, z)
        if apart < self._limit:  # NaN is not
            return PASSED
        fx, fy, fz = (f - o for f, o in zip(felt, self._offset, strict=True))
        return Verdict(
            FaultCode.SENSOR_INVALID,
            apart,
            self._limit,
            f"the sensor reads {_newtons(sensed)} N and the joints feel {_newtons([fx, fy, fz])} N: "
            f"{apart:.1f} N apart, limit {self._limit:g} N; one of them lies",
        )


def check_rest(parameters: WitnessParameters, unzeroed: FloatArray, felt: FloatArray) -> Verdict:
    """Judge the load of a resting arm by its joints, before the sensor is zeroed.

    The sensor alone cannot tell its own bias from a load; the joints have no part in its bias.

    Args:
        parameters: conditions.
        unzeroed: (T, 6) N and N·m at the TCP, base frame, the payload's weight taken off, not zeroed.
        felt: (T, 3) force that the joints feel, N, base frame.

    Returns:
        CONTACT_AT_START, or passed.
    """
    mean = felt.mean(0)
    load_n = float(np.linalg.norm(mean))
    if load_n < parameters.rest_force_n:
        return PASSED
    return Verdict(
        FaultCode.CONTACT_AT_START,
        load_n,
        parameters.rest_force_n,
        f"the joints of the resting arm feel {_newtons(mean.tolist())} N beyond the configured payload's weight, "
        f"{load_n:.1f} N in all, limit {parameters.rest_force_n:g} N (the sensor, not zeroed, reads "
        f"{_newtons(unzeroed.mean(0).tolist()[:3])} N): free the tool; if nothing touches it, weigh the payload again",
    )


def _newtons(force: list[float]) -> str:
    return "[" + ", ".join(f"{component:.1f}" for component in force) + "]"
