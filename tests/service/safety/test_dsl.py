from dataclasses import fields

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from service.safety.dsl import DslOutput, DslParameters, DslState, Phase, step
from wire.modes import LockMode

START = np.array([0.3, 0.1, 0.25])
NO_ACTION = np.zeros(4)
MODES: tuple[LockMode, ...] = ("paper", "sliding", "off")


def wrench(fz: float = 0.0, fx: float = 0.0, tx: float = 0.0) -> np.ndarray:
    return np.array([fx, 0.0, fz, tx, 0.0, 0.0])


def in_contact(parameters: DslParameters, fz: float = 6.0) -> tuple[DslState, DslOutput]:
    """The first step, taken already touching."""
    return step(parameters, DslState.begin(), START, wrench(fz), NO_ACTION)


# Search


def test_without_contact_the_tip_creeps_down_and_x_and_y_are_held() -> None:
    action = np.array([1e-3, -1e-3, 0.2e-3, 0.1])
    state, out = step(DslParameters(seek_step_m=5e-4), DslState.begin(), START, wrench(4.99), action)
    np.testing.assert_allclose(out.position, START + np.array([0, 0, -5e-4 + 0.2e-3]))
    assert out.dyaw == 0.1
    assert state.phase == out.phase == Phase.SEEK
    assert np.isnan(out.z_lock)
    assert not out.contact
    assert not out.clamped


def test_contact_is_half_of_the_clip() -> None:
    assert not step(DslParameters(), DslState.begin(), START, wrench(4.999), NO_ACTION)[1].contact
    state, out = in_contact(DslParameters(), 5.0)
    assert out.contact
    assert state.phase == out.phase == Phase.LOCKED
    assert state.z_contact0 == START[2]


def test_after_a_contact_the_policy_moves_x_and_y_while_seeking() -> None:
    state, _ = in_contact(DslParameters())
    state, _ = step(DslParameters(), state, START, wrench(0.0), NO_ACTION)
    state, out = step(DslParameters(), state, START, wrench(0.0), np.array([1e-3, 2e-3, 0, 0]))
    assert out.phase == Phase.SEEK
    np.testing.assert_allclose(out.position, START + np.array([1e-3, 2e-3, -5e-4]))


def test_a_search_is_bounded_by_depth_and_holds_the_tip_there() -> None:
    parameters = DslParameters(search_depth_m=2e-3, seek_step_m=5e-4)
    state, position = DslState.begin(), START.copy()
    lowest = START[2] - 2e-3
    for _ in range(20):
        state, out = step(parameters, state, position, wrench(), np.array([0, 0, -3e-4, 0]))
        assert out.position[2] >= lowest - 1e-12
        position = out.position
    assert out.search_depth_exceeded
    assert not out.search_time_exceeded
    np.testing.assert_array_equal(out.position[2], position[2])


def test_a_search_may_reach_its_depth() -> None:
    parameters = DslParameters(search_depth_m=1 / 512, seek_step_m=1 / 512)
    assert not step(parameters, DslState.begin(), START, wrench(), NO_ACTION)[1].search_depth_exceeded


@pytest.mark.parametrize("mode", MODES)
def test_state_and_output_have_the_types_that_they_document(mode: LockMode) -> None:
    begun = DslState.begin((2,))
    state, out = step(DslParameters(mode=mode), begun, np.array([START, START]), np.zeros((2, 6)), np.zeros((2, 4)))
    for one in (begun, state):
        assert (one.phase.dtype, one.seek_steps.dtype) == (np.int32, np.int32)
        assert (one.z_lock.dtype, one.z_contact0.dtype) == (np.float64, np.float64)
    assert out.phase.dtype == np.int32


def test_a_search_is_bounded_by_time() -> None:
    parameters = DslParameters(search_steps=3)
    state = DslState.begin()
    exceeded: list[bool] = []
    for _ in range(5):
        state, out = step(parameters, state, START, wrench(), NO_ACTION)
        exceeded.append(bool(out.search_time_exceeded))
    assert exceeded == [False, False, False, True, True]
    assert out.position[2] == START[2]
    assert not out.search_depth_exceeded


def test_a_contact_ends_the_stretch_of_search_that_is_counted() -> None:
    parameters = DslParameters(search_steps=3)
    state = DslState.begin()
    for fz in (0, 0, 0, 6, 0, 0, 0, 0):
        state, out = step(parameters, state, START, wrench(fz), NO_ACTION)
        assert not out.search_time_exceeded
    assert state.seek_steps == 3


# The lock: equations 3 to 6


