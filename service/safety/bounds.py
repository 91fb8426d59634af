"""Bounds on every command: step, speed, workspace, yaw range, tilt, and the leash, the distance to the measured pose.

The functions work on any batch shape.

The bounds apply in this order: the leash, then step and speed from the previous command, then the workspace box. The
step and the box therefore always hold, given a previous command inside the box. The leash holds if the previous command
was within it. If the arm has fallen behind, the target returns to it at full step, because the arm's controller would
refuse a jump.
"""

from dataclasses import dataclass, fields
from math import pi

import numpy as np
import numpy.typing as npt

from service.safety.pose import wrap
from wire.arrays import BoolArray, Corner, FloatArray


@dataclass(frozen=True, slots=True)
class BoundsParameters:
    """Limits of a command.

    Attributes:
        period_s: time between two commands, s; turns speeds into steps.
        step_m: largest change of the target in one command, m, resultant.
        step_rad: largest change of the target's yaw in one command, rad.
        speed_mps: largest speed of the target, m/s.
        speed_radps: largest yaw rate of the target, rad/s.
        leash_m: largest distance of target to measured position, m.
        leash_rad: largest angle of target to measured yaw, rad.
        workspace_lower: lower corner of the box for the TCP, m, base frame.
        workspace_upper: upper corner.
        yaw_centre_rad: middle of the yaw range.
        yaw_half_range_rad: half of the yaw range; π allows every yaw.
        tilt_rad: largest measured tilt, rad. A command has no tilt to bound, so the caller must stop beyond this.
    """

    period_s: float
    step_m: float
    step_rad: float
    speed_mps: float
    speed_radps: float
    leash_m: float
    leash_rad: float
    workspace_lower: Corner
    workspace_upper: Corner
    yaw_centre_rad: float
    yaw_half_range_rad: float
    tilt_rad: float

    def __post_init__(self) -> None:
        """Refuse limits that bound nothing.

        Raises:
            ValueError: a field is out of range; the text names it.
        """
        for field in fields(self):
            value = getattr(self, field.name)
            if not np.isfinite(value).all():
                raise ValueError(f"bounds.{field.name} must be finite, not {value!r}")
            if not field.name.startswith(("workspace", "yaw_centre")) and not value > 0:
                raise ValueError(f"bounds.{field.name} must be above zero, not {value!r}")
        if not all(low < high for low, high in zip(self.workspace_lower, self.workspace_upper, strict=True)):
            raise ValueError("bounds.workspace_lower must lie below bounds.workspace_upper on every axis")


@dataclass(frozen=True, slots=True)
class BoundedCommand:
    """A command that may be sent, and the bounds that changed it; batch shape (...) in front.

    Attributes:
        position: (..., 3) m, base frame.
        yaw: (...) rad, within π of the range's middle.
        invalid: (...) True where the command or the measurement was not a usable number; the previous command replaces
            it. Latch POLICY_INVALID.
        leash, step, speed: (...) True where this bound changed the command, in position or yaw.
        workspace, yaw_range: (...) True where this bound changed the command.
        tilt: (...) True where the measured tilt is beyond its limit or not a number. Latch BOUNDS.
        excess: (...) requested change over allowed change of the target, the larger of position and yaw. Above 1 the
            change was cut; a run counts consecutive large values.
    """

    position: FloatArray
    yaw: FloatArray
    invalid: BoolArray
    leash: BoolArray
    step: BoolArray
    speed: BoolArray
    workspace: BoolArray
    yaw_range: BoolArray
    tilt: BoolArray
    excess: FloatArray

    @property
    def clamped(self) -> BoolArray:
        """(...) True where any bound changed the command."""
        return self.invalid | self.leash | self.step | self.speed | self.workspace | self.yaw_range


