"""Movers of the TCP: movel, movep, movec, speedl and stopl, servoc."""

import math
from abc import abstractmethod
from collections.abc import Sequence

from sim_backend.ur_controller.geometry import (
    Rotation,
    Vector,
    cross,
    multiply,
    rotate,
    rotation_of,
    rotvec_of,
    transpose,
)
from wire.records import TICK_S

from .mover import Course, Timer, ToolMover, ToolState
from .profile import Trapezoid

TURN_RADIUS_M = 0.25
"""Distance from the TCP of the point whose path represents a turn, m; the manual gives tool speeds only in m/s."""


FASTEST = (3.0, 15.0)
"""Limits of every path, m/s and m/s². An assumption: the speed that an arm can reach depends on its pose."""


class PathMover(ToolMover):
    """Follows a path of the TCP with a trapezoidal profile, from rest or from the end of the previous such move.

    Args:
        profile: profile over the path's length.
        blend_from: distance from which the script may continue.
        end: position and rotation at the end of the path.
        tail: previous move, whose remainder runs out while this one begins.
    """

    def __init__(
        self, profile: Trapezoid, blend_from: float, end: tuple[Vector, Rotation], tail: "PathMover | None"
    ) -> None:
        self.end = end
        self._course = Course(profile, blend_from)
        self._tail = tail

    @abstractmethod
    def at(self, share: float) -> tuple[Vector, Rotation, Vector, Vector]:
        """Return position, rotation and their rates of change per share, base axes, at a share of the path, 0 … 1."""

    def step(self, fraction: float) -> ToolState:
        if self._tail is not None and self._tail.done:
            self._tail = None
        course, tail = self._course, self._tail
        share, rate = course.step(fraction)
        self.ready = course.blending
        self.done = course.arrived and tail is None
        if self.done:
            return *self.end, [0.0] * 6
        (x, y, z), rotation, (dx, dy, dz), (rx, ry, rz) = self.at(share)
        twist = [rate * dx, rate * dy, rate * dz, rate * rx, rate * ry, rate * rz]
        if tail is None:
            return (x, y, z), rotation, twist
        (tail_x, tail_y, tail_z), tail_rotation, tail_twist = tail.step(fraction)
        (end_x, end_y, end_z), end_rotation = tail.end
        remaining = multiply(tail_rotation, transpose(end_rotation))
        turned = [*rotate(remaining, twist[3:])]
        return (
            (x + tail_x - end_x, y + tail_y - end_y, z + tail_z - end_z),
            multiply(remaining, rotation),
            [a + b for a, b in zip(twist[:3] + turned, tail_twist, strict=True)],
        )

    def rewind(self) -> None:
        """Undo the last step."""
        self._course.rewind()
        if self._tail is not None:
            self._tail.rewind()


class Line(PathMover):
    """Moves straight and turns about one axis.

    Args:
        start: position and rotation of the TCP at rest; the end of the previous move while that one is still moving.
        end: position and rotation at the end.
        limits: speed m/s, acceleration m/s², time s; a positive time takes precedence.
        blend_m: distance from the end at which the script may continue.
        tail: previous move, whose remainder runs out while this one begins.
    """

    def __init__(
        self,
        start: tuple[Vector, Rotation],
        end: tuple[Vector, Rotation],
        limits: tuple[float, float, float],
        blend_m: float,
        tail: PathMover | None,
    ) -> None:
        (self._start, self._rotation), (stop, rotation) = start, end
        self._way = (stop[0] - self._start[0], stop[1] - self._start[1], stop[2] - self._start[2])
        self._turn = rotvec_of(multiply(rotation, transpose(self._rotation)))
        distance = math.hypot(*self._way)
        length = max(distance, TURN_RADIUS_M * math.hypot(*self._turn))
        far = 1.0 - blend_m / distance if blend_m < distance else 0.0
        super().__init__(Trapezoid(length, *limits, FASTEST), length * far if blend_m > 0.0 else length, end, tail)

    def at(self, share: float) -> tuple[Vector, Rotation, Vector, Vector]:
        (x, y, z), (dx, dy, dz), (rx, ry, rz) = self._start, self._way, self._turn
        turned = multiply(rotation_of(share * rx, share * ry, share * rz), self._rotation)
        return (x + share * dx, y + share * dy, z + share * dz), turned, self._way, self._turn


