import numpy as np
import pytest

from sim_backend.ur_controller.motion.profile import Trapezoid


def _sampled(profile: Trapezoid):
    time = np.linspace(0.0, profile.duration_s, 4001)
    distance, speed = np.array([profile.at(t) for t in time]).T
    return time, distance, speed


@pytest.mark.parametrize("length", [0.001, 0.05, 2.0])
def test_it_travels_its_length_within_its_limits(length: int):
    profile = Trapezoid(length, 0.4, 1.5)
    time, distance, speed = _sampled(profile)
    assert distance[0] == 0.0
    assert distance[-1] == pytest.approx(length, abs=1e-12)
    assert speed.max() <= 0.4 + 1e-12
    assert np.abs(np.diff(speed) / np.diff(time)).max() <= 1.5 + 1e-6
    assert np.allclose(np.gradient(distance, time)[1:-1], speed[1:-1], atol=2e-3)


def test_a_long_path_is_cruised_at_the_speed_asked_for():
    assert _sampled(Trapezoid(2.0, 0.4, 1.5))[2].max() == pytest.approx(0.4)


def test_a_time_takes_precedence_over_speed_and_acceleration():
    profile = Trapezoid(2.0, 0.001, 0.001, duration_s=3.0)
    assert profile.duration_s == 3.0
    assert profile.at(3.0) == (2.0, 0.0)
    assert _sampled(profile)[1][-1] == pytest.approx(2.0)


def test_it_brakes_from_where_it_says():
    profile = Trapezoid(2.0, 0.4, 1.5)
    assert profile.braking_from == pytest.approx(2.0 - 0.4**2 / (2 * 1.5))


def test_no_path_is_over_at_once():
    assert Trapezoid(0.0, 0.4, 1.5, duration_s=3.0).duration_s == 0.0


@pytest.mark.parametrize("duration_s", [0.01, 2.6, 3.0, 6.0])
@pytest.mark.parametrize("top_speed", [1.0, 10.0])
def test_a_time_that_is_too_short_takes_as_long_as_it_must(duration_s: float, top_speed: float):
    fastest = (top_speed, 1.5)
    profile = Trapezoid(2.0, 0.001, 0.001, duration_s, fastest)
    shortest = Trapezoid(2.0, *fastest).duration_s
    assert profile.duration_s == pytest.approx(max(duration_s, shortest), rel=1e-9)
    time, distance, speed = _sampled(profile)
    assert distance[-1] == pytest.approx(2.0)
    assert speed.max() <= top_speed + 1e-12
    assert np.abs(np.diff(speed) / np.diff(time)).max() <= 1.5 + 1e-6
