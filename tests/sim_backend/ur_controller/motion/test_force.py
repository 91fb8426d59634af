import numpy as np
import pytest

from sim_backend.ur_controller.motion import ForceTask
from wire.task import Task

from .conftest import Arm, angle_between

BASE = [0.0] * 6
WIDE = [0.1, 0.1, 0.1, 0.5, 0.5, 0.5]
DOWN = [False, False, True, False, False, False]


def _over_the_block(arm: Arm, seed: int = 1, height: float = 0.004) -> None:
    """Bring the peg over the block's top, beside the hole."""
    arm.plant.lay_out(Task(seed, "tr"))
    hole = arm.plant.world.hole_position[0]
    arm.plant.place([hole[0] + 0.05, hole[1], hole[2] + height])
    arm.run(250)
    arm.plant.zero_ft()


def _push(arm: Arm, newtons: float, *, limits: list[float] = WIDE, kind: int = 2) -> None:
    arm.motion.force(ForceTask(BASE, DOWN, [0.0, 0.0, -newtons, 0.0, 0.0, 0.0], kind, limits))


@pytest.mark.parametrize("newtons", [5.0, 20.0])
@pytest.mark.parametrize(("damping", "gain"), [(0.005, 1.0), (0.025, 0.5)])
def test_it_settles_at_the_force_asked_for(arm: Arm, newtons: float, damping: float, gain: float):
    _over_the_block(arm)
    arm.motion.force_damping, arm.motion.force_gain = damping, gain
    _push(arm, newtons)
    arm.run(800)
    felt = []
    for _ in range(20):
        arm.run(20)
        felt.append(arm.pressing())
    assert np.mean(felt) == pytest.approx(newtons, abs=0.7)
    assert np.abs(np.array(felt) - newtons).max() < 1.5


@pytest.mark.parametrize("seed", range(4))
def test_it_touches_down_without_a_blow_in_any_plant(arm: Arm, seed: int):
    _over_the_block(arm, seed)
    _push(arm, 10.0)
    peak = 0.0
    for _ in range(120):
        arm.run(5)
        peak = max(peak, arm.pressing())
    assert 9.0 < arm.pressing() < 11.0
    assert peak < 18.0


def test_a_force_beyond_the_sensor_s_range_is_not_chased(arm: Arm):
    _over_the_block(arm)
    _push(arm, 60.0)
    arm.run(600)
    first = arm.pressing()
    arm.run(300)
    assert 25.0 < first < 60.0
    assert arm.pressing() == pytest.approx(first, abs=2.0)


def test_the_other_axes_do_not_give_way(arm: Arm):
    _over_the_block(arm)
    start, told = arm.plant.tcp_pose(), arm.motion.target_tcp_pose()
    _push(arm, 15.0)
    arm.run(1000)
    now = arm.motion.target_tcp_pose()
    assert np.abs(np.subtract(now, told)[:2]).max() < 1e-9
    assert angle_between(now, told) < 1e-7
    bent = np.subtract(arm.plant.tcp_pose(), start)  # by the servos' compliance
    assert np.abs(bent[:2]).max() < 1.5e-3
    assert bent[2] < -3e-3


def test_in_the_free_it_moves_no_faster_than_its_limit(arm: Arm):
    arm.run(250)
    arm.plant.zero_ft()
    _push(arm, 40.0, limits=[0.1, 0.1, 0.02, 0.5, 0.5, 0.5])
    arm.run(300)
    assert arm.plant.tcp_speed()[2] == pytest.approx(-0.02, abs=1e-3)
    assert np.diff(np.array(arm.targets)[:, 2]).min() / 0.002 > -0.02 - 1e-9
    assert np.diff(arm.positions()[:, 2]).min() / 0.002 > -0.026


def test_it_gives_way_faster_with_more_gain_and_slower_with_more_damping(arm: Arm):
    def travelled(damping: float, gain: float) -> float:
        arm.plant.place((0.28, -0.11, 0.16))
        arm.run(150)
        arm.plant.zero_ft()
        arm.motion.force_damping, arm.motion.force_gain = damping, gain
        start = arm.plant.tcp_pose()[2]
        _push(arm, 10.0)
        arm.run(250)
        arm.motion.end_force()
        return start - arm.plant.tcp_pose()[2]

    usual = travelled(0.005, 1.0)
    assert usual == pytest.approx(10.0 / 300.0 * 0.5, rel=0.15)
    assert travelled(0.005, 0.5) == pytest.approx(0.5 * usual, rel=0.2)
    assert travelled(0.3, 1.0) < 0.5 * usual


def test_a_program_moves_along_while_the_force_is_held(arm: Arm):
    _over_the_block(arm)
    _push(arm, 10.0)
    arm.run(400)
    start = arm.plant.tcp_pose()
    forces = []
    for _ in range(30):
        # a speed into the block, too, of which nothing must come
        arm.run(10, lambda: arm.motion.speedl([0.0, 0.03, -0.03, 0.0, 0.0, 0.0], 0.5, 0.002, 0.5))
        forces.append(arm.pressing())
    moved = np.subtract(arm.plant.tcp_pose(), start)
    assert moved[1] == pytest.approx(0.03 * 0.6, abs=2e-3)
    assert abs(moved[2]) < 1.5e-3
    assert np.mean(forces) == pytest.approx(10.0, abs=1.5)


def test_a_move_goes_to_its_place_across_the_force(arm: Arm):
    _over_the_block(arm)
    _push(arm, 10.0)
    arm.run(300)
    target = arm.offset(0.01, 0.02, 0.05)
    arm.motion.movel(target, 0.5, 0.05, 0.0, 0.0)
    arm.until_ready()
    arm.run(100)
    assert np.allclose(arm.plant.tcp_pose()[:2], target[:2], atol=1e-3)
    assert arm.pressing() == pytest.approx(10.0, abs=1.0)


