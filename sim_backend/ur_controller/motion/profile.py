"""The trapezoid along which every move goes: accelerate, cruise, brake."""

import math

_RAMP_SHARE = 0.25
"""Share of a move's time that each of its ramps takes when the script gives the time and nothing else."""
_NOWHERE = 1e-9
"""A path shorter than this, m or rad, is no path; the move is over at once."""


class Trapezoid:
    """Distance along a path as a function of time.

    Args:
        length: of the path, m or rad.
        speed: at which it is travelled if it is long enough.
        acceleration: of both ramps.
        duration_s: when positive, takes precedence over speed and acceleration.

    Attributes:
        length: as given.
        duration_s: of the whole move.
        braking_from: distance at which the last ramp begins.
    """

    __slots__ = ("_acceleration", "_ramp_s", "_speed", "braking_from", "duration_s", "length")

    def __init__(self, length: float, speed: float, acceleration: float, duration_s: float = 0.0) -> None:
        self.length = length
        if length < _NOWHERE:
            self.duration_s = self._ramp_s = self._speed = self._acceleration = 0.0
            self.braking_from = length
            return
        if duration_s > 0.0:
            self.duration_s = duration_s
            self._ramp_s = _RAMP_SHARE * duration_s
            self._speed = length / (duration_s - self._ramp_s)
            self._acceleration = self._speed / self._ramp_s
        else:
            self._acceleration = acceleration
            self._speed = min(speed, math.sqrt(length * acceleration))
            self._ramp_s = self._speed / acceleration
            self.duration_s = self._ramp_s + length / self._speed
        self.braking_from = length - 0.5 * self._speed * self._ramp_s

    def at(self, time_s: float) -> tuple[float, float]:
        """Distance travelled and speed, `time_s` after the start."""
        if time_s < self._ramp_s:
            return 0.5 * self._acceleration * time_s * time_s, self._acceleration * time_s
        left_s = self.duration_s - time_s
        if left_s <= 0.0:
            return self.length, 0.0
        if left_s < self._ramp_s:
            return self.length - 0.5 * self._acceleration * left_s * left_s, self._acceleration * left_s
        return self._speed * (time_s - 0.5 * self._ramp_s), self._speed
