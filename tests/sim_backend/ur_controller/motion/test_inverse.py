import numpy as np
import pytest

from sim_backend.ur_controller.geometry import flange_of
from sim_backend.ur_controller.motion.inverse import inverse
from sim_backend.world import kinematics


@pytest.mark.parametrize("spread", [0.001, 0.02, 0.2, 1.5])
def test_it_gives_the_solution_nearest_to_where_it_begins(spread: float):
    rng = np.random.default_rng(3)
    for _ in range(100):
        q = rng.uniform(-3.0, 3.0, 6)
        position, rotation = flange_of(q.tolist())
        near = q + rng.uniform(-spread, spread, 6)
        expected = kinematics.inverse(np.array(position), np.array(rotation).reshape(3, 3), near)
        assert np.allclose(inverse(position, rotation, near.tolist()), expected, atol=1e-8)


def test_a_pose_out_of_reach_has_no_solution():
    with pytest.raises(kinematics.KinematicsError):
        inverse((2.0, 0.0, 0.0), flange_of([0.0] * 6)[1], [0.3, -1.2, 1.4, -0.5, 1.3, 0.2])


def test_no_joint_leaves_its_range():
    near = [0.3, -1.2, 1.4, -0.5, 2 * np.pi - 0.01 - 1.0, 0.2]
    near[3] = 2 * np.pi - 0.005
    beyond = near.copy()
    beyond[3] += 0.02
    q = inverse(*flange_of(beyond), near)
    assert np.abs(q[:5]).max() <= 2 * np.pi
    assert np.allclose(flange_of(q)[0], flange_of(beyond)[0], atol=1e-9)
