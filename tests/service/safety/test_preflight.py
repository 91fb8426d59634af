from dataclasses import replace

import numpy as np
import pytest

from service.faults import FaultCode
from service.safety.preflight import PreflightParameters, check_start_pose, check_unzeroed, check_wrench

LIMITS = PreflightParameters(
    window_samples=50,
    contact_force_n=3.0,
    bias_force_n=1.5,
    bias_torque_nm=0.15,
    noise_force_n=1.5,
    noise_torque_nm=0.15,
    position_m=5e-3,
    yaw_rad=0.05,
    tilt_rad=0.02,
    unzeroed_force_n=12.0,
    unzeroed_torque_nm=2.5,
)
SIGMA = np.array([0.7, 0.7, 0.7, 0.05, 0.05, 0.05])


def free_air(samples: int = 100) -> np.ndarray:
    return np.random.default_rng(1).normal(size=(samples, 6)) * SIGMA


def test_a_sensor_with_the_standard_noise_in_free_air_passes() -> None:
    assert check_wrench(LIMITS, free_air()).fault is None


def test_too_few_samples_prove_nothing() -> None:
    assert check_wrench(LIMITS, free_air(49)).fault is FaultCode.STALE
    assert check_wrench(LIMITS, free_air(50)).fault is None


def test_a_sample_that_is_not_finite_is_invalid() -> None:
    window = free_air()
    window[50, 4] = np.nan
    assert check_wrench(LIMITS, window).fault is FaultCode.SENSOR_INVALID


def test_a_sensor_without_any_noise_is_stuck() -> None:
    assert check_wrench(LIMITS, np.full((100, 6), 0.1)).fault is FaultCode.SENSOR_STUCK


@pytest.mark.parametrize("axis", range(3))
def test_contact_at_the_start_is_told_apart_from_bias(axis: int) -> None:
    push = np.zeros(6)
    push[axis] = -4.0
    verdict = check_wrench(LIMITS, free_air() + push)
    assert verdict.fault is FaultCode.CONTACT_AT_START
    assert verdict.measured == pytest.approx(4.0, abs=0.3)
    push[axis] = 2.0
    verdict = check_wrench(LIMITS, free_air() + push)
    assert verdict.fault is FaultCode.BIAS
    assert "mean force" in verdict.text


def test_bias_of_torque_and_noise_of_either_are_refused_with_the_number() -> None:
    assert "mean torque" in check_wrench(LIMITS, free_air() + np.array([0, 0, 0, 0.2, 0, 0])).text
    assert "force noise" in check_wrench(LIMITS, free_air() * [4, 1, 1, 1, 1, 1]).text
    verdict = check_wrench(LIMITS, free_air() * [1, 1, 1, 1, 1, 5])
    assert "torque noise" in verdict.text
    assert verdict.fault is FaultCode.BIAS
    assert verdict.measured > verdict.limit


EXACT = replace(LIMITS, contact_force_n=4.0, bias_force_n=2.0, bias_torque_nm=0.25, noise_force_n=0.5)


def around(mean: list[float], deviation: list[float]) -> np.ndarray:
    """A window with exactly this mean and standard deviation."""
    sign = np.where(np.arange(64) % 2, 1.0, -1.0)[:, None]
    return np.array(mean) + sign * np.array(deviation)


def test_a_mean_or_noise_at_its_limit_passes_and_a_force_from_the_contacts_on_is_a_contact() -> None:
    at_limit = around([2.0, 0, 0, 0.25, 0, 0], [0.5, 0, 0, 0, 0, 0])
    assert check_wrench(EXACT, at_limit).fault is None
    at_contact = around([4.0, 0, 0, 0, 0, 0], [0.5, 0, 0, 0, 0, 0])
    assert check_wrench(EXACT, at_contact).fault is FaultCode.CONTACT_AT_START


