"""Interface of all movers: objects that return, tick by tick, the commanded position of the arm."""

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
        ready: the script that started it may continue; the motion itself may last longer.
        done: the arm has arrived or stands still.
    """

    ready = False
    done = False


class JointMover(Mover, ABC):
    """A motion in joint space."""

    @abstractmethod
    def step(self, fraction: float) -> tuple[list[float], list[float]]:
        """Return joint angles and speeds one tick later; `fraction` of the full speed, 0 … 1."""


class ToolMover(Mover, ABC):
    """A motion of the TCP in the base frame."""

    @abstractmethod
    def step(self, fraction: float) -> ToolState:
        """Return the state of the TCP one tick later; `fraction` of the full speed, 0 … 1."""


class Timer:
    """Counts the ticks for which a speed or servo command holds; 0 s holds without end.

    The speed slider stretches this time like that of moves: at half speed a step of 2 ms lasts two ticks. The excess of
    a tick over a command's time is charged to the next command, so no time is lost.

    Args:
        time_s: time for which the command holds, s.
        last: timer of the previous command, if this one follows it.
    """

    __slots__ = ("_left", "_starved", "endless")

    def __init__(self, time_s: float, last: "Timer | None" = None) -> None:
        self.endless = time_s <= 0.0
        self._left = float(max(1, round(time_s / TICK_S)))
        self._starved = False
        if last is not None and last.elapsed and not last._starved:
            self._left += last._left

    def tick(self, fraction: float) -> bool:
        """Use one tick at a fraction of the full speed; return True if the command still held in it."""
        self._starved = self.elapsed
        self._left -= fraction
        return not self._starved

    @property
    def elapsed(self) -> bool:
        """The time is over."""
        return self._left <= _ROUNDING_TICKS and not self.endless


class Course:
    """Progress along a path; a lower speed slider stretches time, so the path stays the same.

    In a blend the next move begins while this one brakes: the ramp down of one and the ramp up of the other add to a
    speed that never exceeds either's.

    Args:
        profile: distance over time.
        blend_from: distance at which the script may continue, to blend into the next move.
    """

    __slots__ = ("_before_s", "_blend_from", "_profile", "_time_s", "arrived", "blending")

    def __init__(self, profile: Trapezoid, blend_from: float) -> None:
        self._profile = profile
        self._blend_from = max(blend_from, profile.braking_from)
        self._time_s = self._before_s = 0.0
        self.arrived = False
        self.blending = False

    def step(self, fraction: float) -> tuple[float, float]:
        """Return the share of the path travelled one tick later, 0 … 1, and its rate of change per second."""
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
        """Undo the last step."""
        self._time_s = self._before_s
