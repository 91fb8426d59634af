from dataclasses import fields, replace
from math import pi

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from service.safety.bounds import BoundedCommand, BoundsParameters, apply

LIMITS = BoundsParameters(
    period_s=0.08,
    step_m=4e-3,
    step_rad=0.15,
    speed_mps=0.1,
    speed_radps=3.0,
    leash_m=8e-3,
    leash_rad=0.3,
    workspace_lower=(0.2, -0.1, 0.0),
    workspace_upper=(0.4, 0.1, 0.3),
    yaw_centre_rad=0.0,
    yaw_half_range_rad=1.2,
    tilt_rad=0.05,
)
HERE = np.array([0.3, 0.0, 0.1])


def bounded(position: object, yaw: float = 0.0, limits: BoundsParameters = LIMITS, **changes: object) -> BoundedCommand:
    arguments = {
        "measured_position": HERE,
        "measured_yaw": 0.0,
        "command_position": position,
        "command_yaw": yaw,
        "previous_position": HERE,
        "previous_yaw": 0.0,
    }
    return apply(limits, **arguments | changes)  # pyright: ignore


def test_a_command_within_all_bounds_passes_unchanged() -> None:
    out = bounded(HERE + np.array([1e-3, -1e-3, 1e-3]), 0.1)
    np.testing.assert_array_equal(out.position, HERE + np.array([1e-3, -1e-3, 1e-3]))
    assert out.yaw == pytest.approx(0.1, abs=1e-15)
    assert not out.clamped
    assert not out.tilt
    assert 0 < out.excess < 1


def test_a_step_too_long_is_cut_along_its_direction() -> None:
    out = bounded(HERE + np.array([6e-3, 0, 0]))
    np.testing.assert_allclose(out.position, HERE + np.array([4e-3, 0, 0]))
    assert out.step
    assert out.excess == pytest.approx(1.5)


def test_an_action_a_hundred_times_too_large_is_cut_and_shows_how_large_it_was() -> None:
    out = bounded(HERE + np.array([0, 0, -0.4]))
    np.testing.assert_allclose(out.position, HERE - [0, 0, 4e-3])
    assert out.excess == pytest.approx(100.0)
    assert out.step
    assert out.leash


def test_speed_bounds_the_step_where_it_is_the_tighter() -> None:
    out = bounded(HERE + np.array([3e-3, 0, 0]), limits=replace(LIMITS, speed_mps=0.0125))
    np.testing.assert_allclose(out.position, HERE + np.array([1e-3, 0, 0]))
    assert out.speed
    assert not out.step


def test_yaw_is_cut_by_step_and_rate() -> None:
    assert bounded(HERE, 0.2).yaw == pytest.approx(0.15)
    out = bounded(HERE, -0.2, replace(LIMITS, speed_radps=1.0))
    assert out.yaw == pytest.approx(-0.08)
    assert out.speed
    assert out.step


def test_the_target_stays_on_a_leash_to_the_measured_pose() -> None:
    """Winding up against an obstacle ends at the leash."""
    target = HERE
    for _ in range(10):
        out = bounded(target + np.array([0, 0, -3e-3]), previous_position=target)
        target = out.position
    np.testing.assert_allclose(target, HERE - [0, 0, 8e-3])
    assert out.leash


def test_yaw_has_a_leash() -> None:
    out = bounded(HERE, 0.5, previous_yaw=0.3)
    assert out.yaw == pytest.approx(0.3)
    assert out.leash


def test_a_target_left_behind_comes_back_at_full_step_and_no_faster() -> None:
    out = bounded(HERE, previous_position=HERE + np.array([0.02, 0, 0]))
    np.testing.assert_allclose(out.position, HERE + np.array([0.016, 0, 0]))
    assert out.step


def test_the_workspace_is_a_box() -> None:
    edge = np.array([0.4, 0.0, 0.1])
    out = bounded(edge + np.array([1e-3, 1e-3, 0]), measured_position=edge, previous_position=edge)
    np.testing.assert_allclose(out.position, edge + np.array([0, 1e-3, 0]))
    assert out.workspace


def test_yaw_stays_in_its_range_across_the_seam_at_pi() -> None:
    limits = replace(LIMITS, yaw_centre_rad=pi, yaw_half_range_rad=0.5)
    out = bounded(HERE, -pi + 0.1, limits, measured_yaw=pi - 0.02, previous_yaw=pi - 0.02)
    assert np.remainder(out.yaw, 2 * pi) == pytest.approx(pi + 0.1)
    assert not out.clamped
    out = bounded(HERE, -pi + 0.6, limits, measured_yaw=-pi + 0.48, previous_yaw=-pi + 0.48)
    assert np.remainder(out.yaw, 2 * pi) == pytest.approx(pi + 0.5)
    assert out.yaw_range


