import numpy as np
import pytest

from sim_backend.ur_controller.motion.cartesian import Arc
from wire.pose import rotation_from_rotvec, rotvec_from_rotation

from .conftest import Arm, angle_between

FAST = 1000.0
"""An acceleration that reaches any speed in one tick."""


def _movel(arm: Arm, target: list[float], *, a: float = 1.2, v: float = 0.25, t: float = 0.0, r: float = 0.0) -> None:
    arm.motion.movel(target, a, v, t, r)


def _turned(pose: list[float], *turn: float) -> list[float]:
    rotation = rotation_from_rotvec(turn) @ rotation_from_rotvec(pose[3:])
    return [*pose[:3], *rotvec_from_rotation(rotation)]


def _distance_from_line(points: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    along = (end - start) / np.linalg.norm(end - start)
    away = points - start
    return np.linalg.norm(away - (away @ along)[:, None] * along, axis=1)


def test_movel_takes_the_tcp_along_a_straight_line_to_the_pose(arm: Arm):
    start = np.array(arm.plant.tcp_pose()[:3])
    target = _turned(arm.offset(0.04, 0.08, -0.03), 0.0, 0.1, 0.3)
    _movel(arm, target)
    arm.until_ready()
    arm.settle()
    reached = arm.plant.tcp_pose()
    assert np.allclose(reached[:3], target[:3], atol=2e-6)
    assert angle_between(reached, target) < 1e-5
    assert _distance_from_line(arm.positions(), start, np.array(target[:3])).max() < 4e-4
    assert _distance_from_line(np.array(arm.targets)[:, :3], start, np.array(target[:3])).max() < 1e-9


def test_movel_keeps_to_its_speed(arm: Arm):
    _movel(arm, arm.offset(0.0, 0.12, 0.0), a=0.5, v=0.1)
    assert arm.until_ready() * 0.002 == pytest.approx(0.12 / 0.1 + 0.1 / 0.5, abs=0.004)
    speeds = np.linalg.norm(np.diff(arm.positions(), axis=0), axis=1) / 0.002
    assert np.median(speeds) == pytest.approx(0.1, rel=0.01)
    assert speeds.max() < 0.105


def test_a_time_takes_precedence(arm: Arm):
    _movel(arm, arm.offset(0.0, 0.05, 0.0), a=0.01, v=0.01, t=0.6)
    assert arm.until_ready() * 0.002 == pytest.approx(0.6, abs=0.004)


def test_a_turn_on_the_spot_keeps_the_tcp_where_it_is(arm: Arm):
    start = arm.plant.tcp_pose()
    _movel(arm, _turned(start, 0.0, 0.15, 0.4))
    arm.until_ready()
    arm.settle()
    assert np.linalg.norm(arm.positions() - start[:3], axis=1).max() < 4e-4
    assert angle_between(start, arm.plant.tcp_pose()) == pytest.approx(np.hypot(0.15, 0.4), abs=1e-4)


@pytest.mark.parametrize(("way", "turn"), [((0.0, 0.1, 0.0), 0.0), ((0.02, 0.04, 0.0), 1.5)])
def test_a_path_is_slowed_down_to_what_the_joints_can_do(arm: Arm, way: tuple[float, ...], turn: float):
    start = np.array(arm.plant.tcp_pose()[:3])
    target = _turned(arm.offset(*way), 0.0, 0.0, turn)
    _movel(arm, target, t=0.02)
    arm.until_ready()
    arm.settle()
    assert arm.motion.fault is None
    assert np.allclose(arm.plant.tcp_pose()[:3], target[:3], atol=5e-5)
    assert angle_between(arm.plant.tcp_pose(), target) < 1e-3
    assert _distance_from_line(np.array(arm.targets)[:, :3], start, np.array(target[:3])).max() < 3e-4
    assert np.abs(np.diff(arm.joints, axis=0) / 0.002 / [np.pi] * [1, 1, 1, 0.5, 0.5, 0.5]).max() < 1.1


def test_linear_moves_blend_within_the_radius(arm: Arm):
    corner, radius = arm.offset(0.0, 0.06, 0.0), 0.02
    end = arm.offset(0.05, 0.06, -0.02)
    _movel(arm, corner, v=0.1, r=radius)
    arm.until_ready()
    assert np.linalg.norm(np.subtract(arm.plant.tcp_pose()[:3], corner[:3])) < radius
    seam = len(arm.poses)
    _movel(arm, end, v=0.1)
    arm.until_ready()
    arm.settle()
    assert np.allclose(arm.plant.tcp_pose()[:3], end[:3], atol=2e-6)
    assert angle_between(arm.plant.tcp_pose(), end) < 1e-5
    speeds = np.linalg.norm(np.diff(arm.positions(), axis=0), axis=1) / 0.002
    assert speeds[seam - 10 : seam + 50].min() > 0.05
    assert speeds.max() < 0.11


def test_a_joint_move_does_not_blend_into_a_linear_one_but_both_arrive(arm: Arm):
    waypoint = (arm.motion.q_target + np.array([0.1, 0, 0, 0, 0, 0.1])).tolist()
    passed = np.array(arm.plant.tcp_pose_of(waypoint)[:3])
    arm.motion.movej(waypoint, 1.4, 1.05, 0.0, 0.02)
    arm.until_ready()
    target = arm.plant.tcp_pose_of(waypoint)
    target[2] -= 0.03
    _movel(arm, target)
    arm.until_ready()
    arm.settle()
    assert np.allclose(arm.plant.tcp_pose()[:3], target[:3], atol=2e-6)
    assert np.linalg.norm(arm.positions() - passed, axis=1).min() < 5e-4


def _on_circle(arm: Arm, angle: float) -> list[float]:
    """A point of the circle of 4 cm that begins at the present target and lies level, turned with it."""
    radius = 0.04
    return arm.offset(radius * np.sin(angle), radius * (1 - np.cos(angle)), 0.0)


@pytest.mark.parametrize("fixed", [False, True])
def test_movec_takes_the_tcp_along_the_arc(arm: Arm, fixed: bool):
    start = arm.plant.tcp_pose()
    centre = np.array(arm.offset(0.0, 0.04, 0.0)[:3])
    via, end = _on_circle(arm, 1.0), _on_circle(arm, 2.5)
    arm.motion.movec(via, end, 1.2, 0.1, 0.0, fixed=fixed)
    arm.until_ready()
    arm.settle()
    reached = arm.plant.tcp_pose()
    assert np.allclose(reached[:3], end[:3], atol=2e-6)
    assert np.abs(np.linalg.norm(arm.positions() - centre, axis=1) - 0.04).max() < 4e-4
    assert np.linalg.norm(arm.positions() - via[:3], axis=1).min() < 5e-4
    expected = _turned(start, 0.0, 0.0, 2.5) if fixed else start
    assert angle_between([0, 0, 0, *expected[3:]], reached) < 1e-4


def test_points_on_one_line_make_no_circle():
    at = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0))
    with pytest.raises(ValueError, match="one line"):
        Arc(at, (0.1, 0.0, 0.0), ((0.2, 0.0, 0.0), at[1]), (0.1, 1.0), 0.0, False, None)