class Arc(PathMover):
    """Moves along a circle through an intermediate point.

    Args:
        start: position and rotation of the TCP at rest; the end of the previous move while that one is still moving.
        via: intermediate position.
        end: position and rotation at the end.
        limits: speed m/s, acceleration m/s².
        blend_m: distance along the arc from the end at which the script may continue.
        fixed: keep the orientation relative to the arc; otherwise turn to the orientation of the end.
        tail: previous move, whose remainder runs out while this one begins.

    Raises:
        ValueError: the three points lie on one line.
    """

    def __init__(
        self,
        start: tuple[Vector, Rotation],
        via: Sequence[float],
        end: tuple[Vector, Rotation],
        limits: tuple[float, float],
        blend_m: float,
        fixed: bool,
        tail: PathMover | None,
    ) -> None:
        (self._start, self._rotation), (stop, rotation) = start, end
        first = _minus(via, self._start)
        second = _minus(stop, self._start)
        normal = cross(first, second)
        squared = _dot(normal, normal)
        if squared < 1e-18:
            raise ValueError("the three points of a circular move lie on one line")
        # centre of the circle through the three points, from the start
        a, b = _dot(first, first), _dot(second, second)
        blended = (b * first[0] - a * second[0], b * first[1] - a * second[1], b * first[2] - a * second[2])
        side = cross(normal, blended)
        towards = (side[0] / (2 * squared), side[1] / (2 * squared), side[2] / (2 * squared))
        self._centre = (self._start[0] + towards[0], self._start[1] + towards[1], self._start[2] + towards[2])
        self._arm = _minus(self._start, self._centre)
        size = math.sqrt(squared)
        axis = (normal[0] / size, normal[1] / size, normal[2] / size)
        last = _minus(stop, self._centre)
        angle = math.atan2(_dot(cross(self._arm, last), axis), _dot(self._arm, last)) % math.tau
        self._sweep = (axis[0] * angle, axis[1] * angle, axis[2] * angle)
        if fixed:
            self._turn: Vector = self._sweep
            rotation = multiply(rotation_of(*self._sweep), self._rotation)
        else:
            self._turn = rotvec_of(multiply(rotation, transpose(self._rotation)))
        arc = angle * math.hypot(*self._arm)
        length = max(arc, TURN_RADIUS_M * math.hypot(*self._turn))
        from_ = length * max(0.0, 1.0 - blend_m / arc)
        super().__init__(Trapezoid(length, *limits, 0.0, FASTEST), from_, (stop, rotation), tail)

    def at(self, share: float) -> tuple[Vector, Rotation, Vector, Vector]:
        (sx, sy, sz), (rx, ry, rz) = self._sweep, self._turn
        arm = rotate(rotation_of(share * sx, share * sy, share * sz), self._arm)
        turned = multiply(rotation_of(share * rx, share * ry, share * rz), self._rotation)
        x, y, z = self._centre
        return (x + arm[0], y + arm[1], z + arm[2]), turned, cross(self._sweep, arm), self._turn


class SpeedL(ToolMover):
    """Accelerates to a tool speed and keeps it while the command holds.

    Args:
        start: position and rotation of the TCP.
        twist: (6,) present twist, m/s and rad/s, base frame, at full speed of the slider.
    """

    def __init__(self, start: tuple[Vector, Rotation], twist: Sequence[float]) -> None:
        self._position, self._rotation = start
        self._twist = list(twist)
        self._timer = Timer(0.0)
        self.command([0.0] * 6, 1.0, 1.0, 0.0)

    def command(self, target: Sequence[float], acceleration: float, turning: float, time_s: float) -> None:
        """Set another speed; without a further command the arm then stops.

        Args:
            target: (6,) speed, m/s and rad/s, base frame.
            acceleration: linear acceleration, m/s².
            turning: angular acceleration, rad/s².
            time_s: time for which the command holds, s; 0 until the next command.
        """
        self._target = list(target)
        self._acceleration, self._turning = acceleration, turning
        self._timer = Timer(time_s, self._timer)
        self._resting = not any(target)
        self.ready = False

    def step(self, fraction: float) -> ToolState:
        timer = self._timer
        target = self._target if timer.tick(fraction) else [0.0] * 6
        time_s = TICK_S * fraction
        linear, near = _approach(self._twist[:3], target[:3], self._acceleration * time_s)
        angular, turned = _approach(self._twist[3:], target[3:], self._turning * time_s)
        self._twist = [*linear, *angular]
        (x, y, z), (vx, vy, vz, wx, wy, wz) = self._position, self._twist
        self._position = (x + time_s * vx, y + time_s * vy, z + time_s * vz)
        if wx or wy or wz:
            self._rotation = multiply(rotation_of(time_s * wx, time_s * wy, time_s * wz), self._rotation)
        reached = near and turned
        self.ready = reached if timer.endless else timer.elapsed
        self.done = reached and (self._resting or timer.elapsed) and not any(self._twist)
        return self._position, self._rotation, [fraction * v for v in self._twist]


