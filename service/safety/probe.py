"""Asks the walls of a hole whether the peg is between them, gently, where no contact has told it.

The tip sinks by what may be wrong about the depth, unless something stops it, is drawn up by the depth to be proven and
pushed aside, first one way, then the other, until something holds it.
A peg that is held on both sides within the width of its hole was at least that deep. In free air, on a surface or
beside a block, at least one side is free. Drawn up, the tip rests on nothing, so friction cannot hold it.
"""

from dataclasses import dataclass, fields
from enum import Enum, StrEnum
from math import isfinite

import numpy as np

from wire.arrays import FloatArray

WIDTH_PER_CLEARANCE = 3.5
"""Longest way of a peg between the walls of its hole, over the clearance per face: 2√3 along a triangle's side."""
GIVE_M = 2.5e-3
"""Further way that the peg's tilt in the fingers and the arm give under `held_n`, m."""

RETURNED_M = 5e-4
"""Distance from where the probe began at which the tip is back."""


@dataclass(frozen=True, slots=True)
class ProbeParameters:
    """Motion and criteria of a probe.

    Attributes:
        sink_m: depth by which the tip sinks first, m.
        proven_m: measured rise of the tip that proves the depth, m.
        clearance_m: clearance per face, m.
        held_n: force against the motion from which a side holds the tip, N.
        step_m: change of the target from one call to the next, m.
        lead_m: largest lead of the target over the tip, m: sideways, and up or down.
        patience: calls after which a leg has failed.
    """

    sink_m: float
    proven_m: float
    clearance_m: float
    held_n: float
    step_m: float
    lead_m: tuple[float, float]
    patience: int

    def __post_init__(self) -> None:
        """Refuse a probe that proves nothing.

        Raises:
            ValueError: a field is out of range; the text names it.
        """
        for field in fields(self):
            value = getattr(self, field.name)
            if not all(isfinite(number) and number > 0 for number in np.atleast_1d(value)):
                raise ValueError(f"probe.{field.name} must be finite and above zero, not {value!r}")

    @property
    def width_m(self) -> float:
        """Longest way between two walls, m."""
        return WIDTH_PER_CLEARANCE * self.clearance_m + GIVE_M


class Answer(StrEnum):
    UNDER_WAY = "UNDER_WAY"
    HELD = "HELD"
    FREE = "FREE"
    """A side is free."""
    STUCK = "STUCK"
    """The tip did not come up, or no side held or freed it in time."""


class _Leg(Enum):
    DOWN = 0
    UP = 1
    ONE_SIDE = 2
    OTHER_SIDE = 3
    BACK = 4


class Probe:
    """One probe, from the pose of the tip when it begins. It ends where it began, if the tip is held.

    Args:
        parameters: motion and criteria.
        tip: (3,) m, measured TCP, base frame.
        yaw: rad, measured; it is kept.

    Attributes:
        target: (3,) m, position to command.
        force_n: largest force against the motion so far, N.
    """

    def __init__(self, parameters: ProbeParameters, tip: FloatArray, yaw: float) -> None:
        self._parameters = parameters
        self._start = tip.copy()
        self._lowest_m = float(tip[2])
        self._leg = _Leg.DOWN
        self._calls = 0
        self._from_m = 0.0
        self._rest_n = 0.0
        self.target = tip.copy()
        self.yaw = yaw
        self.force_n = 0.0

    @property
    def text(self) -> str:
        """Answer of the walls where they do not hold the tip; for people."""
        if self._leg in (_Leg.DOWN, _Leg.UP):
            return "drawn up, it does not come"
        way_m = self._parameters.width_m
        return f"pushed aside, nothing holds it within {way_m * 1e3:.1f} mm ({self.force_n:.1f} N were felt)"

    def advance(self, tip: FloatArray, force: FloatArray) -> Answer:
        """Advance the target by one step and judge.

        Args:
            tip: (3,) m, measured TCP, base frame.
            force: (3,) N, mean of the newest samples, base frame, on the tool.
        """
        self._calls += 1
        if self._calls > self._parameters.patience:
            return Answer.HELD if self._leg is _Leg.BACK else Answer.STUCK
        if self._leg is _Leg.DOWN:
            return self._sink(tip, force)
        if self._leg is _Leg.UP:
            return self._rise(tip, force)
        if self._leg is _Leg.ONE_SIDE:
            return self._push(1.0, _Leg.OTHER_SIDE, tip, force)
        if self._leg is _Leg.OTHER_SIDE:
            return self._push(-1.0, _Leg.BACK, tip, force)
        return self._return(tip)

    def _sink(self, tip: FloatArray, force: FloatArray) -> Answer:
        parameters, end_m = self._parameters, float(self._start[2]) - self._parameters.sink_m
        self._lead(2, -1.0, tip)
        self._lowest_m = min(self._lowest_m, float(tip[2]))
        if self._lowest_m <= end_m or float(force[2]) >= parameters.held_n:
            self._begin(_Leg.UP, tip)
        return Answer.UNDER_WAY

    def _rise(self, tip: FloatArray, force: FloatArray) -> Answer:
        self._lead(2, 1.0, tip)
        self._lowest_m = min(self._lowest_m, float(tip[2]))
        if float(tip[2]) - self._lowest_m >= self._parameters.proven_m:
            self.target[2] = tip[2]
            self._rest_n = float(force[0])
            self._begin(_Leg.ONE_SIDE, tip)
        return Answer.UNDER_WAY

    def _push(self, sign: float, following: _Leg, tip: FloatArray, force: FloatArray) -> Answer:
        parameters = self._parameters
        against_n = sign * (self._rest_n - float(force[0]))
        self.force_n = max(self.force_n, against_n)
        if sign * (float(tip[0]) - self._from_m) > parameters.width_m:
            return Answer.FREE
        if against_n >= parameters.held_n:
            self.target[0] = tip[0]
            self._begin(following, tip)
        else:
            self._lead(0, sign, tip)
        return Answer.UNDER_WAY

    def _return(self, tip: FloatArray) -> Answer:
        way, step_m = self._start - self.target, self._parameters.step_m
        if float(np.linalg.norm(self.target - tip)) < max(self._parameters.lead_m):
            self.target = self.target + way * (step_m / max(float(np.linalg.norm(way)), step_m))
        return Answer.HELD if float(np.linalg.norm(tip - self._start)) <= RETURNED_M else Answer.UNDER_WAY

    def _lead(self, axis: int, sign: float, tip: FloatArray) -> None:
        """Move the target ahead along an axis, as far as the lead allows."""
        parameters = self._parameters
        lead_m = parameters.lead_m[axis // 2]
        ahead_m = min(sign * float(self.target[axis] - tip[axis]) + parameters.step_m, lead_m)
        self.target[axis] = tip[axis] + sign * ahead_m

    def _begin(self, leg: _Leg, tip: FloatArray) -> None:
        self._leg, self._calls, self._from_m = leg, 0, float(tip[0])
