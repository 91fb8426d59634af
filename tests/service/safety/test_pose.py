from math import pi

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from service.safety.pose import rotate, rotvec_from_yaw, wrap, yaw_and_tilt
from wire.pose import rotation_from_rotvec, rotvec_from_rotation

angle = st.floats(-3.1, 3.1)


def test_straight_down_at_yaw_zero_is_a_half_turn_about_x() -> None:
    np.testing.assert_allclose(rotvec_from_yaw(0.0), [pi, 0, 0])


@given(angle)
def test_the_tools_x_axis_points_along_yaw_and_its_z_axis_down(yaw: float) -> None:
    rotation = rotation_from_rotvec(rotvec_from_yaw(yaw))
    np.testing.assert_allclose(rotation[:, 0], [np.cos(yaw), np.sin(yaw), 0], atol=1e-12)
    np.testing.assert_allclose(rotation[:, 2], [0, 0, -1], atol=1e-12)


@given(angle, st.floats(0, 0.3), angle)
def test_yaw_and_tilt_come_back_from_a_tilted_pose(yaw: float, size: float, direction: float) -> None:
    tilt = size * np.array([np.cos(direction), np.sin(direction)])
    tilted = rotation_from_rotvec([*tilt, 0.0]) @ rotation_from_rotvec(rotvec_from_yaw(yaw))
    found_yaw, found_tilt = yaw_and_tilt(rotvec_from_rotation(tilted))
    np.testing.assert_allclose(found_tilt, tilt, atol=1e-9)
    # The tilt itself turns the x axis a little, in second order
    assert abs(wrap(found_yaw - yaw)) <= size**2 / 2 + 1e-9


def test_yaw_and_tilt_work_on_batches() -> None:
    yaw, tilt = yaw_and_tilt(rotvec_from_yaw(np.array([[0.5, -2.0]])))
    np.testing.assert_allclose(yaw, [[0.5, -2.0]])
    np.testing.assert_allclose(tilt, np.zeros((1, 2, 2)), atol=1e-12)


def test_wrap_brings_angles_into_one_turn() -> None:
    np.testing.assert_allclose(wrap([0.1, pi + 0.1, -pi - 0.1, 4 * pi]), [0.1, -pi + 0.1, pi - 0.1, 0], atol=1e-12)


def test_rotate_turns_x_and_y_and_leaves_the_rest() -> None:
    out = rotate(np.array([pi / 2, 0.0]), np.array([[1.0, 0, 5, 6], [1, 0, 5, 6]]))
    np.testing.assert_allclose(out, [[0, 1, 5, 6], [1, 0, 5, 6]], atol=1e-12)