TWIST = [0.02, -0.03, -0.015, 0.1, -0.2, 0.3]


def test_speedl_integrates_its_twist_exactly(arm: Arm):
    start = arm.motion.target_tcp_pose()
    arm.run(400, lambda: arm.motion.speedl(TWIST, FAST, 0.002, FAST))
    reached = arm.motion.target_tcp_pose()
    assert np.allclose(np.subtract(reached[:3], start[:3]), 0.8 * np.array(TWIST[:3]), atol=1e-12)
    turned = rotation_from_rotvec(0.8 * np.array(TWIST[3:])) @ rotation_from_rotvec(start[3:])
    assert np.allclose(rotation_from_rotvec(reached[3:]), turned, atol=1e-12)
    assert np.allclose(arm.motion.target_tcp_speed(), TWIST, atol=1e-15)
    assert np.allclose(arm.plant.tcp_pose_of(arm.motion.q_target), reached, atol=2e-6)


def test_a_speedl_step_is_in_the_target_one_tick_later(arm: Arm):
    position = np.array(arm.motion.target_tcp_pose()[:3])
    for k in range(200):
        twist = [0.03 * np.sin(0.1 * k), 0.02 * np.cos(0.07 * k), -0.01, 0.0, 0.0, 0.0]
        arm.run(1, lambda twist=twist: arm.motion.speedl(twist, FAST, 0.002, FAST))
        position += 0.002 * np.array(twist[:3])
        assert np.allclose(arm.motion.target_tcp_pose()[:3], position, atol=1e-12)


