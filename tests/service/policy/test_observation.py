from dataclasses import fields, replace
from math import pi
from typing import Any

import numpy as np
import pytest

from service.policy.contract import ObservationEntry
from service.policy.observation import CENTROID_LIMIT_M, ENTRIES, Measurement, ObservationBuilder, ObservationMode

QUARTER = pi / 2


def measurement(shape: tuple[int, ...] = (), seed: int = 0, **changes: Any) -> Measurement:
    rng = np.random.default_rng(seed)

    def draw(*size: int) -> np.ndarray:
        return rng.normal(size=(*shape, *size))

    values: dict[str, Any] = {
        "position": draw(3),
        "yaw": draw(),
        "tilt": draw(2),
        "wrench_window": rng.normal(size=(5, *shape, 6)),
        "hole_estimate": draw(3),
        "nominal_hole": draw(3),
        "target_position": draw(3),
        "target_yaw": draw(),
        "start_yaw": draw(),
        "z_lock": draw(),
        "contact_z": draw(),
        "phase": np.ones(shape, np.int32),
        "previous_action": draw(4),
        "last_joint": draw(),
    }
    return Measurement(**values | changes)


def builder(*names: str, mode: ObservationMode = "VFTM", history: int = 1, window: int = 5) -> ObservationBuilder:
    entries = [ObservationEntry.of(name, history=history) for name in names]
    return ObservationBuilder(
        entries, mode, max_steps=100, window_samples=window, force_clip_n=10.0, torque_clip_nm=2.0
    )


def observe(name: str, mode: ObservationMode = "VFTM", **changes: Any) -> np.ndarray:
    made = builder(name, mode=mode)
    observation = made.build(made.begin(), measurement(**changes))[1]
    assert observation.dtype == np.float32
    assert observation.shape == (ENTRIES[name].size,)
    return observation


def steady(wrench: list[float]) -> np.ndarray:
    return np.tile(np.array(wrench, float), (5, 1))


# Entries. With the tool turned by a quarter, tool x is base y.


def test_hole_offset_is_in_the_tools_axes() -> None:
    offset = observe("hole_offset_xy", yaw=QUARTER, position=np.array([1.0, 2, 3]), hole_estimate=np.array([1.5, 2, 0]))
    np.testing.assert_allclose(offset, [0, -0.5], atol=1e-7)


def test_hole_offset_uses_the_running_mean_of_the_estimates() -> None:
    made = builder("hole_offset_xy")
    state = made.begin()
    for x in (0.01, 0.02, 0.06):
        state, offset = made.build(
            state, measurement(yaw=0.0, position=np.zeros(3), hole_estimate=np.array([x, 0.0, 0.0]))
        )
    np.testing.assert_allclose(offset, [0.03, 0], atol=1e-8)


def test_a_frame_without_an_estimate_leaves_the_mean_and_none_at_all_is_nan() -> None:
    made = builder("hole_offset_xy")
    state = made.begin()
    blind = measurement(yaw=0.0, position=np.zeros(3), hole_estimate=np.full(3, np.nan))
    state, offset = made.build(state, blind)
    assert np.isnan(offset).all()
    state, _ = made.build(state, replace(blind, hole_estimate=np.array([0.02, 0, 0])))
    state, offset = made.build(state, blind)
    np.testing.assert_allclose(offset, [0.02, 0], atol=1e-8)


@pytest.mark.parametrize("name", ["hole_offset_xy", "height", "hole_position"])
def test_ftm_sees_the_nominal_centre_and_never_the_estimate(name: str) -> None:
    without = {"hole_estimate": np.full(3, np.nan), "contact_z": np.nan}
    as_estimate = measurement(contact_z=np.nan).nominal_hole
    np.testing.assert_array_equal(
        observe(name, mode="FTM", **without), observe(name, hole_estimate=as_estimate, contact_z=np.nan)
    )


def test_height_is_above_the_estimate_until_a_contact_is_known() -> None:
    position, hole = np.array([0, 0, 0.25]), np.array([0, 0, 0.2])
    seen = {"position": position, "hole_estimate": hole}
    np.testing.assert_allclose(observe("height", contact_z=np.nan, **seen), [0.05])
    np.testing.assert_allclose(observe("height", contact_z=0.24, **seen), [0.01], rtol=1e-5)
    np.testing.assert_allclose(observe("height", mode="VM", contact_z=0.24, **seen), [0.05])
    assert observe("contact_height_known", contact_z=np.nan) == 0
    assert observe("contact_height_known", contact_z=0.24) == 1


def test_yaw_counts_from_the_start_and_wraps() -> None:
    np.testing.assert_allclose(observe("yaw", yaw=-3.1, start_yaw=3.1), [2 * pi - 6.2], rtol=1e-5)


def test_tilt_and_wrench_turn_into_the_tools_axes() -> None:
    np.testing.assert_allclose(observe("tilt", yaw=QUARTER, tilt=np.array([0.0, 0.1])), [0.1, 0], atol=1e-8)
    window = steady([1, 2, 3, 4, 5, 6])
    np.testing.assert_allclose(observe("force_mean", yaw=QUARTER, wrench_window=window), [2, -1, 3], atol=1e-6)
    np.testing.assert_allclose(observe("torque_mean", yaw=QUARTER, wrench_window=window), [5, -4, 6], atol=1e-6)


