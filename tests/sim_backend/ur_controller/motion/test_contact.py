import numpy as np
import pytest

from wire.task import Task

from .conftest import Arm


def _above_the_block(arm: Arm, height: float) -> None:
    arm.plant.lay_out(Task(2, "tr"))
    hole = arm.plant.world.hole_position[0]
    arm.plant.place([hole[0] + 0.05, hole[1], hole[2] + height])
    arm.run(250)


def _until_touched(arm: Arm, direction: list[float]) -> int:
    for _ in range(1000):
        arm.run(1, lambda: arm.motion.speedl([0.0, 0.0, -0.02, 0.0, 0.0, 0.0], 0.5, 0.002, 0.5))
        steps = arm.motion.memory.touched(np.array(direction))
        if steps:
            return steps
    raise AssertionError("no contact was seen")


@pytest.mark.parametrize("direction", [[0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [0.0, 0.3, -0.7]])
def test_a_contact_is_seen_and_where_it_began(arm: Arm, direction: list[float]):
    _above_the_block(arm, 0.004)
    steps = _until_touched(arm, direction)
    assert 5.0 < arm.pressing() < 25.0
    assert steps < 60
    then = arm.motion.memory.joints(steps)
    assert then is not None
    height = arm.plant.tcp_pose_of(then.tolist())[2]
    top = arm.plant.world.hole_position[0][2]
    assert height == pytest.approx(top, abs=8e-4)


def test_free_motion_is_no_contact(arm: Arm):
    arm.run(150)
    for _ in range(400):
        arm.run(1, lambda: arm.motion.speedl([0.0, 0.05, -0.02, 0.0, 0.0, 0.2], 0.5, 0.002, 0.5))
        assert arm.motion.memory.touched(np.zeros(3)) == 0


def test_a_contact_from_the_other_side_is_none(arm: Arm):
    _above_the_block(arm, 0.002)
    for _ in range(150):
        arm.run(1, lambda: arm.motion.speedl([0.0, 0.0, -0.02, 0.0, 0.0, 0.0], 0.5, 0.002, 0.5))
        assert arm.motion.memory.touched(np.array([0.0, 0.0, 1.0])) == 0
    assert arm.pressing() > 10.0


def test_the_memory_holds_what_was_measured(arm: Arm):
    arm.run(30, lambda: arm.motion.speedj([0, 0, 0, 0, 0, 0.5], 10.0, 0.002))
    memory = arm.motion.memory
    # the memory is written before the tick that follows is simulated
    for steps in (0, 1, 7, 25):
        assert np.array_equal(memory.joints(steps), arm.joints[-2 - steps])
    assert memory.joints(500) is None
    assert memory.joints(-1) is None