def test_the_arm_follows_speedl(arm: Arm):
    start = np.array(arm.plant.tcp_pose()[:3])
    arm.run(400, lambda: arm.motion.speedl(TWIST, 2.0, 0.002, 10.0))
    assert np.allclose(arm.speed(), TWIST, atol=3e-3)
    arm.settle()
    assert np.allclose(np.array(arm.plant.tcp_pose()[:3]) - start, 0.8 * np.array(TWIST[:3]), atol=5e-4)


def test_speedl_accelerates_at_the_accelerations_asked_for(arm: Arm):
    arm.motion.speedl([0.0, 0.06, -0.08, 0.0, 0.0, 0.5], 0.5, 1.0, 2.0)
    arm.run(50)
    assert np.allclose(arm.motion.target_tcp_speed(), [0.0, 0.03, -0.04, 0.0, 0.0, 0.2], atol=1e-9)
    assert np.allclose(arm.speed(), [0.0, 0.03, -0.04, 0.0, 0.0, 0.2], atol=6e-3)


def test_a_starved_speedl_stops_the_arm(arm: Arm):
    arm.run(100, lambda: arm.motion.speedl([0.0, 0.1, 0.0, 0.0, 0.0, 0.0], 1.0, 0.002, 1.0))
    end = arm.plant.tcp_pose()[1]
    arm.run(51)
    assert not arm.motion.moving
    arm.settle()
    rest = arm.plant.tcp_pose()[1]
    assert np.abs(arm.speed()).max() < 3e-4
    assert rest - end == pytest.approx(0.1**2 / 2, abs=1e-3)
    arm.run(60)
    assert arm.motion.is_steady


def test_a_paused_speedl_has_not_used_up_its_time(arm: Arm):
    arm.motion.speedl([0.0, 0.05, 0.0, 0.0, 0.0, 0.0], 1.0, 0.5, 1.0)
    arm.run(100)
    arm.fraction = 0.0
    arm.run(300)
    assert not arm.motion.moving
    assert not arm.motion.ready
    arm.fraction = 1.0
    arm.run(100)
    assert arm.plant.tcp_speed()[1] == pytest.approx(0.05, abs=1e-3)


@pytest.mark.parametrize("fraction", [0.5, 0.87])
def test_the_speed_slider_stretches_the_time_of_each_step(arm: Arm, fraction: float):
    arm.fraction = arm.motion.speed_fraction = fraction
    start = np.array(arm.motion.target_tcp_pose()[:3])
    ticks = 0
    for _ in range(200):
        arm.motion.speedl([0.0, 0.05, 0.0, 0.0, 0.0, 0.0], FAST, 0.002, FAST)
        ticks += arm.until_ready()
    assert ticks == pytest.approx(200 / fraction, abs=1)
    moved = np.array(arm.motion.target_tcp_pose()[:3]) - start
    assert moved[1] == pytest.approx(0.05 * 0.4, abs=1e-4)
    assert arm.plant.tcp_speed()[1] == pytest.approx(0.05 * fraction, abs=1e-3)


def test_stopl_brakes_along_the_line(arm: Arm):
    start = np.array(arm.plant.tcp_pose()[:3])
    arm.run(200, lambda: arm.motion.speedl([0.05, 0.08, -0.03, 0, 0, 0], 2.0, 0.002, 2.0))
    arm.motion.stopl(0.5, 0.5)
    assert arm.until_ready() * 0.002 == pytest.approx(np.linalg.norm([0.05, 0.08, 0.03]) / 0.5, abs=0.004)
    arm.settle()
    assert np.abs(arm.speed()).max() < 3e-4
    end = start + np.array([0.05, 0.08, -0.03])
    assert _distance_from_line(arm.positions(), start, end).max() < 5e-4