def test_equations_3_and_4_raise_the_lock_by_the_weighted_jump() -> None:
    parameters = DslParameters(beta1=(1e-3, 2e-3, 4e-3), lift_max_m=0.1)
    state, _ = in_contact(parameters, 6.0)
    jumped = np.array([2.0, -1.0, 7.0, 0.05, 0.3, 0.1])
    _, out = step(parameters, state, START, jumped, NO_ACTION)
    # normalised: forces over 10 N, torques over 1 N·m
    expected = 1e-3 * (0.2 + 0.05) + 2e-3 * (-0.1 + 0.3) + 4e-3 * (0.1 + 0.1)
    assert out.edge
    assert out.z_lock == pytest.approx(START[2] + expected)
    assert out.position[2] == pytest.approx(START[2] + expected)
    assert out.clamped


def test_a_negative_sum_does_not_lower_the_lock() -> None:
    parameters = DslParameters()
    state, _ = in_contact(parameters, 10.0)
    _, out = step(parameters, state, START, wrench(5.2, fx=-4.0), np.array([0, 0, -1e-3, 0]))
    assert out.edge
    assert out.z_lock == START[2]
    assert out.position[2] == START[2]


def test_the_threshold_is_on_the_magnitude_of_each_component() -> None:
    state, _ = in_contact(DslParameters(), 6.0)
    for channel, threshold in enumerate((1.5, 1.5, 4.5, 0.1, 0.1, 0.2)):
        for sign in (1, -1):
            below, above = wrench(6.0), wrench(6.0)
            below[channel] += sign * threshold * 0.99
            above[channel] += sign * threshold * 1.01
            # a loss of Fz that large also ends the contact, which is another matter
            assert not step(DslParameters(), state, START, below, NO_ACTION)[1].edge
            if not (channel == 2 and sign > 0):  # 6 N + 4.5 N clips at 10 N
                assert step(DslParameters(), state, START, above, NO_ACTION)[1].edge


def test_a_change_of_exactly_the_threshold_is_no_edge() -> None:
    parameters = DslParameters(delta_f=(0.125,) * 6)
    state, _ = in_contact(parameters, 6.25)
    assert not step(parameters, state, START, wrench(7.5), NO_ACTION)[1].edge
    assert step(parameters, state, START, wrench(7.75), NO_ACTION)[1].edge


def test_an_edge_of_one_element_of_a_batch_is_not_its_neighbours() -> None:
    positions, none = np.array([START, START]), np.zeros((2, 4))
    state, _ = step(DslParameters(), DslState.begin((2,)), positions, np.array([wrench(6.0)] * 2), none)
    out = step(DslParameters(), state, positions, np.array([wrench(6.0), wrench(6.0, fx=4.0)]), none)[1]
    assert out.edge.tolist() == [False, True]


def test_equations_5_and_6_hold_the_lock_where_no_edge_is_felt() -> None:
    state, _ = in_contact(DslParameters())
    moved = START + np.array([3e-3, 0, 4e-3])
    _, out = step(DslParameters(), state, moved, wrench(6.5), np.array([0, 0, -1e-3, 0]))
    assert not out.edge
    assert out.z_lock == pytest.approx(moved[2] + 1e-3 * 5e-3)


def test_the_jump_that_ends_a_search_already_lifts() -> None:
    state, _ = step(DslParameters(), DslState.begin(), START, wrench(1.0), NO_ACTION)
    _, out = step(DslParameters(), state, START, wrench(9.0), np.array([0, 0, -1e-3, 0]))
    assert out.edge
    assert out.position[2] == pytest.approx(START[2] + 5e-4 * 0.8)


def test_the_first_step_has_no_change_to_judge() -> None:
    _, out = in_contact(DslParameters(), 10.0)
    assert not out.edge
    assert out.z_lock == START[2]


def test_pressing_below_the_lock_is_limited_to_press() -> None:
    parameters = DslParameters(press_m=2e-4)
    _, out = step(parameters, DslState.begin(), START, wrench(6.0), np.array([0, 0, -5e-3, 0]))
    assert out.position[2] == pytest.approx(START[2] - 2e-4)
    assert out.clamped


def test_going_up_is_the_policys_right() -> None:
    _, out = step(DslParameters(), DslState.begin(), START, wrench(6.0), np.array([0, 0, 1e-3, 0]))
    assert out.position[2] == pytest.approx(START[2] + 1e-3)
    assert not out.clamped


def test_the_lock_stays_within_lift_max_of_the_first_contact() -> None:
    parameters = DslParameters(beta1=(1.0, 1.0, 1.0), lift_max_m=3e-3)
    state, _ = in_contact(parameters)
    _, out = step(parameters, state, START, wrench(10.0, fx=10.0), NO_ACTION)
    assert out.z_lock == pytest.approx(START[2] + 3e-3)


