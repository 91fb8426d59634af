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
        fastest: speed and acceleration that are never exceeded, whatever is asked for.

    Attributes:
        length: as given.
        duration_s: of the whole move.
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
        """Distance travelled and speed, `time_s` after the start."""
        if time_s < self._ramp_s:
            return 0.5 * self._acceleration * time_s * time_s, self._acceleration * time_s
        left_s = self.duration_s - time_s
        if left_s <= 0.0:
            return self.length, 0.0
        if left_s < self._ramp_s:
            return self.length - 0.5 * self._acceleration * left_s * left_s, self._acceleration * left_s
        return self._speed * (time_s - 0.5 * self._ramp_s), self._speed


def _in_time(length: float, duration_s: float, top_speed: float, top_acceleration: float) -> tuple[float, float]:
    """Speed and acceleration of a move that lasts for a time; beyond the top ones where it cannot be done in time."""
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