def test_servoc_passes_its_poses_without_a_stop(arm: Arm):
    first, last = arm.offset(0.0, 0.04, 0.0), arm.offset(0.03, 0.07, 0.0)
    arm.motion.servoc(first, 1.2, 0.1, 0.01)
    arm.until_ready()
    arm.motion.servoc(last, 1.2, 0.1, 0.0)
    seam = len(arm.poses)
    arm.until_ready()
    arm.settle()
    assert np.allclose(arm.plant.tcp_pose()[:3], last[:3], atol=1e-5)
    speeds = np.linalg.norm(np.diff(arm.positions(), axis=0), axis=1) / 0.002
    assert speeds[seam - 30 : seam + 60].min() > 0.04
    assert speeds.max() < 0.11


def test_servoc_stops_at_its_last_pose(arm: Arm):
    target = _turned(arm.offset(0.02, 0.03, -0.01), 0.0, 0.0, 0.2)
    arm.motion.servoc(target, 0.8, 0.1, 0.0)
    arm.until_ready()
    arm.settle()
    assert np.allclose(arm.plant.tcp_pose()[:3], target[:3], atol=1e-5)
    assert angle_between(arm.plant.tcp_pose(), target) < 1e-4
    beyond = arm.positions() - target[:3]
    assert (beyond @ np.array([2.0, 3.0, -1.0]) / np.sqrt(14.0)).max() < 2e-4


def test_tool_motions_move_the_configured_tcp(arm: Arm):
    arm.plant.set_tcp([0.0, 0.03, 0.1, 0.0, 0.0, 0.5])
    start = np.array(arm.plant.tcp_pose())
    arm.run(300, lambda: arm.motion.speedl([0.0, 0.0, 0.0, 0.0, 0.0, 0.4], 50.0, 0.002, 50.0))
    arm.settle()
    assert np.linalg.norm(arm.positions() - start[:3], axis=1).max() < 3e-4
    assert angle_between(start.tolist(), arm.plant.tcp_pose()) == pytest.approx(0.24, abs=2e-3)


def test_another_tcp_ends_a_motion_of_the_old_one(arm: Arm):
    _movel(arm, arm.offset(0.0, 0.1, 0.0))
    arm.run(150)
    arm.plant.set_tcp([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    arm.run(100)
    arm.settle()
    assert np.abs(arm.speed()).max() < 3e-4
    assert arm.motion.fault is None
    assert np.allclose(arm.motion.target_tcp_pose()[:3], arm.plant.tcp_pose()[:3], atol=1e-5)


def test_a_pose_out_of_reach_is_a_fault_and_nothing_moves(arm: Arm):
    start = arm.plant.q
    _movel(arm, [10.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    arm.run(20)
    assert "cannot be reached" in (arm.motion.fault or "")
    assert np.abs(arm.plant.q - start).max() < 1e-5


def test_a_stretched_elbow_is_a_fault_and_the_arm_stops(arm: Arm):
    for _ in range(4000):
        arm.run(1, lambda: arm.motion.speedl([0.0, 0.0, 0.1, 0.0, 0.0, 0.0], 1.0, 0.002, 1.0))
        if arm.motion.fault:
            break
    assert arm.motion.fault
    assert abs(arm.plant.q[2]) < 0.6
    stopped = arm.motion.q_target
    arm.run(50)
    assert np.array_equal(arm.motion.q_target, stopped)


def test_the_waypoint_is_where_the_move_ends(arm: Arm):
    target = arm.offset(0.0, 0.05, 0.0)
    _movel(arm, target)
    arm.run(20)
    assert np.allclose(arm.motion.waypoint(), target)
    arm.until_ready()
    joints = (arm.motion.q_target + 0.05).tolist()
    arm.motion.movej(joints, 1.4, 1.05, 0.0, 0.0)
    arm.run(2)
    assert np.allclose(arm.motion.waypoint(), arm.plant.tcp_pose_of(joints))