def test_the_floor_is_above_everything_but_off() -> None:
    floor = START[2] + 1e-3
    for mode in MODES:
        parameters = DslParameters(mode=mode, press_m=1e-3)
        for fz in (0.0, 6.0):
            _, out = step(parameters, DslState.begin((), floor), START, wrench(fz), np.array([0, 0, -1e-3, 0]))
            assert (out.position[2] >= floor) == (mode != "off")


def test_lost_contact_releases_the_lock_and_the_tip_seeks_again() -> None:
    state, _ = in_contact(DslParameters())
    state, out = step(DslParameters(), state, START, wrench(2.0), NO_ACTION)
    assert out.phase == Phase.LOCKED
    assert out.position[2] >= START[2]
    assert state.phase == Phase.SEEK
    assert np.isnan(state.z_lock)
    _, out = step(DslParameters(), state, START, wrench(0.0), NO_ACTION)
    assert out.position[2] == pytest.approx(START[2] - 5e-4)


def test_a_release_threshold_gives_the_contact_hysteresis() -> None:
    parameters = DslParameters(release_threshold=0.2)
    state, _ = in_contact(parameters)
    state, _ = step(parameters, state, START, wrench(3.0), NO_ACTION)
    assert state.phase == Phase.LOCKED
    state, _ = step(parameters, state, START, wrench(1.9), NO_ACTION)
    assert state.phase == Phase.SEEK


def test_with_a_compliant_arm_on_a_hard_surface_it_pecks() -> None:
    """Press, lift, press again: phases cycle, and no press is harder than one seeking step."""
    surface, stiffness = START[2] - 4e-3, 12_000.0
    state, target = DslState.begin(), START[2]
    phases: list[int] = []
    forces: list[float] = []
    for _ in range(60):
        tip = max(target, surface)
        force = (tip - target) * stiffness
        state, out = step(DslParameters(), state, np.array([0, 0, tip]), wrench(force), np.array([0, 0, -1e-4, 0]))
        target = float(out.position[2])
        phases.append(int(out.phase))
        forces.append(force)
    after_contact = phases[phases.index(Phase.LOCKED) :]
    assert after_contact.count(Phase.SEEK) > 10
    assert after_contact.count(Phase.LOCKED) > 10
    assert max(forces) <= stiffness * 6e-4 + 1e-6


# Saturation and non-finite numbers


def test_saturated_components_are_reported_and_normalise_to_one() -> None:
    state, out = step(DslParameters(), DslState.begin(), START, np.array([10.0, -11, 9.9, 1.0, -0.5, 3]), NO_ACTION)
    assert out.saturated.tolist() == [True, True, False, True, False, True]
    np.testing.assert_allclose(state.previous_n, [1, -1, 0.99, 1, -0.5, 1])


# Other modes


def test_sliding_searches_and_then_the_policy_owns_z() -> None:
    parameters = DslParameters(mode="sliding")
    action = np.array([1e-3, 0, -2e-3, 0.1])
    state, out = step(parameters, DslState.begin(), START, wrench(0.0), action)
    np.testing.assert_allclose(out.position, START + np.array([0, 0, -2.5e-3]))
    state, out = step(parameters, state, START, wrench(6.0), action)
    np.testing.assert_allclose(out.position, START + action[:3])
    assert out.phase == Phase.FREE
    state, out = step(parameters, state, START, wrench(0.0), action)
    np.testing.assert_allclose(out.position, START + action[:3])
    assert np.isnan(out.z_lock)
    assert not out.edge


def test_off_passes_the_action_through() -> None:
    action = np.array([1e-3, 2e-3, -3e-3, 0.1])
    for fz in (0.0, 30.0):
        state, out = step(DslParameters(mode="off"), DslState.begin(), START, wrench(fz), action)
        np.testing.assert_allclose(out.position, START + action[:3])
        assert (out.dyaw, out.phase) == (0.1, Phase.FREE)
        assert not out.search_time_exceeded
    assert state.z_contact0 == START[2]


# Batches


def with_element(batch: DslState, index: int, element: DslState) -> DslState:
    """Return a batch with another element at `index`, as one whose episode has ended begins among others."""
    rows = {field.name: np.array(getattr(batch, field.name)) for field in fields(DslState)}
    for name, row in rows.items():
        row[index] = getattr(element, name)
    return DslState(**rows)


number = st.floats(-1, 1)
steps = st.lists(
    st.tuples(
        st.lists(number, min_size=3, max_size=3),
        st.lists(number, min_size=6, max_size=6),
        st.lists(number, min_size=4, max_size=4),
    ),
    min_size=1,
    max_size=12,
)
SCALE_W = np.array([15.0, 15, 15, 1.5, 1.5, 1.5])
SCALE_A = np.array([3e-3, 3e-3, 3e-3, 0.14])


