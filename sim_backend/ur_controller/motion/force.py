"""Force mode: an admittance along the axes that a script selects, and the program's own motion along the others.

UR publishes the interface of force mode, not its law. The law here is a mass that moves against damping:
`mass · v̇ = gain · (wrench to apply + measured wrench) - damping · v`. It comes to rest where the tool presses with the
requested wrench; in free space it drifts with a speed proportional to that wrench.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from sim_backend.ur_controller.geometry import Rotation, Vector, rotate, rotation_of, transpose
from wire.records import TICK_S

DEFAULT_DAMPING, DEFAULT_GAIN = 0.005, 1.0
"""Values before a script calls `force_mode_set_damping` and `force_mode_set_gain_scaling`."""

_MASS = (3.0, 3.0, 3.0, 0.1, 0.1, 0.1)
_DAMPING = (300.0, 300.0, 300.0, 5.0, 5.0, 5.0)
"""Damping at the default setting, kg and N·s/m, kg·m² and N·m·s/rad. The contact's stiffness over the damping is the
loop's bandwidth: 17 rad/s at 1.7e4 N/m, well below the limit set by the sensor's delay and the joints' lag."""

_AXES = range(6)


@dataclass(frozen=True, slots=True)
class ForceTask:
    """A script's request to force mode.

    Attributes:
        frame: pose of the task frame, base frame.
        selection: (6,) axes of the task frame that are compliant.
        wrench: (6,) wrench to apply to the environment, task frame, N and N·m at the TCP.
        kind: 1: the frame's y axis points from the TCP to the frame's origin; 2: the frame as given; 3: its x axis is
            the TCP's velocity in the frame's x-y plane.
        limits: (6,) for a compliant axis the largest speed, m/s and rad/s; for another axis the largest deviation of
            the measured TCP from the program's TCP, m and rad; 0 means no limit.
    """

    frame: Sequence[float]
    selection: Sequence[bool]
    wrench: Sequence[float]
    kind: int
    limits: Sequence[float]


class ForceMode:
    """State of the admittance."""

    def __init__(self, task: ForceTask) -> None:
        self._speed = [0.0] * 6
        self.command(task)

    def command(self, task: ForceTask) -> None:
        """Set another task, also during a motion."""
        x, y, z, *turn = task.frame
        self._origin: Vector = (x, y, z)
        self._given = rotation_of(*turn)
        self._axes = self._given
        self._task = task

    def step(
        self,
        program: Sequence[float],
        point: Vector,
        measured: Sequence[float],
        *,
        saturated: bool,
        damping: float,
        gain: float,
        fraction: float,
    ) -> list[float]:
        """Return the twist (6,) of the TCP for the next tick, base frame.

        Args:
            program: (6,) twist commanded by the program, base frame.
            point: position of the TCP, base frame.
            measured: (6,) wrench on the tool at the TCP, base axes.
            saturated: the sensor is at the end of its range, so the load is larger than measured.
            damping: damping setting, 0 … 1.
            gain: gain setting, 0 … 2.
            fraction: fraction of the full speed, 0 … 1; at 0, while a program is paused, the arm does not give way
                either.
        """
        task = self._task
        if task.kind == 1:
            self._axes = _facing(self._given, point, self._origin)
        elif task.kind == 3:
            self._axes = _along(self._given, program, self._axes)
        axes, back = self._axes, transpose(self._axes)
        asked = (*rotate(back, program[:3]), *rotate(back, program[3:]))
        felt = (*rotate(back, measured[:3]), *rotate(back, measured[3:]))
        drag = TICK_S * (damping / DEFAULT_DAMPING) ** 0.25
        speed = self._speed
        twist = [0.0] * 6
        for i in _AXES:
            if task.selection[i]:
                push = TICK_S * gain * (task.wrench[i] + felt[i])
                value = (_MASS[i] * speed[i] + push) / (_MASS[i] + drag * _DAMPING[i])
                limit = task.limits[i] * fraction
                if saturated and value * task.wrench[i] > 0.0:
                    limit = 0.0  # the arm may apply less than requested
                twist[i] = speed[i] = max(-limit, min(limit, value))
            else:
                twist[i], speed[i] = asked[i], 0.0
        return [*rotate(axes, twist[:3]), *rotate(axes, twist[3:])]

    def exceeded(self, deviation: Sequence[float]) -> bool:
        """Return True if the measured TCP, off by `deviation` (6,) in base axes, is too far along a stiff axis."""
        task, back = self._task, transpose(self._axes)
        off = (*rotate(back, deviation[:3]), *rotate(back, deviation[3:]))
        return any(
            not compliant and 0.0 < limit < abs(distance)
            for compliant, limit, distance in zip(task.selection, task.limits, off, strict=True)
        )


def _facing(given: Rotation, point: Vector, origin: Vector) -> Rotation:
    """Return `given` with its y axis turned from `point` towards `origin` and its z axis as near as possible
    to before.
    """
    away = (origin[0] - point[0], origin[1] - point[1], origin[2] - point[2])
    return _framed(away, (given[2], given[5], given[8]), given, along_x=False)


def _along(given: Rotation, program: Sequence[float], last: Rotation) -> Rotation:
    """Return `given` turned about its z axis until x is along the program's velocity; `last` without a velocity."""
    z = (given[2], given[5], given[8])
    out = program[0] * z[0] + program[1] * z[1] + program[2] * z[2]
    flat = (program[0] - out * z[0], program[1] - out * z[1], program[2] - out * z[2])
    return _framed(flat, z, last, along_x=True)


def _framed(direction: Vector, up: Vector, otherwise: Rotation, *, along_x: bool) -> Rotation:
    """Return axes with x, or y, along `direction` and z nearest to `up`; `otherwise` if that is undefined."""
    length = math.hypot(*direction)
    if length < 1e-6:
        return otherwise
    main = (direction[0] / length, direction[1] / length, direction[2] / length)
    side = (
        main[1] * up[2] - main[2] * up[1],
        main[2] * up[0] - main[0] * up[2],
        main[0] * up[1] - main[1] * up[0],
    )
    width = math.hypot(*side)
    if width < 1e-6:
        return otherwise
    # x = y × z, and y = -(x × z)
    sign = -1.0 / width if along_x else 1.0 / width
    other = (sign * side[0], sign * side[1], sign * side[2])
    x, y = (main, other) if along_x else (other, main)
    z = (x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0])
    return (x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2])
