import numpy as np
import pytest

from sim_backend.ur_controller.motion.differential import joint_rates, tool_twist
from sim_backend.world import kinematics


def _drawn(seed: int):
    rng = np.random.default_rng(seed)
    q = rng.uniform(-3.0, 3.0, 6)
    position, rotation, jacobian = kinematics.forward_and_jacobian(q, offset := rng.uniform(-0.2, 0.2, 3))
    return q, position + rotation @ offset, jacobian, rng.normal(size=6)


@pytest.mark.parametrize("seed", range(50))
def test_tool_speeds_are_those_of_the_jacobian(seed: int):
    q, point, jacobian, qd = _drawn(seed)
    assert np.allclose(tool_twist(q.tolist(), point.tolist(), qd.tolist()), jacobian @ qd, atol=1e-12)


@pytest.mark.parametrize("seed", range(50))
def test_joint_speeds_are_those_of_the_jacobian_s_inverse(seed: int):
    q, point, jacobian, twist = _drawn(seed)
    if kinematics.singularity_margin(q).min() < 0.05:
        q[[2, 4]] = 1.0
        point = kinematics.forward(q)[0]
        jacobian = kinematics.jacobian(q, np.zeros(3))
    rates = joint_rates(q.tolist(), point.tolist(), twist.tolist())
    assert rates is not None
    assert np.allclose(jacobian @ rates, twist, atol=1e-9)


@pytest.mark.parametrize(("joint", "name"), [(2, "elbow"), (4, "wrist")])
def test_a_singular_arm_has_no_joint_speeds(joint: int, name: str):
    q = [0.1, -1.2, 1.4, -0.5, 1.3, 0.2]
    q[joint] = 0.001
    assert joint_rates(q, [0.3, 0.0, 0.3], [0.1, 0.0, 0.0, 0.0, 0.0, 0.0]) is None, name
