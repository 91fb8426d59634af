"""Each axis, each boundary and each sign of the safety core counts: these kill what mutation testing left alive."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest

from service.faults import FaultCode
from service.safety.ceiling import PLAUSIBLE
from service.safety.monitor import Monitor
from service.safety.pose import rotate, wrap, yaw_and_tilt
from service.safety.stop import StopConfirmation, StopParameters, StopState
from tests.service.safety.test_bounds import HERE, bounded
from tests.service.safety.test_bounds import LIMITS as BOUNDS
from tests.service.safety.test_monitor import LIMITS, Source
from tests.service.safety.test_stop import LIMITS as STOP

AXES = range(6)


def one(axis: int, value: float) -> np.ndarray:
    return np.where(np.arange(6) == axis, value, 0.0)


@pytest.mark.parametrize("axis", AXES)
def test_motion_along_any_axis_is_motion(axis: int) -> None:
    stop = StopConfirmation(STOP, 0.0)
    for tick in range(40):
        assert stop.observe(one(axis, 0.05), tick * 2e-3) is StopState.WAITING


def test_a_speed_at_the_limit_is_motion() -> None:
    for velocity in (one(0, STOP.linear_mps), one(3, STOP.angular_radps)):
        stop = StopConfirmation(STOP, 0.0)
        assert {stop.observe(velocity, tick * 2e-3) for tick in range(40)} == {StopState.WAITING}


def test_standing_for_the_settling_time_confirms_and_so_does_the_last_moment() -> None:
    limits = StopParameters(deadline_s=0.5, settle_s=0.25)
    stop = StopConfirmation(limits, 0.0)
    assert stop.observe(one(0, 0.0), 0.25) is StopState.WAITING
    assert stop.observe(one(0, 0.0), 0.5) is StopState.CONFIRMED, "0.25 s of rest, at the deadline"


def test_a_settling_time_as_long_as_the_deadline_confirms_nothing() -> None:
    with pytest.raises(ValueError, match="settle_s"):
        StopParameters(deadline_s=0.5, settle_s=0.5)


@pytest.mark.parametrize("axis", AXES)
def test_an_implausible_number_of_any_channel_is_no_measurement(axis: int) -> None:
    assert Source().send(one(axis, 2 * PLAUSIBLE)).fault is FaultCode.SENSOR_INVALID
    assert Source().send(one(axis, -2 * PLAUSIBLE)).fault is FaultCode.SENSOR_INVALID
    assert Source().send(one(axis, PLAUSIBLE)).fault is FaultCode.FORCE_CEILING, "large, and plausible"


@pytest.mark.parametrize("axis", range(3, 6))
def test_torque_about_any_axis_meets_its_ceiling(axis: int) -> None:
    assert Source().send(one(axis, LIMITS.torque_ceiling_nm)).fault is FaultCode.FORCE_CEILING


def test_a_motion_at_the_edge_of_the_plausible_is_believed() -> None:
    assert Source().send(motion=np.full(3, PLAUSIBLE)).fault is None
    assert Source().send(motion=np.full(3, 2 * PLAUSIBLE)).fault is FaultCode.SENSOR_INVALID


def test_the_first_sample_may_have_the_number_zero() -> None:
    source = Source()
    source.seq = -1
    assert source.send().accepted
    assert source.monitor.force_n > 0.0


def test_a_source_of_another_episode_is_told_by_its_number() -> None:
    source = Source()
    assert source.send(episode=1).accepted
    assert "episode 2, was 1" in source.send(episode=2).text


def test_a_new_monitor_counts_repeats_and_standing_stamps_from_the_start() -> None:
    quiet = np.array([0.1, -0.1, 0.2, 0.0, 0.0, 0.0])
    source = Source()
    faults = [source.send(quiet).fault for _ in range(LIMITS.stuck_samples)]
    assert faults == [None] * (LIMITS.stuck_samples - 1) + [FaultCode.SENSOR_STUCK]
    source.monitor.reset()
    assert source.send(quiet).fault is None


def test_a_peak_needs_a_finite_sample() -> None:
    monitor = Monitor(LIMITS)
    assert monitor.peak_force_n == monitor.force_n == 0.0


@pytest.mark.parametrize("yaw", [0.3, -2.0, pi / 2])
def test_a_vector_is_turned_as_the_rotation_matrix_turns_it(yaw: float) -> None:
    vector = np.array([0.7, -0.4, 0.2])
    matrix = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    np.testing.assert_allclose(rotate(yaw, vector), matrix @ vector)
    np.testing.assert_allclose(rotate(yaw, np.array([0, 1])), [-np.sin(yaw), np.cos(yaw)])


def test_integers_are_angles_and_vectors_too() -> None:
    assert wrap(np.array([4])).dtype == np.float64
    assert rotate(1, np.array([1, 0])).dtype == np.float64
    yaw, tilt = yaw_and_tilt(np.array([3, 0, 0]))
    assert yaw.dtype == tilt.dtype == np.float64


@pytest.mark.parametrize("angle", [-3.0, 0.0, 3.0, pi + 0.1, -pi - 0.1])
def test_an_angle_is_wrapped_into_half_a_turn_either_way(angle: float) -> None:
    wrapped = float(wrap(angle))
    assert -pi <= wrapped < pi
    assert np.isclose(np.exp(1j * wrapped), np.exp(1j * angle))


def test_bounds_of_yaw_lie_about_their_centre() -> None:
    limits = replace(BOUNDS, yaw_centre_rad=0.5)
    out = bounded(HERE, 0.6, limits, measured_yaw=0.55, previous_yaw=0.55)
    assert out.yaw == pytest.approx(0.6)
    assert not out.clamped


def test_the_excess_of_a_turn_is_its_share_of_the_allowed_one() -> None:
    out = bounded(HERE, 0.30, previous_yaw=0.10, measured_yaw=0.10)
    assert out.excess == pytest.approx(0.20 / min(BOUNDS.step_rad, BOUNDS.speed_radps * BOUNDS.period_s))


def test_a_workspace_has_a_lower_corner() -> None:
    low = np.array([0.2, -0.1, 0.0])
    out = bounded(low - 1e-3, measured_position=low, previous_position=low)
    np.testing.assert_allclose(out.position, low)


def test_a_step_and_a_turn_of_just_the_limit_are_not_cut() -> None:
    out = bounded(np.array([0.3, 0.0, 0.1 + BOUNDS.step_m]), previous_position=np.array([0.3, 0.0, 0.1]))
    assert not (out.step and out.excess < 1.0)
