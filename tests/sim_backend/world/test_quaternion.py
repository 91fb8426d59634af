import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_backend.world import quaternion
from wire import pose

VECTORS = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array)
ANGLES = st.floats(0, np.pi - 1e-3)


def rotvec(direction, angle):
    length = np.linalg.norm(direction)
    return np.zeros((1, 3)) if length < 1e-3 else (direction / length * angle)[None]


def matrix(q):
    return pose.rotation_from_rotvec(quaternion.to_rotvec(q))


@given(VECTORS, ANGLES)
def test_a_rotation_vector_survives_the_way_through_a_quaternion(direction, angle):
    vector = rotvec(direction, angle)
    assert quaternion.to_rotvec(quaternion.from_rotvec(vector)) == pytest.approx(vector, abs=1e-9)


@given(VECTORS, ANGLES, VECTORS, ANGLES)
def test_between_is_what_the_rotation_matrices_say(axis, angle, other_axis, other_angle):
    start, end = rotvec(axis, angle), rotvec(other_axis, other_angle)
    back = pose.rotation_from_rotvec(start).swapaxes(-1, -2)
    expected = pose.rotvec_from_rotation(pose.rotation_from_rotvec(end) @ back)
    turn = quaternion.between(quaternion.from_rotvec(start), quaternion.from_rotvec(end))
    assert np.linalg.norm(turn) <= np.pi + 1e-9
    if np.linalg.norm(expected) < np.pi - 1e-4:  # at half a turn both ways round are right
        assert turn == pytest.approx(expected, abs=1e-7)


@given(VECTORS, ANGLES, VECTORS)
def test_between_does_not_care_for_the_sign_of_a_quaternion(axis, angle, other):
    start, end = quaternion.from_rotvec(rotvec(axis, angle)), quaternion.from_rotvec(rotvec(other, 0.5))
    turn = quaternion.between(start, end)
    if np.linalg.norm(turn) < np.pi - 1e-4:
        assert quaternion.between(start, -end) == pytest.approx(turn, abs=1e-9)


def test_half_a_turn_and_no_turn_are_exact():
    down = quaternion.from_rotvec(np.array([[np.pi, 0.0, 0.0]]))
    assert quaternion.between(down, down) == pytest.approx(np.zeros((1, 3)), abs=0)
    assert matrix(down)[0] == pytest.approx(pose.tool_down(0.0), abs=1e-15)


@given(VECTORS, ANGLES, VECTORS, st.floats(0, 4e-3))
def test_turn_is_the_exponential_map_to_third_order(axis, angle, other, small):
    q = quaternion.from_rotvec(rotvec(axis, angle))
    step = rotvec(other, small)
    expected = pose.rotation_from_rotvec(step) @ matrix(q)
    quaternion.turn(q, 0.5 * step)
    assert matrix(q) == pytest.approx(expected, abs=small**3 + 1e-12)


def test_ten_thousand_turns_leave_a_unit_quaternion():
    q = quaternion.from_rotvec(np.array([[np.pi, 0.0, 0.0], [0.3, -0.2, 0.1]]))
    step = np.array([[1e-3, -2e-3, 5e-4], [0.0, 0.0, -3e-3]])
    for _ in range(10_000):
        quaternion.turn(q, step)
    assert (q * q).sum(1) == pytest.approx(np.ones(2), abs=1e-15)
