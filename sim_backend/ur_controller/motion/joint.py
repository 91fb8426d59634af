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
"""Largest acceleration of a joint in a move: the 2292 °/s² at which the pendant's settings end."""

_HALVINGS = 12
_SETTLED_RAD, _SETTLED_RAD_S = 1e-6, 1e-5


def top_speed(path: Sequence[float]) -> float:
    """Speed of the leading axis of a straight joint path (6,) at which some joint turns as fast as it can, rad/s."""
    length = max(abs(d) for d in path)
    return min((limit * length / abs(d) for limit, d in zip(_SPEED, path, strict=True) if d), default=math.inf)


def blend_share(start: Sequence[float], target: Sequence[float], radius_m: float, plant: Plant) -> float:
    """Share of a straight joint path (6,) at which the TCP comes within a radius of its end; 1 without a radius."""
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
    """Straight in joint space, by a trapezoid of the leading axis.

    Args:
        start: (6,) joint angles, rad, of the arm at rest; the last move's target when it is still on its way.
        target: (6,) rad.
        profile: of the leading axis.
        blend_from: distance of the leading axis from which the script may go on.
        tail: the last move, whose remainder runs out while this one begins.
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
    """Towards joint speeds by an acceleration of the leading axis, and on with them while the command holds.

    Args:
        q: (6,) rad, where the arm is.
        qd: (6,) rad/s, its present speeds, at full speed of the slider.
    """

    def __init__(self, q: Sequence[float], qd: Sequence[float]) -> None:
        self._q, self._qd = list(q), list(qd)
        self._timer = Timer(0.0)
        self.command([0.0] * 6, 1.0, 0.0)

    def command(self, target: Sequence[float], acceleration: float, time_s: float) -> None:
        """Take another speed; without one after that the arm stops.

        Args:
            target: (6,) rad/s.
            acceleration: rad/s².
            time_s: for which the command holds, 0 until there is another one.
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
    """To rest by a deceleration of the leading axis, rad/s², whatever the speed slider says.

    Args:
        q: (6,) rad, where the arm is.
        qd: (6,) rad/s, its present speeds.
        deceleration: rad/s².
    """

    def __init__(self, q: Sequence[float], qd: Sequence[float], deceleration: float) -> None:
        super().__init__(q, qd)
        self.command([0.0] * 6, deceleration, 0.0)

    def step(self, fraction: float) -> tuple[list[float], list[float]]:
        return super().step(1.0)


class ServoJ(JointMover):
    """Joint angles that follow a set-point that keeps changing.

    The manual describes a gain on the distance to the set-point and a look-ahead that projects the position forward
    with the present speed: `q̈ = gain · (target - q - lookahead · q̇)`. Behind a steadily moving set-point it lags by
    the look-ahead, which is what users measure on real arms.

    Args:
        q: (6,) rad, where the arm is.
        qd: (6,) rad/s.
    """

    def __init__(self, q: Sequence[float], qd: Sequence[float]) -> None:
        self._q, self._qd = list(q), list(qd)
        self._target = list(q)
        self._gain, self._lookahead_s = 0.0, 0.0
        self._timer = Timer(0.0)

    def command(self, target: Sequence[float], time_s: float, lookahead_s: float, gain: float) -> None:
        """Take another set-point (6,) rad, which the script waits for during `time_s`."""
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