def apply(
    parameters: BoundsParameters,
    measured_position: npt.ArrayLike,
    measured_yaw: npt.ArrayLike,
    command_position: npt.ArrayLike,
    command_yaw: npt.ArrayLike,
    previous_position: npt.ArrayLike,
    previous_yaw: npt.ArrayLike,
    measured_tilt: npt.ArrayLike = 0.0,
) -> BoundedCommand:
    """Bound a command.

    Args:
        parameters: limits, the same for the whole batch.
        measured_position: (..., 3) m, TCP, base frame.
        measured_yaw: (...) rad.
        command_position: (..., 3) m, requested.
        command_yaw: (...) rad, requested.
        previous_position: (..., 3) m, the command in force; before the first, the measured pose. Must be finite.
        previous_yaw: (...) rad, of the same command. Must be finite.
        measured_tilt: (...) rad, magnitude.

    Returns:
        A finite command, for any input whose previous command is finite.
    """
    measured, asked, previous = (
        np.asarray(x, np.float64) for x in (measured_position, command_position, previous_position)
    )
    yaw_measured, yaw_asked, yaw_previous = (
        np.asarray(x, np.float64) for x in (measured_yaw, command_yaw, previous_yaw)
    )
    usable = _usable(measured).all(-1) & _usable(asked).all(-1) & _usable(yaw_measured) & _usable(yaw_asked)
    measured, asked = np.where(usable[..., None], measured, previous), np.where(usable[..., None], asked, previous)
    yaw_measured, yaw_asked = np.where(usable, yaw_measured, yaw_previous), np.where(usable, yaw_asked, yaw_previous)

    # Yaw is an offset from the middle of its range here, so that the range has no seam at ±π
    turn_measured = wrap(yaw_measured - parameters.yaw_centre_rad)
    turn_asked = turn_measured + wrap(yaw_asked - yaw_measured)
    turn_previous = turn_measured + wrap(yaw_previous - yaw_measured)

    step_m = min(parameters.step_m, parameters.speed_mps * parameters.period_s)
    step_rad = min(parameters.step_rad, parameters.speed_radps * parameters.period_s)
    asked_m = _length(asked - previous)
    asked_rad = np.abs(turn_asked - turn_previous)

    position, leashed = _within(measured, asked, parameters.leash_m)
    turn = np.clip(turn_asked, turn_measured - parameters.leash_rad, turn_measured + parameters.leash_rad)
    leash = leashed | (turn != turn_asked)
    to_go_m, to_go_rad = _length(position - previous), np.abs(turn - turn_previous)
    step = (to_go_m > parameters.step_m) | (to_go_rad > parameters.step_rad)
    speed = (to_go_m > parameters.speed_mps * parameters.period_s) | (
        to_go_rad > parameters.speed_radps * parameters.period_s
    )
    position, _ = _within(previous, position, step_m)
    turn = np.clip(turn, turn_previous - step_rad, turn_previous + step_rad)

    boxed = np.clip(position, np.array(parameters.workspace_lower), np.array(parameters.workspace_upper))
    half_range = parameters.yaw_half_range_rad
    turn_in_range = turn if half_range >= pi else np.clip(turn, -half_range, half_range)
    return BoundedCommand(
        position=boxed,
        yaw=parameters.yaw_centre_rad + wrap(turn_in_range),
        invalid=~usable,
        leash=leash,
        step=step,
        speed=speed,
        workspace=(boxed != position).any(-1),
        yaw_range=turn_in_range != turn,
        tilt=~(np.abs(np.asarray(measured_tilt, np.float64)) <= parameters.tilt_rad) & np.ones_like(usable),
        excess=np.maximum(asked_m / step_m, asked_rad / step_rad),
    )


def _length(vector: FloatArray) -> FloatArray:
    return np.sqrt((vector * vector).sum(-1))


def _usable(value: FloatArray) -> BoolArray:
    """Return where a value is finite and small enough to be squared; False for NaN."""
    return np.abs(value) <= 1e6


def _within(centre: FloatArray, point: FloatArray, radius: float) -> tuple[FloatArray, BoolArray]:
    """Pull `point` (..., 3) straight towards `centre` until within `radius`; also return where (...) it was outside."""
    offset = point - centre
    distance = _length(offset)
    outside = distance > radius
    factor = np.where(outside, radius / np.maximum(distance, radius), 1.0)
    return np.where(outside[..., None], centre + offset * factor[..., None], point), outside
