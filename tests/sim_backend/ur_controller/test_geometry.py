import numpy as np
import pytest

from sim_backend.ur_controller import geometry
from sim_backend.world import kinematics
from wire import pose

RNG = np.random.default_rng(4)
JOINTS = RNG.uniform(-6, 6, (200, 6))
ANGLES = [0.0, 1e-12, 1e-9, 1e-7, 1e-3, 1.0, 3.0, np.pi - 1e-7, np.pi]


def rotations():
    for angle in ANGLES:
        for axis in [*np.eye(3), *RNG.normal(size=(5, 3))]:
            yield angle * axis / np.linalg.norm(axis)


def test_the_flange_stands_where_the_batched_kinematics_put_it():
    for q in JOINTS:
        position, rotation = geometry.flange_of(q.tolist())
        wanted_position, wanted_rotation = kinematics.forward(q)
        assert position == pytest.approx(wanted_position, abs=1e-14)
        assert np.reshape(rotation, (3, 3)) == pytest.approx(wanted_rotation, abs=1e-14)


def test_the_jacobian_is_the_one_of_the_batched_kinematics_at_any_tool():
    for q in JOINTS:
        tool = RNG.uniform(-0.3, 0.3, 3)
        position, rotation = geometry.flange_of(q.tolist())
        point = np.array(position) + geometry.rotate(rotation, tool)
        assert geometry.jacobian_of(q.tolist(), point.tolist()) == pytest.approx(
            kinematics.jacobian(q, tool), abs=1e-13
        )


def test_rotation_vectors_and_matrices_agree_with_the_batched_ones_at_every_angle():
    for rotvec in rotations():
        rotation = geometry.rotation_of(*rotvec)
        assert np.reshape(rotation, (3, 3)) == pytest.approx(pose.rotation_from_rotvec(rotvec), abs=1e-14)
        back = np.array(geometry.rotvec_of(rotation))
        turned_about = min(np.abs(back - rotvec).max(), np.abs(back + rotvec).max() if abs(rotvec).max() > 1 else 9)
        assert turned_about < 1e-12


def test_a_pose_after_its_inverse_is_no_motion_and_composition_follows_the_matrices():
    for _ in range(50):
        a, b = RNG.uniform(-1.7, 1.7, (2, 6)).tolist()
        assert geometry.compose(a, geometry.invert(a)) == pytest.approx(np.zeros(6), abs=1e-14)
        both = geometry.compose(a, b)
        first, second = pose.rotation_from_rotvec(a[3:]), pose.rotation_from_rotvec(b[3:])
        assert both[:3] == pytest.approx(np.array(a[:3]) + first @ b[:3])
        assert pose.rotation_from_rotvec(both[3:]) == pytest.approx(first @ second, abs=1e-13)


def test_vector_product_and_transpose():
    a, b = RNG.normal(size=(2, 3))
    assert geometry.cross(a.tolist(), b.tolist()) == pytest.approx(np.cross(a, b))
    turn = geometry.rotation_of(0.3, -1.0, 0.4)
    assert geometry.multiply(turn, geometry.transpose(turn)) == pytest.approx(geometry.rotation_of(0.0, 0.0, 0.0))