def test_the_end_of_force_mode_holds_the_arm_where_it_is(arm: Arm):
    _over_the_block(arm)
    _push(arm, 10.0)
    arm.run(500)
    pose = arm.motion.target_tcp_pose()
    arm.motion.end_force()
    arm.run(300)
    assert not arm.motion.in_force_mode
    assert np.allclose(arm.motion.target_tcp_pose(), pose, atol=1e-4)
    assert arm.pressing() == pytest.approx(10.0, abs=1.5)
    assert arm.motion.is_steady


def test_a_move_that_is_on_its_way_goes_on_after_force_mode_without_a_jump(arm: Arm):
    arm.run(250)
    arm.plant.zero_ft()
    arm.motion.movel(arm.offset(0.0, 0.1, 0.0), 0.5, 0.1, 0.0, 0.0)
    _push(arm, 10.0)
    arm.run(250)
    fallen = arm.plant.tcp_pose()[2]
    arm.motion.end_force()
    arm.until_ready()
    arm.settle()
    steps = np.linalg.norm(np.diff(arm.positions(), axis=0), axis=1)
    assert steps.max() < 0.002 * 0.13
    assert arm.plant.tcp_pose()[1] == pytest.approx(-0.01, abs=1e-3)
    assert arm.plant.tcp_pose()[2] == pytest.approx(fallen, abs=2e-3)


def test_it_is_not_steady(arm: Arm):
    arm.run(100)
    assert arm.motion.is_steady
    _push(arm, 0.0)
    arm.run(200)
    assert not arm.motion.is_steady


def test_a_task_frame_turns_the_axes(arm: Arm):
    arm.run(250)
    arm.plant.zero_ft()
    start = np.array(arm.plant.tcp_pose()[:3])
    frame = [0.0, 0.0, 0.0, 0.0, 0.0, np.pi / 4]
    arm.motion.force(ForceTask(frame, [True, False, False, False, False, False], [10.0, 0, 0, 0, 0, 0], 2, WIDE))
    arm.run(250)
    moved = np.array(arm.plant.tcp_pose()[:3]) - start
    assert moved[:2].sum() / np.sqrt(2) > 0.01
    assert abs(moved[0] - moved[1]) < 2e-3
    assert abs(moved[2]) < 5e-4


def test_type_1_points_from_the_tool_to_the_frame(arm: Arm):
    arm.run(250)
    arm.plant.zero_ft()
    start = np.array(arm.plant.tcp_pose()[:3])
    towards = np.array([0.08, 0.06, 0.0])
    frame = [*(start + towards), 0.0, 0.0, 0.0]
    arm.motion.force(ForceTask(frame, [False, True, False, False, False, False], [0, 10.0, 0, 0, 0, 0], 1, WIDE))
    arm.run(250)
    moved = np.array(arm.plant.tcp_pose()[:3]) - start
    along = moved @ towards / np.linalg.norm(towards)
    assert along > 0.01
    assert np.linalg.norm(moved - along * towards / np.linalg.norm(towards)) < 1e-3


def test_type_3_follows_the_direction_of_motion(arm: Arm):
    arm.run(250)
    arm.plant.zero_ft()
    start = np.array(arm.plant.tcp_pose()[:3])
    # compliant across the motion: a push along y of the frame goes to the left of where the tool moves
    arm.motion.force(ForceTask(BASE, [False, True, False, False, False, False], [0, 10.0, 0, 0, 0, 0], 3, WIDE))
    arm.run(200, lambda: arm.motion.speedl([0.0, 0.05, 0.0, 0, 0, 0], 1.0, 0.002, 1.0))
    moved = np.array(arm.plant.tcp_pose()[:3]) - start
    assert moved[0] < -0.008
    assert moved[1] == pytest.approx(0.05 * 0.4, abs=3e-3)


def test_a_compliant_turn_follows_the_torque(arm: Arm):
    arm.run(250)
    arm.plant.zero_ft()
    start = arm.plant.tcp_pose()
    arm.motion.force(ForceTask(BASE, [False] * 5 + [True], [0, 0, 0, 0, 0, 0.5], 2, WIDE))
    arm.run(400)
    assert angle_between(start, arm.plant.tcp_pose()) > 0.05
    assert np.linalg.norm(np.subtract(arm.plant.tcp_pose()[:3], start[:3])) < 6e-4


def test_a_stiff_axis_that_is_pushed_beyond_its_limit_is_a_fault(arm: Arm):
    _over_the_block(arm, height=0.001)
    limits = [0.1, 0.1, 0.0005, 0.5, 0.5, 0.5]
    arm.motion.force(ForceTask(BASE, [True, False, False, False, False, False], [0.0] * 6, 2, limits))
    for _ in range(500):
        arm.run(1, lambda: arm.motion.speedl([0.0, 0.0, -0.02, 0.0, 0.0, 0.0], 0.5, 0.002, 0.5))
        if arm.motion.fault:
            break
    assert "deviates" in (arm.motion.fault or "")


def test_a_paused_program_does_not_give_way(arm: Arm):
    arm.run(250)
    arm.plant.zero_ft()
    _push(arm, 10.0)
    arm.run(100)
    arm.fraction = 0.0
    arm.run(120)
    paused = arm.plant.tcp_pose()
    assert 0.15 - paused[2] > 5e-3
    arm.run(200)
    assert np.allclose(arm.plant.tcp_pose()[:3], paused[:3], atol=1e-5)
