"""Asks the walls of a hole whether the peg is between them, gently, where no contact has told it.

The tip is drawn up by the depth to be proven and pushed aside, first one way, then the other, until something holds it.
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


@dataclass(frozen=True, slots=True)
class ProbeParameters:
    """Motion and criteria of a probe.

    Attributes:
        lift_m: height by which the tip is drawn up, m.
        proven_m: smallest measured rise that proves the depth, m; below `lift_m`.
        clearance_m: clearance per face, m.
        held_n: force against the motion from which a side holds the tip, N.
        step_m: change of the target from one call to the next, m.
        lead_m: largest lead of the target over the tip, m.
        patience: calls after which a leg has failed.
    """

    lift_m: float
    proven_m: float
    clearance_m: float
    held_n: float
    step_m: float
    lead_m: float
    patience: int

    def __post_init__(self) -> None:
        """Refuse a probe that proves nothing.

        Raises:
            ValueError: a field is out of range; the text names it.
        """
        for field in fields(self):
            value = getattr(self, field.name)
            if not (isfinite(value) and value > 0):
                raise ValueError(f"probe.{field.name} must be finite and above zero, not {value!r}")
        if self.proven_m >= self.lift_m:
            raise ValueError("probe.proven_m must be below probe.lift_m")

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
    UP = 0
    ONE_SIDE = 1
    OTHER_SIDE = 2
    BACK = 3


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
        self._leg = _Leg.UP
        self._calls = 0
        self._from_m = 0.0
        self._rest_n = 0.0
        self.target = tip.copy()
        self.yaw = yaw
        self.force_n = 0.0

    @property
    def text(self) -> str:
        """Answer of the walls where they do not hold the tip; for people."""
        match self._leg:
            case _Leg.UP:
                return "drawn up, it does not come"
            case _Leg.ONE_SIDE | _Leg.OTHER_SIDE:
                way_m = self._parameters.width_m
                return f"pushed aside, nothing holds it within {way_m * 1e3:.1f} mm ({self.force_n:.1f} N were felt)"
            case _Leg.BACK:
                return ""

    def advance(self, tip: FloatArray, force: FloatArray) -> Answer:
        """Advance the target by one step and judge.

        Args:
            tip: (3,) m, measured TCP, base frame.
            force: (3,) N, mean of the newest samples, base frame, on the tool.
        """
        self._calls += 1
        if self._calls > self._parameters.patience:
            return Answer.HELD if self._leg is _Leg.BACK else Answer.STUCK
        match self._leg:
            case _Leg.UP:
                self._rise(tip, force)
                return Answer.UNDER_WAY
            case _Leg.ONE_SIDE:
                return self._push(1.0, _Leg.OTHER_SIDE, tip, force)
            case _Leg.OTHER_SIDE:
                return self._push(-1.0, _Leg.BACK, tip, force)
            case _Leg.BACK:
                return self._return()

    def _rise(self, tip: FloatArray, force: FloatArray) -> None:
        parameters, start_m = self._parameters, float(self._start[2])
        self.target[2] = min(float(self.target[2]) + parameters.step_m, start_m + parameters.lift_m)
        if float(tip[2]) - start_m >= parameters.proven_m:
            self._rest_n = float(force[0])
            self._begin(_Leg.ONE_SIDE, tip)

    def _push(self, sign: float, following: _Leg, tip: FloatArray, force: FloatArray) -> Answer:
        parameters = self._parameters
        against_n = sign * (self._rest_n - float(force[0]))
        self.force_n = max(self.force_n, against_n)
        if sign * (float(tip[0]) - self._from_m) > parameters.width_m:
            return Answer.FREE
        if against_n >= parameters.held_n:
            self._begin(following, tip)
            return Answer.UNDER_WAY
        ahead = sign * (float(self.target[0]) - float(tip[0]))
        if ahead + parameters.step_m <= parameters.lead_m:
            self.target[0] += sign * parameters.step_m
        return Answer.UNDER_WAY

    def _return(self) -> Answer:
        way = self._start - self.target
        distance = float(np.linalg.norm(way))
        if distance <= self._parameters.step_m:
            self.target = self._start.copy()
            return Answer.HELD
        self.target = self.target + way * (self._parameters.step_m / distance)
        return Answer.UNDER_WAY

    def _begin(self, leg: _Leg, tip: FloatArray) -> None:
        self._leg, self._calls, self._from_m = leg, 0, float(tip[0])
