"""Movers in joint space: movej, speedj and stopj, servoj."""

import math
from collections.abc import Sequence

from sim_backend.ur_controller.plant import Plant
from sim_backend.world.kinematics import JOINT_SPEED_RAD_S
from wire.records import TICK_S

from .mover import Course, JointMover, Timer
from .profile import Trapezoid

_JOINTS = range(6)
_SPEED: tuple[float, ...] = tuple(JOINT_SPEED_RAD_S.tolist())
JOINT_RAD_S2 = 40.0
"""Largest acceleration of a joint in a move, rad/s²: 2292 °/s², the end of the pendant's settings."""

_HALVINGS = 12
_SETTLED_RAD, _SETTLED_RAD_S = 1e-6, 1e-5


def top_speed(path: Sequence[float]) -> float:
    """Return the speed of the leading axis of a straight joint path (6,), rad/s, at which a joint reaches its limit."""
    length = max(abs(d) for d in path)
    return min((limit * length / abs(d) for limit, d in zip(_SPEED, path, strict=True) if d), default=math.inf)


def blend_share(start: Sequence[float], target: Sequence[float], radius_m: float, plant: Plant) -> float:
    """Return the share of a straight joint path (6,) at which the TCP comes within a radius of its end; 1
    without one.
    """
    if radius_m <= 0.0:
        return 1.0
    end = plant.tcp_pose_of(target)[:3]
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        point = plant.tcp_pose_of([a + middle * (b - a) for a, b in zip(start, target, strict=True)])[:3]
        low, high = (low, middle) if math.dist(point, end) <= radius_m else (middle, high)
    return high


class MoveJ(JointMover):
    """Moves straight in joint space, with a trapezoidal profile of the leading axis.

    Args:
        start: (6,) joint angles, rad, of the arm at rest; the target of the previous move while that one is still
            moving.
        target: (6,) joint angles, rad.
        profile: profile of the leading axis.
        blend_from: distance of the leading axis from which the script may continue.
        tail: previous move, whose remainder runs out while this one begins.
    """

    def __init__(
        self,
        start: Sequence[float],
        target: Sequence[float],
        profile: Trapezoid,
        blend_from: float,
        tail: "MoveJ | None",
    ) -> None:
        self.target = list(target)
        self._start = list(start)
        self._path = [b - a for a, b in zip(start, target, strict=True)]
        self._course = Course(profile, blend_from)
        self._tail = tail

    def step(self, fraction: float) -> tuple[list[float], list[float]]:
        course = self._course
        share, rate = course.step(fraction)
        self.ready = course.blending
        if course.arrived and self._tail is None:
            self.done = True
            return list(self.target), [0.0] * 6
        q = [a + share * d for a, d in zip(self._start, self._path, strict=True)]
        qd = [rate * d for d in self._path]
        if self._tail is not None:
            tail_q, tail_qd = self._tail.step(fraction)
            end = self._tail.target
            for i in _JOINTS:
                q[i] += tail_q[i] - end[i]
                qd[i] += tail_qd[i]
            if self._tail.done:
                self._tail = None
        return q, qd


class SpeedJ(JointMover):
    """Accelerates to joint speeds, by the leading axis, and keeps them while the command holds.

    Args:
        q: (6,) present joint angles, rad.
        qd: (6,) present joint speeds, rad/s, at full speed of the slider.
    """

    def __init__(self, q: Sequence[float], qd: Sequence[float]) -> None:
        self._q, self._qd = list(q), list(qd)
        self._timer = Timer(0.0)
        self.command([0.0] * 6, 1.0, 0.0)

    def command(self, target: Sequence[float], acceleration: float, time_s: float) -> None:
        """Set another speed; without a further command the arm then stops.

        Args:
            target: (6,) joint speeds, rad/s.
            acceleration: acceleration of the leading axis, rad/s².
            time_s: time for which the command holds, s; 0 until the next command.
        """
        self._target = [max(-limit, min(limit, v)) for limit, v in zip(_SPEED, target, strict=True)]
        self._acceleration = acceleration
        self._timer = Timer(time_s, self._timer)
        self._resting = not any(self._target)
        self.ready = False

    def step(self, fraction: float) -> tuple[list[float], list[float]]:
        timer = self._timer
        target = self._target if timer.tick(fraction) else [0.0] * 6
        qd = self._qd
        change = [b - a for a, b in zip(qd, target, strict=True)]
        largest = max(abs(d) for d in change)
        limit = self._acceleration * TICK_S * fraction
        reached = largest <= limit
        if reached:
            self._qd = qd = list(target)
        else:
            share = limit / largest
            self._qd = qd = [a + share * d for a, d in zip(qd, change, strict=True)]
        self._q = [a + TICK_S * fraction * v for a, v in zip(self._q, qd, strict=True)]
        self.ready = reached if timer.endless else timer.elapsed
        self.done = reached and (self._resting or timer.elapsed) and not any(qd)
        return list(self._q), [fraction * v for v in qd]


class StopJ(SpeedJ):
    """Decelerates to rest, rad/s² of the leading axis, independently of the speed slider.

    Args:
        q: (6,) present joint angles, rad.
        qd: (6,) present joint speeds, rad/s.
        deceleration: deceleration of the leading axis, rad/s².
    """

    def __init__(self, q: Sequence[float], qd: Sequence[float], deceleration: float) -> None:
        super().__init__(q, qd)
        self.command([0.0] * 6, deceleration, 0.0)

    def step(self, fraction: float) -> tuple[list[float], list[float]]:
        return super().step(1.0)


class ServoJ(JointMover):
    """Follows a joint set-point that keeps changing.

    The manual describes a gain on the distance to the set-point and a look-ahead that projects the position forward
    with the present speed: `q̈ = gain · (target - q - lookahead · q̇)`. Behind a steadily moving set-point the arm lags
    by the look-ahead, as users measure on real arms.

    Args:
        q: (6,) joint angles, rad.
        qd: (6,) joint speeds, rad/s.
    """

    def __init__(self, q: Sequence[float], qd: Sequence[float]) -> None:
        self._q, self._qd = list(q), list(qd)
        self._target = list(q)
        self._gain, self._lookahead_s = 0.0, 0.0
        self._timer = Timer(0.0)

    def command(self, target: Sequence[float], time_s: float, lookahead_s: float, gain: float) -> None:
        """Set another set-point (6,) rad, for which the script waits during `time_s`."""
        self._target = list(target)
        self._gain, self._lookahead_s = gain, lookahead_s
        self._timer = Timer(max(time_s, TICK_S), self._timer)
        self.ready = False

    def step(self, fraction: float) -> tuple[list[float], list[float]]:
        held = self._timer.tick(fraction)
        self.ready = self._timer.elapsed
        push = TICK_S * self._gain
        drag = 1.0 / (1.0 + push * (self._lookahead_s + TICK_S))
        q, qd = self._q, self._qd
        for i in _JOINTS:
            speed = (qd[i] + push * (self._target[i] - q[i])) * drag
            limit = _SPEED[i] * fraction
            qd[i] = max(-limit, min(limit, speed))
            q[i] += TICK_S * qd[i]
        if not held and all(
            abs(self._target[i] - q[i]) < _SETTLED_RAD and abs(qd[i]) < _SETTLED_RAD_S for i in _JOINTS
        ):
            self.done = True
            return list(q), [0.0] * 6
        return list(q), list(qd)
