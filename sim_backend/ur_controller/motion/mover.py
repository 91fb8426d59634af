"""What every mover is: something that says, tick by tick, where the arm is to be."""

from abc import ABC, abstractmethod

from sim_backend.ur_controller.geometry import Rotation, Vector
from wire.records import TICK_S

from .profile import Trapezoid

ToolState = tuple[Vector, Rotation, list[float]]
"""TCP position, rotation and twist (6,), base frame."""

_ROUNDING_S = 1e-9
_ROUNDING_TICKS = 1e-6


class Mover:
    """One motion of the arm.

    Attributes:
        ready: The script that started it may go on; the motion itself may last longer.
        done: The arm has arrived or stands still.
    """

    ready = False
    done = False


class JointMover(Mover, ABC):
    """A motion in joint space."""

    @abstractmethod
    def step(self, fraction: float) -> tuple[list[float], list[float]]:
        """Joint angles and speeds one tick on; `fraction` of the full speed, 0 … 1."""


class ToolMover(Mover, ABC):
    """A motion of the TCP in the base frame."""

    @abstractmethod
    def step(self, fraction: float) -> ToolState:
        """The TCP one tick on; `fraction` of the full speed, 0 … 1."""


class Timer:
    """Counts the ticks for which a speed or servo command holds; 0 s holds for ever.

    The speed slider stretches this time as it does that of moves: at half the speed a step of 2 ms lasts two ticks.
    What a tick takes beyond a command's time is counted to the next command, so that none of it is lost.

    Args:
        time_s: for which the command holds.
        last: timer of the command before, when this one follows it.
    """

    __slots__ = ("_left", "_starved", "endless")

    def __init__(self, time_s: float, last: "Timer | None" = None) -> None:
        self.endless = time_s <= 0.0
        self._left = float(max(1, round(time_s / TICK_S)))
        self._starved = False
        if last is not None and last.elapsed and not last._starved:
            self._left += last._left

    def tick(self, fraction: float) -> bool:
        """Use up one tick at a fraction of the full speed; whether the command still held in it."""
        self._starved = self.elapsed
        self._left -= fraction
        return not self._starved

    @property
    def elapsed(self) -> bool:
        """Whether its time is over."""
        return self._left <= _ROUNDING_TICKS and not self.endless


class Course:
    """Progress along a path; a slower speed slider stretches time, so the path stays the same.

    Where a script asks for a blend, the next move begins as this one brakes: the one's ramp down and the other's ramp
    up add to a speed that is never above either's.

    Args:
        profile: distance over time.
        blend_from: distance at which the script may go on, to blend into the next move.
    """

    __slots__ = ("_before_s", "_blend_from", "_profile", "_time_s", "arrived", "blending")

    def __init__(self, profile: Trapezoid, blend_from: float) -> None:
        self._profile = profile
        self._blend_from = max(blend_from, profile.braking_from)
        self._time_s = self._before_s = 0.0
        self.arrived = False
        self.blending = False

    def step(self, fraction: float) -> tuple[float, float]:
        """Share of the path travelled, 0 … 1, and its rate of change per second, one tick on."""
        self._before_s = self._time_s
        self._time_s += TICK_S * fraction
        profile = self._profile
        self.arrived = self.blending = False
        if self._time_s >= profile.duration_s - _ROUNDING_S:
            self.arrived = self.blending = True
            return 1.0, 0.0
        distance, speed = profile.at(self._time_s)
        self.blending = distance >= self._blend_from
        return distance / profile.length, speed * fraction / profile.length

    def rewind(self) -> None:
        """Take the last step back."""
        self._time_s = self._before_s
