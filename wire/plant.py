"""Errors of a plant: how a cell differs from the one that its controller and its policy believe in, as data."""

import math
from dataclasses import dataclass, field, fields
from typing import Any, Self, cast


def _value(nominal: float, low: float, high: float) -> Any:
    """Declare a field by its nominal value and its bounds."""
    return field(default=nominal, metadata={"low": low, "high": high})


def _count(high: int) -> Any:
    """Declare a whole number, from 0 to `high`."""
    return field(default=0, metadata={"low": 0, "high": high})


@dataclass(frozen=True, slots=True)
class PlantErrors:
    """Errors of one plant; the defaults are the plant without any.

    A field is a size. The signs and directions are drawn, uniformly, from a random stream of their own: the other draws
    of a seed, hole, grasp and noise among them, do not depend on a plant's errors. They come on top of what a task's
    conditions and `randomise_plant` set. Frames: `docs/reference/frames.md`. Delays are in ticks of 2 ms.

    Attributes:
        plants: number of plants among which the seeds are shared out, each with signs and directions of its own;
            0: every seed has its own.
        friction_added: added to the sliding friction of peg on block.
        contact_time_scale: factor on the time constant of contact; at 0.5 walls are four times as stiff.
        hole_tilt_deg: tilt of the hole's axis from the vertical, about a horizontal axis through its mouth's centre.
        tcp_shift_m: distance of the peg from where the calibrated TCP has it, across the tool.
        tcp_height_m: the same along the tool.
        tcp_tilt_deg: angle between the peg's axis and the calibrated tool's, about an axis across the tool.
        ft_turn_deg: turn of the force/torque sensor's axes, about any axis.
        ft_gain_error: share by which the sensor reads every load too high or too low.
        ft_left_n: force that a zeroed sensor still shows, in any direction of its axes.
        ft_left_nm: torque about its origin that a zeroed sensor still shows, in any direction.
        ft_noise_scale: factor on the sensor's noise.
        ft_drift_scale: factor on the sensor's drift.
        ft_delay_ticks: added to the delay from force to sample.
        target_delay_ticks: added to the delay from a target's arrival to its effect.
        target_jitter_ticks: largest further delay of a target, drawn for each target, from 0.
        camera_error_scale: factor on the episode's error of the camera's estimate.
        camera_bias_m: further error of the estimate, horizontal.
        camera_height_m: further error of the estimate's height.
        finger_stiffness_scale: factor on the stiffness of the fingers.
        payload_mass_scale: factor on the mass of gripper and peg, which the controller does not know.
        payload_shift_m: distance of the payload's centre from where the controller has it, across the tool.
        joint_stiffness_scale: factor on the stiffness of the joints' position loops; their damping ratio stays.
        joint_friction_share: Coulomb friction of every joint, as a share of its rated torque.
        joint_backlash_deg: play of every joint's gear.
        joint_ripple_deg: amplitude of the uneven motion of every joint's gear.
        peg_chamfer_m: chamfer of 45° around the peg's bottom.
        peg_rounding_m: radius of the peg's upright edges.
        peg_oversize_m: distance by which every face of the peg is too far out.
        peg_taper_deg: angle by which the faces of the peg lean outwards from its bottom up.
    """

    plants: int = _count(1000)
    friction_added: float = _value(0.0, 0.0, 1.0)
    contact_time_scale: float = _value(1.0, 0.33, 2.0)
    hole_tilt_deg: float = _value(0.0, 0.0, 5.0)
    tcp_shift_m: float = _value(0.0, 0.0, 5e-3)
    tcp_height_m: float = _value(0.0, 0.0, 5e-3)
    tcp_tilt_deg: float = _value(0.0, 0.0, 3.0)
    ft_turn_deg: float = _value(0.0, 0.0, 20.0)
    ft_gain_error: float = _value(0.0, 0.0, 0.5)
    ft_left_n: float = _value(0.0, 0.0, 5.0)
    ft_left_nm: float = _value(0.0, 0.0, 1.0)
    ft_noise_scale: float = _value(1.0, 0.0, 5.0)
    ft_drift_scale: float = _value(1.0, 0.0, 20.0)
    ft_delay_ticks: int = _count(20)
    target_delay_ticks: int = _count(25)
    target_jitter_ticks: int = _count(25)
    camera_error_scale: float = _value(1.0, 0.0, 5.0)
    camera_bias_m: float = _value(0.0, 0.0, 10e-3)
    camera_height_m: float = _value(0.0, 0.0, 5e-3)
    finger_stiffness_scale: float = _value(1.0, 0.1, 10.0)
    payload_mass_scale: float = _value(1.0, 0.5, 1.5)
    payload_shift_m: float = _value(0.0, 0.0, 50e-3)
    joint_stiffness_scale: float = _value(1.0, 0.1, 3.0)
    joint_friction_share: float = _value(0.0, 0.0, 0.3)
    joint_backlash_deg: float = _value(0.0, 0.0, 0.5)
    joint_ripple_deg: float = _value(0.0, 0.0, 0.1)
    peg_chamfer_m: float = _value(0.0, 0.0, 2e-3)
    peg_rounding_m: float = _value(0.0, 0.0, 2e-3)
    peg_oversize_m: float = _value(0.0, 0.0, 0.5e-3)
    peg_taper_deg: float = _value(0.0, 0.0, 2.0)

    def to_json(self) -> dict[str, Any]:
        """Return the fields that differ from their defaults."""
        return {each.name: value for each in fields(self) if (value := getattr(self, each.name)) != each.default}

    @classmethod
    def from_json(cls, document: Any) -> Self:
        """Build from JSON.

        Raises:
            ValueError: it is no object, or a field is unknown or out of range; the text names it.
        """
        if not isinstance(document, dict):
            raise ValueError(f"plant must be an object of errors, not {document!r}")
        known = [each.name for each in fields(cls)]
        given = cast(dict[str, Any], document)
        if others := sorted(set(given) - set(known)):
            raise ValueError(f"plant.{others[0]} is no error of a plant; there are {', '.join(known)}")
        errors = cls(**given)
        errors.check()
        return errors

    def check(self) -> None:
        """Raise ValueError, naming the field and its limits, for a value that no world can have."""
        for each in fields(self):
            low, high, value = each.metadata["low"], each.metadata["high"], getattr(self, each.name)
            whole = type(each.default) is int
            right = type(value) is int or (type(value) is float and not whole and math.isfinite(value))
            if not right or not low <= value <= high:
                kind = "an integer from" if whole else "a number from"
                raise ValueError(f"plant.{each.name} must be {kind} {low:g} to {high:g}, not {value!r}")
