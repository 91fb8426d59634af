"""Examples of UR's script manual, and the algebra that its functions obey."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_backend.ur_controller.builtins.poses import POSES
from sim_backend.ur_controller.script import Pose, ScriptRuntimeError, Value

numbers = st.floats(-1.5, 1.5)
poses = st.lists(numbers, min_size=6, max_size=6).map(Pose)


def call(name: str, *arguments: Value) -> Value:
    return POSES[name].call(*arguments)


def test_poses_are_composed_as_in_the_manual() -> None:
    composed = call("pose_trans", Pose([0.2, 0.5, 0.1, 1.57, 0, 0]), Pose([0.2, 0.5, 0.6, 1.57, 0, 0]))
    assert type(composed) is Pose
    assert list(composed) == pytest.approx([0.4, -0.0996, 0.60048, 3.14, 0, 0], abs=1e-5)


def test_positions_add_and_rotations_multiply() -> None:
    total = call("pose_add", Pose([0.2, 0.5, 0.1, 1.57, 0, 0]), Pose([0.2, 0.5, 0.6, 1.57, 0, 0]))
    assert list(total) == pytest.approx([0.4, 1.0, 0.7, 3.14, 0, 0])


def test_roll_pitch_yaw_is_that_of_the_manual() -> None:
    assert call("rotvec2rpy", [3.14, 1.57, 0]) == pytest.approx([-2.80856, -0.16202, 0.9], abs=1e-5)
    assert call("rpy2rotvec", [3.14, 1.57, 0]) == pytest.approx([2.22153, 0.00177, -2.21976], abs=1e-5)


def test_a_point_half_way_is_in_the_middle() -> None:
    start, end = Pose([0.2, 0.2, 0.4, 0, 0, 0]), Pose([0.2, 0.2, 0.6, 0, 0, 1.0])
    assert list(call("interpolate_pose", start, end, 0.5)) == pytest.approx([0.2, 0.2, 0.5, 0, 0, 0.5])
    assert list(call("interpolate_pose", start, end, 2)) == pytest.approx([0.2, 0.2, 0.8, 0, 0, 2.0])


def test_distance_counts_rotation_only_where_it_should() -> None:
    a, b = Pose([0, 0, 0, 0, 0, 0]), Pose([3, 4, 0, 0, 0, 1.0])
    assert call("point_dist", a, b) == pytest.approx(5.0)
    assert call("pose_dist", a, b) == pytest.approx(math.sqrt(26.0))


def test_a_force_has_a_torque_about_another_point() -> None:
    # From 1 m along x, a force along y turns the other way about z.
    moved = call("wrench_trans", Pose([1, 0, 0, 0, 0, 0]), [0, 10, 0, 0, 0, 0])
    assert moved == pytest.approx([0, 10, 0, 0, 0, -10])
    turned = call("wrench_trans", Pose([0, 0, 0, 0, 0, math.pi / 2]), [0, 10, 0, 1, 0, 0])
    assert turned == pytest.approx([10, 0, 0, 0, -1, 0])


@settings(max_examples=50, deadline=None)
@given(poses, poses)
def test_the_difference_added_again_is_the_target(start: Pose, end: Pose) -> None:
    again = call("pose_add", start, call("pose_sub", end, start))
    assert call("pose_dist", again, end) < 1e-6


@settings(max_examples=50, deadline=None)
@given(poses)
def test_a_pose_and_its_inverse_cancel(pose: Pose) -> None:
    assert list(call("pose_trans", pose, call("pose_inv", pose))) == pytest.approx([0.0] * 6, abs=1e-6)


@settings(max_examples=50, deadline=None)
@given(poses, st.lists(st.floats(-50, 50), min_size=6, max_size=6))
def test_a_wrench_does_the_same_work_from_every_point(to: Pose, wrench: list[float]) -> None:
    back = call("wrench_trans", call("pose_inv", to), call("wrench_trans", to, wrench))
    assert back == pytest.approx(wrench, abs=1e-6)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-1.4, 1.4), min_size=3, max_size=3))
def test_roll_pitch_yaw_and_back(angles: list[float]) -> None:
    assert call("rotvec2rpy", call("rpy2rotvec", angles)) == pytest.approx(angles, abs=1e-6)


def test_a_list_is_no_pose() -> None:
    with pytest.raises(ScriptRuntimeError, match="must be a pose"):
        call("pose_trans", [0, 0, 0, 0, 0, 0], Pose([0] * 6))