def test_the_yaw_range_lies_about_its_middle() -> None:
    limits = replace(LIMITS, yaw_centre_rad=0.4, yaw_half_range_rad=0.5)
    out = bounded(HERE, 1.0, limits, measured_yaw=0.85, previous_yaw=0.85)
    assert out.yaw == pytest.approx(0.9)
    assert out.yaw_range
    assert not bounded(HERE, -0.05, limits).yaw_range


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_yaw_range_ends_on_both_sides(side: float) -> None:
    at_end = {"measured_yaw": side * 1.15, "previous_yaw": side * 1.15}
    out = bounded(HERE, side * 1.25, **at_end)
    assert out.yaw == pytest.approx(side * 1.2)
    assert out.yaw_range


def test_one_element_of_a_batch_that_cannot_be_used_leaves_the_others() -> None:
    measured = np.array([HERE, [np.nan, 0.0, 0.1]])
    out = bounded(np.array([HERE, HERE]) + 1e-3, np.zeros(2), measured_position=measured)  # pyright: ignore
    assert out.invalid.tolist() == [False, True]


def test_a_full_yaw_range_has_no_seam() -> None:
    limits = replace(LIMITS, yaw_half_range_rad=pi)
    out = bounded(HERE, pi + 0.1, limits, measured_yaw=pi - 0.02, previous_yaw=pi - 0.02)
    assert np.remainder(out.yaw, 2 * pi) == pytest.approx(pi + 0.1)
    assert not out.clamped


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
@pytest.mark.parametrize("field", ["command_position", "command_yaw", "measured_position", "measured_yaw"])
def test_a_number_that_cannot_be_used_never_passes(field: str, bad: float) -> None:
    value = np.array([bad, 0.0, 0.1]) if field.endswith("position") else bad
    out = bounded(HERE + 1e-3, 0.1, **{field: value})
    assert out.invalid
    assert out.clamped
    np.testing.assert_array_equal(out.position, HERE)
    assert out.yaw == 0.0


@pytest.mark.parametrize(("tilt", "flag"), [(0.05, False), (0.051, True), (float("nan"), True)])
def test_tilt_is_reported(tilt: float, flag: bool) -> None:
    out = bounded(HERE, measured_tilt=tilt)
    assert out.tilt == flag
    assert not out.clamped


vector = st.lists(st.floats(-0.05, 0.05), min_size=3, max_size=3)
turn = st.floats(-4, 4)


@settings(max_examples=200, deadline=None)
@given(vector, vector, vector, turn, turn, turn)
def test_every_result_is_within_every_bound(
    asked: list[float], behind: list[float], leashed: list[float], yaw: float, yaw_measured: float, yaw_change: float
) -> None:
    lower, upper = np.array(LIMITS.workspace_lower), np.array(LIMITS.workspace_upper)
    measured = np.clip(HERE + behind, lower, upper)
    tether = np.array(leashed)
    previous = np.clip(measured + tether * min(1.0, 8e-3 / max(float(np.linalg.norm(tether)), 1e-9)), lower, upper)
    yaw_measured = float(np.clip(yaw_measured, -1.2, 1.2))
    yaw_previous = float(np.clip(yaw_measured + np.clip(yaw_change, -0.3, 0.3), -1.2, 1.2))
    out = apply(LIMITS, measured, yaw_measured, HERE + asked, yaw, previous, yaw_previous)
    assert np.linalg.norm(out.position - previous) <= 4e-3 + 1e-12
    assert np.linalg.norm(out.position - measured) <= 8e-3 + 1e-12
    assert (out.position >= lower).all()
    assert (out.position <= upper).all()
    assert abs(out.yaw) <= 1.2 + 1e-12
    assert abs(out.yaw - yaw_previous) <= 0.15 + 1e-12
    assert abs(out.yaw - yaw_measured) <= 0.3 + 1e-12


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(vector, turn), min_size=2, max_size=4))
def test_a_batch_is_bounded_as_its_elements_are(commands: list[tuple[list[float], float]]) -> None:
    asked, yaw = HERE + np.array([c[0] for c in commands]), np.array([c[1] for c in commands])
    asked[0, 0] = np.nan
    here, zero = np.tile(HERE, (len(yaw), 1)), np.zeros(len(yaw))
    batch = apply(LIMITS, here, zero, asked, yaw, here, zero, zero)
    for index in range(len(yaw)):
        alone = bounded(asked[index], yaw[index])
        for field in fields(BoundedCommand):
            np.testing.assert_array_equal(getattr(batch, field.name)[index], getattr(alone, field.name))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("step_m", 0.0),
        ("speed_radps", -1.0),
        ("leash_m", float("nan")),
        ("yaw_half_range_rad", 0.0),
        ("workspace_lower", (0.5, 0.0, 0.0)),
        ("workspace_lower", (0.4, -0.1, 0.0)),
        ("workspace_upper", (float("inf"), 1.0, 1.0)),
        ("yaw_centre_rad", float("inf")),
    ],
)
def test_bounds_that_bound_nothing_are_refused_by_name(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=field):
        replace(LIMITS, **{field: value})  # pyright: ignore
