"""Trapezoidal profile of every move: accelerate, cruise, brake."""

import math

_RAMP_SHARE = 0.25
"""Share of a move's time that each ramp takes if the script gives only the time."""
_NOWHERE = 1e-9
"""Length below which a path, m or rad, counts as none; such a move is over at once."""


class Trapezoid:
    """Distance along a path as a function of time.

    Args:
        length: length of the path, m or rad.
        speed: cruising speed, if the path is long enough to reach it.
        acceleration: acceleration of both ramps.
        duration_s: if positive, overrides speed and acceleration.
        fastest: speed and acceleration that are never exceeded, whatever is requested.

    Attributes:
        length: length of the path.
        duration_s: duration of the whole move.
        braking_from: distance at which the last ramp begins.
    """

    __slots__ = ("_acceleration", "_ramp_s", "_speed", "braking_from", "duration_s", "length")

    def __init__(
        self,
        length: float,
        speed: float,
        acceleration: float,
        duration_s: float = 0.0,
        fastest: tuple[float, float] = (math.inf, math.inf),
    ) -> None:
        self.length = length
        if length < _NOWHERE:
            self.duration_s = self._ramp_s = self._speed = self._acceleration = 0.0
            self.braking_from = length
            return
        if duration_s > 0.0:
            speed, acceleration = _in_time(length, duration_s, *fastest)
        self._acceleration = min(acceleration, fastest[1])
        self._speed = min(speed, fastest[0], math.sqrt(length * self._acceleration))
        self._ramp_s = self._speed / self._acceleration
        self.duration_s = self._ramp_s + length / self._speed
        self.braking_from = length - 0.5 * self._speed * self._ramp_s

    def at(self, time_s: float) -> tuple[float, float]:
        """Return distance travelled and speed `time_s` after the start."""
        if time_s < self._ramp_s:
            return 0.5 * self._acceleration * time_s * time_s, self._acceleration * time_s
        left_s = self.duration_s - time_s
        if left_s <= 0.0:
            return self.length, 0.0
        if left_s < self._ramp_s:
            return self.length - 0.5 * self._acceleration * left_s * left_s, self._acceleration * left_s
        return self._speed * (time_s - 0.5 * self._ramp_s), self._speed


def _in_time(length: float, duration_s: float, top_speed: float, top_acceleration: float) -> tuple[float, float]:
    """Return speed and acceleration for a given duration; they exceed the top ones if it cannot be met otherwise."""
    speed = length / ((1.0 - _RAMP_SHARE) * duration_s)
    if speed > top_speed:
        speed = top_speed
        ramp_s = duration_s - length / speed
        return speed, speed / ramp_s if ramp_s > 0.0 else math.inf
    acceleration = speed / (_RAMP_SHARE * duration_s)
    if acceleration > top_acceleration:
        acceleration = top_acceleration
        room = (acceleration * duration_s) ** 2 - 4.0 * acceleration * length
        speed = 0.5 * (acceleration * duration_s - math.sqrt(room)) if room > 0.0 else math.inf
    return speed, acceleration