@settings(max_examples=150, deadline=None)
@example(
    sequence=[
        (
            [1.0, 0.0, 0.0],
            [0.40156225522086886, -1.0, -0.003464614612412745, 0.6051868139210166, -1.0, -0.4805784636948748],
            [0.0] * 4,
        ),
        ([0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0, 1.0, 0.3823999118440684], [0.0] * 4),
    ],
    mode="paper",
    hysteresis=False,
    press=0.0,
    begin_at=0,
)
@given(steps, st.sampled_from(MODES), st.booleans(), st.floats(0, 2e-3), st.integers(0, 11))
def test_a_batch_steps_as_its_elements_do(
    sequence: list[tuple[list[float], list[float], list[float]]],
    mode: LockMode,
    hysteresis: bool,
    press: float,
    begin_at: int,
) -> None:
    parameters = DslParameters(
        mode=mode,
        press_m=press + 1e-4,
        release_threshold=0.3 if hysteresis else None,
        search_steps=4,
        search_depth_m=5e-3,
    )
    floors = np.array([-1.0, START[2] - 2e-3])
    batch = DslState.begin((2,), floors)
    single = [DslState.begin((), floor) for floor in floors]
    for index, (p, w, a) in enumerate(sequence):
        position = START + 5e-3 * np.array([p, p[::-1]])
        force = SCALE_W * np.array([w, w[::-1]])
        action = SCALE_A * np.array([a, a[::-1]])
        if index == begin_at:
            single[0] = DslState.begin((), floors[0])
            batch = with_element(batch, 0, single[0])
        batch, out = step(parameters, batch, position, force, action)
        for i in range(2):
            single[i], alone = step(parameters, single[i], position[i], force[i], action[i])
            for field in fields(DslOutput):
                of_batch, of_one = getattr(out, field.name)[i], getattr(alone, field.name)
                if of_batch.dtype.kind == "f":
                    # A product of matrices may sum equation 4's terms in another order: one rounding
                    np.testing.assert_allclose(of_batch, of_one, rtol=0, atol=1e-15)
                else:
                    np.testing.assert_array_equal(of_batch, of_one)


@settings(max_examples=200, deadline=None)
@given(steps, st.floats(0, 2e-3), st.floats(-5e-3, 5e-3))
def test_papers_lock_bounds_the_depth_of_every_command(
    sequence: list[tuple[list[float], list[float], list[float]]], press: float, floor: float
) -> None:
    parameters = DslParameters(press_m=press)
    state = DslState.begin((), START[2] + floor)
    for p, w, a in sequence:
        position, action = START + 5e-3 * np.array(p), SCALE_A * np.array(a)
        state, out = step(parameters, state, position, SCALE_W * np.array(w), action)
        z = out.position[2]
        assert np.isfinite(out.position).all()
        assert z >= START[2] + floor
        if out.phase == Phase.LOCKED:
            assert z >= max(out.z_lock - press, START[2] + floor)
            assert out.z_lock <= max(state.z_contact0 + parameters.lift_max_m, START[2] + floor)
            within_lift = min(position[2], state.z_contact0 + parameters.lift_max_m)
            assert z >= within_lift - press - 1e-15
        else:
            assert z >= position[2] - parameters.seek_step_m + min(action[2], 0.0) - 1e-15
        assert (out.phase == Phase.LOCKED) == np.isfinite(out.z_lock)
        assert (state.phase == Phase.LOCKED) == np.isfinite(state.z_lock)


# Parameters


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("mode", "soft"),
        ("delta_f", (0.1, 0.1, 0.1)),
        ("beta1", (1.0, 1.0)),
        ("beta1", (1e-3, float("nan"), 1e-3)),
        ("beta2", -1e-3),
        ("force_clip_n", 0.0),
        ("torque_clip_nm", float("inf")),
        ("contact_threshold", 1.1),
        ("contact_threshold", 0.0),
        ("release_threshold", 0.6),
        ("release_threshold", -0.1),
        ("seek_step_m", 0.0),
        ("press_m", -1e-3),
        ("search_depth_m", float("nan")),
        ("search_steps", 0),
    ],
)
def test_parameters_that_make_no_lock_are_refused_by_name(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=field):
        DslParameters(**{field: value})  # pyright: ignore


def test_a_threshold_may_be_the_clip_and_the_release_the_contacts_own() -> None:
    parameters = DslParameters(contact_threshold=1.0, release_threshold=1.0)
    assert in_contact(parameters, 10.0)[1].contact


def test_the_papers_constants_are_the_defaults() -> None:
    parameters = DslParameters()
    assert parameters.delta_f == (0.15, 0.15, 0.45, 0.1, 0.1, 0.2)
    assert (parameters.beta1, parameters.beta2) == ((1e-3, 1e-3, 5e-4), 1e-3)
