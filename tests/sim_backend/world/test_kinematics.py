import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from ur_analytic_ik import ur3e

from sim_backend.world.kinematics import (
    JOINT_RANGE_RAD,
    UR3E,
    KinematicsError,
    forward,
    forward_and_jacobian,
    inverse,
    inverse_where_found,
    jacobian,
    singularity_margin,
)
from wire.pose import rotvec_from_rotation, tool_down

RANDOM = np.random.default_rng(7)
Q = RANDOM.uniform(-2 * np.pi, 2 * np.pi, (400, 6))
READY = np.array([0.0, -1.6, 1.9, -1.9, -np.pi / 2, 0.0])


def chained(q):
    pose = np.eye(4)
    for angle, joint in zip(q, UR3E, strict=True):
        c, s, ca, sa = np.cos(angle), np.sin(angle), np.cos(joint.alpha_rad), np.sin(joint.alpha_rad)
        pose = pose @ [
            [c, -s * ca, s * sa, joint.a_m * c],
            [s, c * ca, -c * sa, joint.a_m * s],
            [0, sa, ca, joint.d_m],
            [0, 0, 0, 1],
        ]
    return pose


def test_forward_is_the_product_of_the_dh_matrices():
    position, rotation = forward(Q)
    want = np.array([chained(q) for q in Q])
    assert position == pytest.approx(want[:, :3, 3], abs=1e-14)
    assert rotation == pytest.approx(want[:, :3, :3], abs=1e-14)


def test_forward_agrees_with_an_independent_implementation():
    position, rotation = forward(Q[:50])
    want = np.array([ur3e.forward_kinematics(*q) for q in Q[:50]])
    assert position == pytest.approx(want[:, :3, 3], abs=1e-9)
    assert rotation == pytest.approx(want[:, :3, :3], abs=1e-9)


def test_jacobian_is_the_derivative_of_the_tool_point_and_of_the_orientation():
    q, offset, h = Q[:50], np.array([0.01, -0.02, 0.2]), 1e-6

    def point(angles):
        position, rotation = forward(angles)
        return position + rotation @ offset, rotation

    numeric = np.empty((50, 6, 6))
    for joint in range(6):
        step = h * np.eye(6)[joint]
        (ahead, rotation_ahead), (behind, rotation_behind) = point(q + step), point(q - step)
        numeric[:, :3, joint] = (ahead - behind) / (2 * h)
        turned = rotation_ahead @ rotation_behind.swapaxes(-1, -2)
        numeric[:, 3:, joint] = rotvec_from_rotation(turned) / (2 * h)
    assert jacobian(q, offset) == pytest.approx(numeric, abs=1e-8)


def test_forward_and_jacobian_gives_what_the_two_give():
    position, rotation, jac = forward_and_jacobian(Q, [0, 0, 0.2])
    assert np.array_equal(position, forward(Q)[0])
    assert np.array_equal(rotation, forward(Q)[1])
    assert np.array_equal(jac, jacobian(Q, [0, 0, 0.2]))


def test_singularity_margins_multiply_to_the_determinant_of_the_jacobian():
    a2, a3, d5 = UR3E[1].a_m, UR3E[2].a_m, UR3E[4].d_m
    scale = abs(a2 * a3) * (abs(a2) + abs(a3) + d5)
    determinant = np.abs(np.linalg.det(jacobian(Q, [0, 0, 0.1])))
    assert singularity_margin(Q).prod(-1) * scale == pytest.approx(determinant, abs=1e-14)
    assert (singularity_margin(Q) <= 1.0).all()


@pytest.mark.parametrize(("joint", "margin"), [(2, 1), (4, 2)])
def test_a_straight_arm_and_an_aligned_wrist_have_no_margin(joint, margin):
    q = READY.copy()
    q[joint] = 0.0
    assert singularity_margin(q)[margin] == 0.0
    assert singularity_margin(READY).min() > 0.3


def test_inverse_returns_the_angles_that_the_pose_came_from():
    q = Q[singularity_margin(Q).min(-1) > 0.02]
    assert len(q) > 300
    assert inverse(*forward(q), q + RANDOM.uniform(-1e-3, 1e-3, q.shape)) == pytest.approx(q, abs=1e-9)


