import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wire.pose import rotation_from_rotvec, rotvec_from_rotation, tool_down, yaw_of

ANGLES = st.one_of(
    st.floats(0.0, np.pi),
    st.sampled_from([0.0, 1e-300, 1e-12, 1e-8, 1e-4, np.pi - 1e-4, np.pi - 1e-8, np.pi - 1e-12, np.pi]),
)
AXES = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda axis: np.linalg.norm(axis) > 1e-3)


def x_turn(angle):
    return np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])


def z_turn(angle):
    return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])


def test_a_rotation_vector_turns_about_its_axis_by_its_length():
    assert rotation_from_rotvec([0.3, 0, 0]) == pytest.approx(x_turn(0.3), abs=1e-15)
    assert rotation_from_rotvec([0, 0, -2.0]) == pytest.approx(z_turn(-2.0), abs=1e-15)


@given(AXES, ANGLES)
def test_rotvec_survives_the_matrix_at_every_angle(axis, angle):
    rotvec = np.asarray(axis) / np.linalg.norm(axis) * angle
    back = rotvec_from_rotation(rotation_from_rotvec(rotvec))
    if angle > np.pi - 1e-9 and back @ rotvec < 0:
        back = -back
    assert back == pytest.approx(rotvec, abs=2e-9 if angle > np.pi - 1e-9 else 1e-14)


@given(st.floats(-np.pi, np.pi))
def test_a_tool_that_points_down_has_a_rotation_vector_of_length_pi(yaw):
    rotation = tool_down(yaw)
    rotvec = rotvec_from_rotation(rotation)
    assert np.linalg.norm(rotvec) == pytest.approx(np.pi, abs=1e-14)
    assert rotation_from_rotvec(rotvec) == pytest.approx(rotation, abs=1e-14)


@given(st.floats(-3.1, 3.1))
def test_tool_down_is_the_turn_of_the_architecture_and_yaw_reads_it_back(yaw):
    rotation = tool_down(yaw)
    assert rotation == pytest.approx(z_turn(yaw) @ x_turn(np.pi), abs=1e-15)
    assert yaw_of(rotation) == pytest.approx(yaw, abs=1e-14)


@pytest.mark.parametrize("batch", [(), (4,), (2, 3), (0,)])
def test_every_function_keeps_the_batch_shape(batch):
    rotation = tool_down(np.zeros(batch))
    assert rotation.shape == (*batch, 3, 3)
    assert rotvec_from_rotation(rotation).shape == (*batch, 3)
    assert rotation_from_rotvec(np.zeros((*batch, 3))).shape == (*batch, 3, 3)
    assert yaw_of(rotation).shape == batch
