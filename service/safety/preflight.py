"""Checks of the sensor and the pose before a run, while the arm stands still in free air."""

from dataclasses import dataclass, fields
from math import isfinite

import numpy as np

from service.faults import FaultCode
from service.safety.verdict import PASSED, Verdict
from wire.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class PreflightParameters:
    """Conditions for the start of a run; the configuration sets the values.

    Attributes:
        window_samples: smallest number of samples to judge from.
        contact_force_n: mean resultant force that means contact at the tool, N.
        bias_force_n: largest mean resultant force after zeroing, N; below `contact_force_n`.
        bias_torque_nm: largest mean resultant torque after zeroing, N·m.
        noise_force_n: largest standard deviation of a force component, N.
        noise_torque_nm: largest standard deviation of a torque component, N·m.
        position_m: largest distance from the start position, m.
        yaw_rad: largest angle from the start yaw, rad.
        tilt_rad: largest tilt, rad.
        unzeroed_force_n: mean resultant force before zeroing that means a loaded tool, N. It is above the largest force
            that the sensor's bias and the payload's error can cause.
        unzeroed_torque_nm: mean resultant torque at the TCP before zeroing that means a loaded tool, N·m.
    """

    window_samples: int
    contact_force_n: float
    bias_force_n: float
    bias_torque_nm: float
    noise_force_n: float
    noise_torque_nm: float
    position_m: float
    yaw_rad: float
    tilt_rad: float
    unzeroed_force_n: float
    unzeroed_torque_nm: float

    def __post_init__(self) -> None:
        """Refuse limits that check nothing.

        Raises:
            ValueError: a field is out of range; the text names it.
        """
        for field in fields(self):
            value = getattr(self, field.name)
            if not (isfinite(value) and value > 0):
                raise ValueError(f"preflight.{field.name} must be finite and above zero, not {value!r}")
        if self.window_samples < 2:
            raise ValueError("preflight.window_samples must be 2 or more: one sample has no noise")
        if self.bias_force_n >= self.contact_force_n:
            raise ValueError("preflight.bias_force_n must be below preflight.contact_force_n")


def check_unzeroed(parameters: PreflightParameters, window: FloatArray) -> Verdict:
    """Judge the load before zeroing: the zero would hide a force that already presses on the tool.

    Args:
        parameters: limits.
        window: (T, 6) N and N·m at the TCP, base frame, not zeroed for this run.

    Returns:
        CONTACT_AT_START, or passed.
    """
    mean = window.mean(0)
    for unit, value, limit in (
        ("N", float(np.linalg.norm(mean[:3])), parameters.unzeroed_force_n),
        ("N·m", float(np.linalg.norm(mean[3:])), parameters.unzeroed_torque_nm),
    ):
        if not value < limit:
            return Verdict(
                FaultCode.CONTACT_AT_START,
                value,
                limit,
                f"the sensor reads {value:.2f} {unit} before zeroing, limit for a free tool {limit:g} {unit}: "
                "free the tool; if nothing touches it, zero the sensor at the robot or check the payload",
            )
    return PASSED


def check_wrench(parameters: PreflightParameters, window: FloatArray) -> Verdict:
    """Judge the sensor from a window of samples in free air, after zeroing.

    Args:
        parameters: limits.
        window: (T, 6) N and N·m at the TCP, base frame, consecutive samples.

    Returns:
        The first of: too few samples (STALE), not finite (SENSOR_INVALID), no noise at all (SENSOR_STUCK),
        CONTACT_AT_START, BIAS (mean or noise out of bounds); or passed.
    """
    if len(window) < parameters.window_samples:
        return Verdict(
            FaultCode.STALE,
            len(window),
            parameters.window_samples,
            f"{len(window)} samples are too few to check the sensor, want {parameters.window_samples}",
        )
    if not np.isfinite(window).all():
        return Verdict(FaultCode.SENSOR_INVALID, text="the wrench is not finite in free air")
    if (window == window[0]).all():
        return Verdict(
            FaultCode.SENSOR_STUCK, len(window), 1.0, f"{len(window)} identical wrenches: the sensor is stuck"
        )
    mean, deviation = window.mean(0), window.std(0)
    force, torque = float(np.linalg.norm(mean[:3])), float(np.linalg.norm(mean[3:]))
    if force >= parameters.contact_force_n:
        return Verdict(
            FaultCode.CONTACT_AT_START,
            force,
            parameters.contact_force_n,
            f"mean force {force:.2f} N at the start pose, contact from {parameters.contact_force_n:g} N: "
            "free the tool, then zero the sensor",
        )
    noise_force, noise_torque = float(deviation[:3].max()), float(deviation[3:].max())
    for name, unit, value, limit in (
        ("mean force", "N", force, parameters.bias_force_n),
        ("mean torque", "N·m", torque, parameters.bias_torque_nm),
        ("force noise", "N", noise_force, parameters.noise_force_n),
        ("torque noise", "N·m", noise_torque, parameters.noise_torque_nm),
    ):
        if value > limit:
            return Verdict(
                FaultCode.BIAS,
                value,
                limit,
                f"{name} {value:.3f} {unit} in free air, limit {limit:g} {unit}: zero the sensor or check the payload",
            )
    return PASSED


def check_start_pose(
    parameters: PreflightParameters,
    position: FloatArray,
    yaw: float,
    tilt: FloatArray,
    start_position: FloatArray,
    start_yaw: float,
) -> Verdict:
    """Judge whether the arm stands at the start pose.

    Args:
        parameters: limits.
        position: (3,) m, measured TCP, base frame.
        yaw: rad, measured.
        tilt: (2,) rad, measured (`pose.yaw_and_tilt`).
        start_position: (3,) m, start position of the recipe.
        start_yaw: rad, start yaw of the recipe.

    Returns:
        BOUNDS with the deviation, SENSOR_INVALID for a pose that is not finite, or passed.
    """
    turn = abs(float(np.remainder(yaw - start_yaw + np.pi, 2 * np.pi)) - np.pi)
    for name, unit, value, limit in (
        ("position", "m", float(np.linalg.norm(position - start_position)), parameters.position_m),
        ("yaw", "rad", turn, parameters.yaw_rad),
        ("tilt", "rad", float(np.linalg.norm(tilt)), parameters.tilt_rad),
    ):
        if not isfinite(value):
            return Verdict(FaultCode.SENSOR_INVALID, value, limit, f"the measured {name} is not finite")
        if value > limit:
            return Verdict(
                FaultCode.BOUNDS,
                value,
                limit,
                f"{name} is {value:.4f} {unit} from the start pose, limit {limit:g} {unit}: move the arm there",
            )
    return PASSED