def test_the_noise_of_a_torque_is_judged_as_that_of_a_torque() -> None:
    limits = replace(EXACT, noise_torque_nm=1.0)
    assert check_wrench(limits, around([0.0] * 6, [0.25, 0, 0, 0.75, 0, 0])).fault is None
    assert "torque noise" in check_wrench(limits, around([0.0] * 6, [0.25, 0, 0, 1.5, 0, 0])).text


def test_a_load_before_zeroing_is_judged_by_force_and_torque_apart_and_from_the_limit_on() -> None:
    assert check_unzeroed(LIMITS, np.tile([11.9, 0, 0, 2.4, 0, 0], (4, 1))).fault is None
    assert check_unzeroed(LIMITS, np.tile([12.0, 0, 0, 0, 0, 0], (4, 1))).fault is FaultCode.CONTACT_AT_START


def test_two_samples_have_a_noise() -> None:
    assert check_wrench(replace(LIMITS, window_samples=2), free_air(2) * 0.5).fault is None


POSE = (np.array([0.3, 0.0, 0.2]), 3.1, np.zeros(2))


def test_an_arm_at_the_start_pose_may_start() -> None:
    assert check_start_pose(LIMITS, *POSE, POSE[0] + 2e-3, -3.15).fault is None


def test_an_arm_at_the_limit_of_the_tilt_may_start() -> None:
    limits, at_limit = replace(LIMITS, tilt_rad=0.25), np.array([0.25, 0.0])
    assert check_start_pose(limits, POSE[0], 3.1, at_limit, POSE[0], 3.1).fault is None


@pytest.mark.parametrize(
    ("position", "yaw", "tilt", "name"),
    [
        ([0.306, 0, 0.2], 3.1, [0, 0], "position"),
        ([0.3, 0, 0.2], 3.0, [0, 0], "yaw"),
        ([0.3, 0, 0.2], 3.1, [0.02, 0.02], "tilt"),
    ],
)
def test_an_arm_elsewhere_may_not_start(position: list[float], yaw: float, tilt: list[float], name: str) -> None:
    verdict = check_start_pose(LIMITS, np.array(position), yaw, np.array(tilt), POSE[0], 3.1)
    assert verdict.fault is FaultCode.BOUNDS
    assert verdict.text.startswith(name)


def test_a_pose_that_is_not_finite_may_not_start() -> None:
    nowhere = np.array([np.nan, 0, 0])
    assert check_start_pose(LIMITS, nowhere, 0.0, np.zeros(2), POSE[0], 0.0).fault is FaultCode.SENSOR_INVALID


@pytest.mark.parametrize(
    ("field", "value"),
    [("noise_force_n", 0.0), ("yaw_rad", float("inf")), ("window_samples", 1), ("bias_force_n", 3.0)],
)
def test_limits_that_check_nothing_are_refused_by_name(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=field):
        replace(LIMITS, **{field: value})


def test_a_biased_sensor_on_a_free_tool_may_be_zeroed() -> None:
    assert check_unzeroed(LIMITS, free_air() + np.array([4.0, -4.0, 4.0, 0.5, 0.5, 0.2])).fault is None


@pytest.mark.parametrize(("channel", "load"), [(0, 20.0), (2, -22.0), (3, 3.0), (4, 3.0)])
def test_a_tool_that_is_loaded_before_zeroing_is_not_zeroed_into_free_air(channel: int, load: float) -> None:
    window = free_air()
    window[:, channel] += load
    verdict = check_unzeroed(LIMITS, window)
    assert verdict.fault is FaultCode.CONTACT_AT_START
    assert verdict.measured == pytest.approx(abs(load), rel=0.1)
    assert ("N·m" if channel > 2 else "N before") in verdict.text


def test_a_load_that_is_no_number_is_not_zeroed() -> None:
    window = free_air()
    window[3, 1] = np.nan
    assert check_unzeroed(LIMITS, window).fault is FaultCode.CONTACT_AT_START
