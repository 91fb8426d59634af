from dataclasses import replace

import numpy as np
import pytest

from service.safety.stop import StopConfirmation, StopParameters, StopState

LIMITS = StopParameters(linear_mps=2e-3, angular_radps=0.02, settle_s=0.02, deadline_s=0.5)
STILL = np.array([1e-3, 0, 0, 0.01, 0, 0])
MOVING = np.array([0, 0, 0.05, 0, 0, 0])


def watch(velocities: list[tuple[float, np.ndarray]]) -> StopState:
    commanded = 50.0
    stop = StopConfirmation(LIMITS, commanded)
    state = StopState.WAITING
    for after, velocity in velocities:
        state = stop.observe(velocity, commanded + after)
    return state


def test_an_arm_that_stands_for_the_settling_time_is_confirmed() -> None:
    assert watch([(0.002, MOVING), (0.1, STILL), (0.119, STILL)]) is StopState.WAITING
    assert watch([(0.002, MOVING), (0.1, STILL), (0.121, STILL)]) is StopState.CONFIRMED


def test_a_break_in_standing_starts_the_settling_anew() -> None:
    assert watch([(0.1, STILL), (0.115, MOVING), (0.12, STILL), (0.139, STILL)]) is StopState.WAITING


def test_turning_is_moving() -> None:
    assert watch([(0.1, np.array([0, 0, 0, 0, 0, 0.1])), (0.2, np.array([0, 0, 0, 0, 0, 0.1]))]) is StopState.WAITING


def test_an_arm_that_keeps_moving_is_unconfirmed_at_the_deadline() -> None:
    assert watch([(0.498, MOVING)]) is StopState.WAITING
    assert watch([(0.1, MOVING), (0.5, MOVING)]) is StopState.UNCONFIRMED


def test_an_arm_that_is_not_seen_is_unconfirmed_at_the_deadline() -> None:
    stop = StopConfirmation(LIMITS, 10.0)
    assert stop.check(10.499) is StopState.WAITING
    assert stop.check(10.5) is StopState.UNCONFIRMED


@pytest.mark.parametrize("channel", [0, 4])
def test_a_velocity_that_is_not_finite_does_not_confirm(channel: int) -> None:
    blind = np.zeros(6)
    blind[channel] = np.nan
    assert watch([(0.1, blind), (0.2, blind), (0.499, blind)]) is StopState.WAITING


def test_standing_too_late_does_not_confirm() -> None:
    assert watch([(0.49, STILL), (0.511, STILL)]) is StopState.UNCONFIRMED


def test_the_outcome_is_final() -> None:
    stop = StopConfirmation(LIMITS, 0.0)
    stop.observe(STILL, 0.1)
    assert stop.observe(STILL, 0.13) is StopState.CONFIRMED
    assert stop.observe(MOVING, 0.2) is StopState.CONFIRMED
    assert stop.check(9.0) is StopState.CONFIRMED


@pytest.mark.parametrize(
    ("field", "value"), [("linear_mps", 0.0), ("angular_radps", float("nan")), ("settle_s", 1.0), ("deadline_s", -1.0)]
)
def test_limits_that_confirm_nothing_are_refused_by_name(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=field):
        replace(LIMITS, **{field: value})
