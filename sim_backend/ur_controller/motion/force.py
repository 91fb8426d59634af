"""Force mode: an admittance along the axes that a script selects, the program's own motion along the others.

UR publishes the interface of force mode, not its law. This one is a mass that moves against damping:
`mass · v̇ = gain · (wrench to apply + measured wrench) - damping · v`, so that it comes to rest where the tool presses
with the wrench asked for, and drifts with a speed in proportion to it in free space.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from sim_backend.ur_controller.geometry import Rotation, Vector, rotate, rotation_of, transpose
from wire.records import TICK_S

DEFAULT_DAMPING, DEFAULT_GAIN = 0.005, 1.0
"""What `force_mode_set_damping` and `force_mode_set_gain_scaling` set, before they do."""

_MASS = (3.0, 3.0, 3.0, 0.1, 0.1, 0.1)
_DAMPING = (300.0, 300.0, 300.0, 5.0, 5.0, 5.0)
"""kg and N·s/m, kg·m² and N·m·s/rad at the default damping. The contact's stiffness over the damping is the loop's
bandwidth, 17 rad/s at 1.7e4 N/m: far enough below what the sensor's delay and the joints' lag allow."""

_AXES = range(6)


@dataclass(frozen=True, slots=True)
class ForceTask:
    """What a script asks force mode for.

    Attributes:
        frame: pose of the task frame, base frame.
        selection: (6,) axes of the task frame that are compliant.
        wrench: (6,) to apply to the environment, task frame, N and N·m at the TCP.
        kind: 1: the frame's y axis points from the TCP to the frame's origin; 2: the frame as given; 3: its x axis is
            the TCP's velocity in the frame's x-y plane.
        limits: (6,) of a compliant axis the largest speed, m/s and rad/s; of another the largest deviation of the
            measured TCP from where the program has it, m and rad; 0 there is no limit.
    """

    frame: Sequence[float]
    selection: Sequence[bool]
    wrench: Sequence[float]
    kind: int
    limits: Sequence[float]


class ForceMode:
    """The admittance's state."""

    def __init__(self, task: ForceTask) -> None:
        self._speed = [0.0] * 6
        self.command(task)

    def command(self, task: ForceTask) -> None:
        """Take another task while it moves."""
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
        """Twist (6,) of the TCP for the next tick, base frame.

        Args:
            program: (6,) twist that the program asks for, base frame.
            point: the TCP, base frame.
            measured: (6,) wrench on the tool at the TCP, base axes.
            saturated: the sensor is at the end of its range, so the load is larger than measured.
            damping: 0 … 1.
            gain: 0 … 2.
            fraction: of the full speed, 0 … 1; a paused program does not give way either.
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
                    limit = 0.0  # what the arm applies may stay below what was asked for
                twist[i] = speed[i] = max(-limit, min(limit, value))
            else:
                twist[i], speed[i] = asked[i], 0.0
        return [*rotate(axes, twist[:3]), *rotate(axes, twist[3:])]

    def exceeded(self, deviation: Sequence[float]) -> bool:
        """Whether the measured TCP, off by `deviation` (6,) in base axes, is too far along an axis that is stiff."""
        task, back = self._task, transpose(self._axes)
        off = (*rotate(back, deviation[:3]), *rotate(back, deviation[3:]))
        return any(
            not compliant and 0.0 < limit < abs(distance)
            for compliant, limit, distance in zip(task.selection, task.limits, off, strict=True)
        )


def _facing(given: Rotation, point: Vector, origin: Vector) -> Rotation:
    """`given` with its y axis turned from `point` towards `origin`, its z axis as near as can be to where it was."""
    away = (origin[0] - point[0], origin[1] - point[1], origin[2] - point[2])
    return _framed(away, (given[2], given[5], given[8]), given, along_x=False)


def _along(given: Rotation, program: Sequence[float], last: Rotation) -> Rotation:
    """`given` turned about its z axis until x is along the program's velocity; `last` while there is none."""
    z = (given[2], given[5], given[8])
    out = program[0] * z[0] + program[1] * z[1] + program[2] * z[2]
    flat = (program[0] - out * z[0], program[1] - out * z[1], program[2] - out * z[2])
    return _framed(flat, z, last, along_x=True)


def _framed(direction: Vector, up: Vector, otherwise: Rotation, *, along_x: bool) -> Rotation:
    """Axes with x, or y, along `direction` and z nearest to `up`; `otherwise` where that is undefined."""
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