class StopL(SpeedL):
    """Decelerates to rest at m/s² and rad/s², independently of the speed slider.

    Args:
        start: position and rotation of the TCP.
        twist: (6,) present twist, m/s and rad/s, base frame.
        deceleration: linear deceleration, m/s².
        turning: angular deceleration, rad/s².
    """

    def __init__(
        self, start: tuple[Vector, Rotation], twist: Sequence[float], deceleration: float, turning: float
    ) -> None:
        super().__init__(start, twist)
        self.command([0.0] * 6, deceleration, turning, 0.0)

    def step(self, fraction: float) -> ToolState:
        return super().step(1.0)


class ServoC(ToolMover):
    """Moves straight to a pose that may change on the way, at constant speed, and slows down only to stop there.

    Args:
        start: position and rotation of the TCP.
        twist: (6,) present twist, m/s and rad/s, base frame.
    """

    def __init__(self, start: tuple[Vector, Rotation], twist: Sequence[float]) -> None:
        self._position, self._rotation = start
        self._twist = list(twist)
        self._end = start
        self._speed = self._acceleration = 0.0
        self._blend_m = 0.0

    def command(self, end: tuple[Vector, Rotation], speed: float, acceleration: float, blend_m: float) -> None:
        """Set another pose, with m/s, m/s² and the distance from the pose at which the script may continue."""
        self._end = end
        self._speed, self._acceleration, self._blend_m = speed, acceleration, blend_m
        self.ready = self.done = False

    def step(self, fraction: float) -> ToolState:
        stop, rotation = self._end
        away = _minus(stop, self._position)
        turn = rotvec_of(multiply(rotation, transpose(self._rotation)))
        distance, angle = math.hypot(*away), math.hypot(*turn)
        length = max(distance, TURN_RADIUS_M * angle)
        step = self._acceleration * TICK_S
        # the largest speed from which it can still stop in time, in whole ticks
        braking = math.sqrt(0.25 * step * step + 2.0 * self._acceleration * length) - 0.5 * step
        speed = min(self._speed * fraction, braking, length / TICK_S)
        share = speed / length if length > 0.0 else 0.0
        linear, _ = _approach(self._twist[:3], [share * d for d in away], step)
        angular, _ = _approach(self._twist[3:], [share * d for d in turn], step / TURN_RADIUS_M)
        self._twist = twist = [*linear, *angular]
        x, y, z = self._position
        self._position = (x + TICK_S * linear[0], y + TICK_S * linear[1], z + TICK_S * linear[2])
        self._rotation = multiply(rotation_of(*(TICK_S * w for w in angular)), self._rotation)
        arrived = length < 1e-6 and max(map(abs, twist)) < 1e-3
        self.ready = arrived or (distance <= self._blend_m and TURN_RADIUS_M * angle <= self._blend_m)
        self.done = arrived
        return self._position, self._rotation, twist


def standing(pose: Sequence[float]) -> tuple[Vector, Rotation]:
    """Return position and rotation of a pose."""
    return (pose[0], pose[1], pose[2]), rotation_of(pose[3], pose[4], pose[5])


def _approach(value: Sequence[float], target: Sequence[float], step: float) -> tuple[list[float], bool]:
    """Return `value` (3,) moved towards `target` by at most `step`, and True once it has arrived."""
    dx, dy, dz = target[0] - value[0], target[1] - value[1], target[2] - value[2]
    change = math.sqrt(dx * dx + dy * dy + dz * dz)
    if change <= step:
        return [target[0], target[1], target[2]], True
    share = step / change
    return [value[0] + share * dx, value[1] + share * dy, value[2] + share * dz], False


def _minus(a: Sequence[float], b: Sequence[float]) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