@given(st.lists(st.floats(-6.2, 6.2), min_size=12, max_size=12))
def test_inverse_reaches_the_pose_from_any_start_within_the_joint_range(angles):
    assume(singularity_margin(angles[:6])[2] > 1e-6)
    pose = forward(angles[:6])
    q = inverse(*pose, angles[6:])
    assert (np.abs(q) <= JOINT_RANGE_RAD + 1e-12).all()
    position, rotation = forward(q)
    assert position == pytest.approx(pose[0], abs=1e-7)
    assert rotation == pytest.approx(pose[1], abs=1e-7)


def test_inverse_picks_the_nearest_of_all_solutions_of_an_independent_implementation():
    for q, near in zip(Q[:100], Q[100:200] / 2, strict=True):
        solutions = np.array(ur3e.inverse_kinematics(chained(q)))
        offsets = np.remainder(solutions - near + np.pi, 2 * np.pi) - np.pi
        got = inverse(*forward(q), near)
        assert np.linalg.norm(got - near) == pytest.approx(np.linalg.norm(offsets, axis=-1).min(), abs=1e-6)


def test_inverse_turns_back_at_the_joint_range_except_for_joint_six():
    near = READY + 2 * np.pi * np.array([0, 0, 0, 0, 0, 3])
    near[0] = 2 * np.pi - 0.1
    target = near.copy()
    target[0], target[5] = 2 * np.pi + 0.1, near[5] + 0.2
    q = inverse(*forward(target), near)
    assert np.abs(q[0]) < 2 * np.pi
    assert np.abs(q[5] - near[5]) <= np.pi
    assert forward(q)[0] == pytest.approx(forward(target)[0], abs=1e-9)


def test_a_singular_wrist_leaves_joint_six_where_it_was():
    q = READY.copy()
    q[4] = 0.0
    near = q.copy()
    near[5] += 0.3
    got = inverse(*forward(q), near)
    assert got[5] == pytest.approx(near[5], abs=1e-14)
    assert forward(got)[0] == pytest.approx(forward(q)[0], abs=1e-12)


def test_following_a_tool_down_path_in_small_steps_never_jumps():
    path = np.linspace([-0.28, -0.05, 0.3], [-0.35, 0.1, 0.25], 400)
    yaw = np.linspace(-1.0, 1.0, 400)
    q = inverse(path[0], tool_down(yaw[0]), READY)
    for position, angle in zip(path, yaw, strict=True):
        following = inverse(position, tool_down(angle), q)
        assert np.abs(following - q).max() < 0.02
        q = following


def test_a_pose_out_of_reach_is_refused_by_name():
    with pytest.raises(KinematicsError, match=r"\[0\.7000, 0\.1000, 0\.2000\] m"):
        inverse([0.7, 0.1, 0.2], tool_down(0.0), READY)


def test_a_pose_over_the_base_axis_is_refused():
    with pytest.raises(KinematicsError):
        inverse([0.05, 0.0, 0.3], tool_down(0.0), READY)


def test_a_batch_says_which_poses_have_no_solution_and_keeps_their_angles():
    good, _ = forward(READY)
    q, found = inverse_where_found([good, [2.0, 0, 0], [np.nan, 0, 0]], tool_down(0.0), READY)
    assert found.tolist() == [True, False, False]
    assert np.array_equal(q[1:], np.broadcast_to(READY, (2, 6)))
    with pytest.raises(KinematicsError, match="2 of 3 poses"):
        inverse([good, [2.0, 0, 0], [np.nan, 0, 0]], tool_down(0.0), READY)


@pytest.mark.parametrize("batch", [(), (4,), (2, 3), (0,)])
def test_every_function_keeps_the_batch_shape(batch):
    q = np.broadcast_to(READY, (*batch, 6))
    position, rotation = forward(q)
    assert position.shape == (*batch, 3)
    assert rotation.shape == (*batch, 3, 3)
    assert jacobian(q, [0, 0, 0.1]).shape == (*batch, 6, 6)
    assert inverse(position, rotation, READY).shape == (*batch, 6)
    assert singularity_margin(q).shape == (*batch, 3)