def test_the_window_is_the_contracts() -> None:
    window = np.zeros((5, 6))
    window[-2:, 2] = [4.0, 8.0]
    made = builder("force_mean", "force_z_range", window=2)
    _, observation = made.build(made.begin(), measurement(yaw=0.0, wrench_window=window))
    np.testing.assert_allclose(observation, [0, 0, 6, 4, 8, 2])


def test_the_contact_centroid_is_where_the_force_acts() -> None:
    lever, force = np.array([0.004, -0.007, 0.0]), np.array([0.0, 0.0, 8.0])
    window = steady([*force, *np.cross(lever, force)])
    np.testing.assert_allclose(observe("contact_centroid", yaw=0.0, wrench_window=window), lever[:2], rtol=1e-5)
    np.testing.assert_allclose(
        observe("contact_centroid", yaw=QUARTER, wrench_window=window), [-0.007, -0.004], rtol=1e-5
    )


def test_the_contact_centroid_stays_bounded_without_contact() -> None:
    centroid = observe("contact_centroid", yaw=0.0, wrench_window=steady([0, 0, -3, 0.02, 5.0, 0]))
    np.testing.assert_allclose(centroid, [-CENTROID_LIMIT_M, 0.02], rtol=1e-5)


def test_lag_is_command_minus_measured_in_the_tools_axes() -> None:
    lag = observe(
        "lag", position=np.zeros(3), yaw=QUARTER, target_position=np.array([0.1, 0, 0.3]), target_yaw=QUARTER + 0.2
    )
    np.testing.assert_allclose(lag, [0, -0.1, 0.3, 0.2], atol=1e-7)


def test_the_lock_is_above_the_tcp_or_zero() -> None:
    np.testing.assert_allclose(observe("lock_height", position=np.array([0, 0, 0.2]), z_lock=0.203), [3e-3], rtol=1e-4)
    assert observe("lock_height", z_lock=np.nan) == 0


def test_time_runs_from_zero_by_steps_allowed() -> None:
    made = builder("time_fraction")
    state = made.begin()
    seen = []
    for _ in range(3):
        state, observation = made.build(state, measurement())
        seen.append(float(observation[0]))
    np.testing.assert_allclose(seen, [0, 0.01, 0.02], rtol=1e-6)


def test_what_is_passed_on_as_it_is() -> None:
    m = measurement()
    for name, value in {
        "previous_action": m.previous_action,
        "phase": [1.0],
        "eef_position": m.position,
        "last_joint_angle": [m.last_joint],
        "hole_position": m.hole_estimate,
    }.items():
        np.testing.assert_allclose(observe(name), value, rtol=1e-6)


def test_the_papers_wrench_is_normalised_by_the_locks_clip() -> None:
    seen = observe("wrench_normalised", wrench_window=steady([5, -20, 10, 1, -4, 2]))
    np.testing.assert_allclose(seen, [0.5, -1, 1, 0.5, -1, 1])


# History, batches


def test_history_is_oldest_first_within_each_entry() -> None:
    entries = [ObservationEntry.of("eef_position", history=2), ObservationEntry.of("phase", history=3)]
    made = ObservationBuilder(entries, "VFTM", 100, 5)
    assert made.size == 9
    state = made.begin()
    for step in range(4):
        state, observation = made.build(state, measurement(position=np.full(3, step), phase=np.int32(step)))
    np.testing.assert_array_equal(observation, [2, 2, 2, 3, 3, 3, 1, 2, 3])


def test_the_first_frame_of_an_element_stands_for_those_before_it() -> None:
    made = builder("phase", history=3)
    state = made.begin((2,))
    for phase in (1, 2):
        state, observation = made.build(state, measurement((2,), phase=np.full(2, phase)))
    np.testing.assert_array_equal(observation, [[1, 1, 2]] * 2)
    state = replace(state, steps=state.steps * np.array([0, 1], np.int32))
    _, observation = made.build(state, measurement((2,), phase=np.full(2, 3)))
    np.testing.assert_array_equal(observation, [[3, 3, 3], [1, 2, 3]])


def test_building_does_not_touch_the_state_that_it_was_given() -> None:
    made = builder(*ENTRIES, history=3)
    state, _ = made.build(made.begin((2,)), measurement((2,)))
    first = made.build(state, measurement((2,), seed=3))[1]
    np.testing.assert_array_equal(first, made.build(state, measurement((2,), seed=3))[1])


@pytest.mark.parametrize("mode", ["VFTM", "FTM"])
def test_a_batch_is_observed_as_its_elements_are(mode: ObservationMode) -> None:
    made = builder(*ENTRIES, mode=mode, history=3)
    batch, alone = made.begin((4,)), [made.begin() for _ in range(4)]
    for seed in range(5):
        m = measurement((4,), seed=seed, contact_z=np.array([0.1, np.nan, 0.2, np.nan]))
        batch, seen = made.build(batch, m)
        for index in range(4):
            parts = {
                field.name: getattr(m, field.name)[:, index]
                if field.name == "wrench_window"
                else getattr(m, field.name)[index]
                for field in fields(m)
            }
            alone[index], single = made.build(alone[index], Measurement(**parts))
            np.testing.assert_allclose(seen[index], single, rtol=1e-6, atol=1e-6)


def test_an_unknown_entry_is_refused_by_name() -> None:
    class Stranger:
        name, history = "colour", 1

    with pytest.raises(ValueError, match="colour"):
        ObservationBuilder([Stranger()], "VFTM", 100, 5)
