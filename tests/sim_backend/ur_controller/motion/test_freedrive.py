import numpy as np
import pytest

from .conftest import Arm, angle_between


@pytest.fixture
def hand(arm: Arm):
    """A hand that pushes the gripper with a force (3,), base axes."""
    world = arm.plant.world
    pushed = world._batch.bind("xfrc_applied")[0, world._scene.gripper_body]  # no command of the cell reaches this

    def push(x: float, y: float, z: float) -> None:
        pushed[:3] = x, y, z

    yield push
    push(0.0, 0.0, 0.0)


def test_a_hand_moves_the_arm_in_freedrive_only(arm: Arm, hand):
    start = np.array(arm.plant.tcp_pose()[:3])
    hand(0.0, 15.0, 0.0)
    arm.run(200)
    assert np.linalg.norm(arm.plant.tcp_pose()[:3] - start) < 2e-3
    arm.motion.freedrive()
    assert arm.motion.in_freedrive
    arm.run(400)
    moved = np.array(arm.plant.tcp_pose()[:3]) - start
    assert moved[1] > 0.02
    hand(0.0, 0.0, 0.0)
    arm.motion.end_freedrive()
    left = np.array(arm.plant.tcp_pose()[:3])
    arm.run(200)
    assert np.linalg.norm(arm.plant.tcp_pose()[:3] - left) < 1.5e-3
    assert not arm.motion.in_freedrive


def test_nobody_s_hand_leaves_it_nearly_where_it_is(arm: Arm):
    start = np.array(arm.plant.tcp_pose()[:3])
    arm.motion.freedrive()
    arm.run(500)
    assert np.linalg.norm(arm.plant.tcp_pose()[:3] - start) < 0.02
    assert not arm.motion.is_steady


def test_a_locked_axis_does_not_follow_the_hand(arm: Arm, hand):
    arm.run(250)
    arm.plant.zero_ft()
    start = arm.plant.tcp_pose()
    arm.motion.freedrive([False, True, False, False, False, False])
    hand(15.0, 15.0, 0.0)
    arm.run(400)
    moved = np.subtract(arm.plant.tcp_pose(), start)
    assert moved[1] > 0.01
    assert abs(moved[0]) < 3e-3
    assert angle_between(start, arm.plant.tcp_pose()) < 1e-2


def test_the_status_tells_of_singularities(arm: Arm):
    assert arm.motion.freedrive_status() == 0
    straight = arm.motion.q_target.copy()
    straight[2] = 0.0
    arm.motion.movej(straight.tolist(), 1.4, 1.0, 0.0, 0.0)
    seen = {0}
    while not arm.motion.ready:
        arm.motion.advance()
        seen.add(arm.motion.freedrive_status())
    assert seen == {0, 1, 2}
    assert arm.motion.freedrive_status() == 2
