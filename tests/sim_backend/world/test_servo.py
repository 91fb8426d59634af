"""The set-points that keep an arm on its reference, against the arm."""

import numpy as np
import pytest

from sim_backend.world import kinematics, scene
from sim_backend.world.servo import JointServo, gains
from sim_backend.world.world import World
from wire.task import Task

COM = (0.0, 0.0, scene.PAYLOAD_COM_M)
ALL = np.arange(2)


@pytest.fixture
def world():
    return World(2)


def servo(world, payload_kg=scene.PAYLOAD_KG):
    return JointServo(2, *gains(world.model()), payload_kg, COM)


def sag(world, servo):
    """How far the tools hang below where their joints are told to be, m, after a second at rest."""
    joints = world.joints.copy()
    servo.refresh(ALL, joints)
    before = world.position[:, 2].copy()
    for _ in range(500):
        world.drive(servo.set_points(joints, np.zeros((2, 6))))
    return before - world.position[:, 2]


def test_an_arm_stands_where_it_is_told_with_its_payload(world):
    assert sag(world, servo(world)) == pytest.approx(np.zeros(2), abs=2e-5)


def test_a_payload_that_was_not_configured_pulls_the_arm_down(world):
    light = servo(world, 0.0)
    assert (sag(world, light) > 1e-4).all()
    light.set_payload(scene.PAYLOAD_KG, COM)
    assert sag(world, light) == pytest.approx(np.zeros(2), abs=2e-5)


def test_a_moving_arm_is_where_its_reference_is(world):
    world.reset(ALL, [Task(0), Task(1)])
    made = servo(world)
    joints, speeds = world.joints.copy(), np.array([[0.2, -0.2, 0.3, 0.2, -0.4, 0.5], [0.0, 0.1, 0.0, 0.0, 0.3, 0.0]])
    made.refresh(ALL, joints)
    for _ in range(300):
        joints += 0.002 * speeds
        world.drive(made.set_points(joints, speeds))
    assert world.joints == pytest.approx(joints + 0.002 * speeds, abs=5e-4)  # where it is in the next tick
    assert world.joint_speeds == pytest.approx(speeds, abs=0.01)


def test_refreshing_one_arm_leaves_the_others(world):
    made = servo(world)
    joints = world.joints.copy()
    made.refresh(np.array([1]), joints[1:])
    points = made.set_points(joints, np.zeros((2, 6)))
    assert points[0] == pytest.approx(joints[0])
    weight = scene.PAYLOAD_KG * kinematics.GRAVITY_M_S2
    lift = kinematics.jacobian(joints[1], COM)[2]
    assert (points[1] - joints[1]) * gains(world.model())[0] == pytest.approx(weight * lift)
