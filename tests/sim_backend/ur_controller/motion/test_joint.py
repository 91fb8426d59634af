import numpy as np
import pytest

from .conftest import Arm

A, V = 1.4, 1.05
STEADY = 60
AWAY = np.array([0.3, -0.2, -0.1, 0.2, 0.1, 0.4])


def _away(arm: Arm, change: np.ndarray = AWAY) -> list[float]:
    return (arm.motion.q_target + change).tolist()


def _movej(arm: Arm, target: list[float], *, a: float = A, v: float = V, t: float = 0.0, r: float = 0.0) -> None:
    arm.motion.movej(target, a, v, t, r)


def test_movej_takes_the_arm_straight_to_the_joints_asked_for(arm: Arm):
    start, target = arm.plant.q, _away(arm, 0.5 * AWAY)
    _movej(arm, target)
    arm.until_ready()
    arm.settle()
    assert np.allclose(arm.plant.q, target, atol=1e-5)
    travelled = np.array(arm.joints) - start
    share = travelled[:, 5] / (target[5] - start[5])
    assert np.allclose(travelled, share[:, None] * (target - start), atol=1.5e-3)


def test_movej_takes_the_time_of_the_leading_axis_trapezoid(arm: Arm):
    _movej(arm, _away(arm), a=2.0, v=0.5)
    assert arm.until_ready() * 0.002 == pytest.approx(0.5 / 2.0 + 0.4 / 0.5, abs=0.004)
    fastest = np.abs(np.diff(arm.joints, axis=0)).max() / 0.002
    assert fastest == pytest.approx(0.5, rel=0.02)


def test_a_time_takes_precedence(arm: Arm):
    _movej(arm, _away(arm), a=0.01, v=0.01, t=0.8)
    assert arm.until_ready() * 0.002 == pytest.approx(0.8, abs=0.004)


def test_the_speed_slider_stretches_the_same_path(arm: Arm):
    target = _away(arm, 0.5 * AWAY)
    _movej(arm, target, t=0.5)
    arm.fraction = arm.motion.speed_fraction = 0.25
    assert arm.until_ready() * 0.002 == pytest.approx(2.0, abs=0.01)
    arm.settle()
    assert np.allclose(arm.plant.q, target, atol=1e-5)


def test_a_paused_move_rests_and_goes_on_to_its_end(arm: Arm):
    target = _away(arm, 0.5 * AWAY)
    _movej(arm, target, t=0.5)
    arm.run(100)
    arm.fraction = 0.0
    arm.run(150)
    paused = arm.plant.q
    arm.run(100)
    assert np.abs(arm.plant.q - paused).max() < 1e-5
    assert np.abs(arm.plant.q - target).max() > 0.02
    arm.fraction = 1.0
    arm.until_ready()
    arm.settle()
    assert np.allclose(arm.plant.q, target, atol=1e-5)


def test_a_blend_passes_its_waypoint_without_a_stop(arm: Arm):
    first, second = _away(arm, np.array([0.2, 0, 0, 0, 0, 0])), _away(arm, np.array([0.2, 0, 0, 0, 0.3, 0.2]))
    corner, radius = np.array(arm.plant.tcp_pose_of(first)[:3]), 0.03
    _movej(arm, first, r=radius)
    arm.until_ready()
    assert np.linalg.norm(arm.positions()[-1] - corner) < radius
    seam = len(arm.joints)
    _movej(arm, second)
    arm.until_ready()
    arm.settle()
    assert np.allclose(arm.plant.q, second, atol=1e-5)
    speeds = np.abs(np.diff(arm.joints, axis=0)).max(axis=1) / 0.002
    assert speeds[seam - 20 : seam + 60].min() > 0.3
    assert 1e-3 < np.linalg.norm(arm.positions() - corner, axis=1).min() < radius


def test_a_blend_into_the_same_direction_keeps_the_speed(arm: Arm):
    step = np.array([0.2, 0, 0, 0, 0, 0])
    first, second = _away(arm, step), _away(arm, 2 * step)
    _movej(arm, first, v=0.4, r=0.05)
    arm.until_ready()
    _movej(arm, second, v=0.4)
    arm.until_ready()
    assert np.abs(np.diff(arm.joints, axis=0)).max() / 0.002 < 0.41
    arm.settle()
    assert np.allclose(arm.plant.q, second, atol=1e-5)


def test_a_move_out_of_another_motion_begins_at_rest(arm: Arm):
    arm.run(50, lambda: arm.motion.speedj([0, 0, 0, 0, 0, 0.5], 5.0, 0.002))
    target = _away(arm, np.array([0.1, 0, 0, 0, 0, 0]))
    _movej(arm, target)
    assert not arm.motion.ready
    arm.until_ready()
    arm.settle()
    assert np.allclose(arm.plant.q, target, atol=1e-5)


def test_no_joint_is_asked_to_be_faster_than_it_can(arm: Arm):
    _movej(arm, _away(arm, np.array([0.9, 0, 0, 0, 0, 1.0])), a=30.0, v=6.0)
    arm.until_ready()
    fastest = np.abs(np.diff(arm.joints, axis=0)[:, 0]).max() / 0.002
    assert fastest == pytest.approx(np.pi, rel=0.06)  # the arm swings past a little where its target stops accelerating


def test_a_time_that_is_too_short_does_not_tear_the_arm_from_its_path(arm: Arm):
    target = _away(arm, np.array([0.5, 0, 0, 0, 0.2, 1.0]))
    _movej(arm, target, t=0.02)
    behind = 0.0
    while not arm.motion.ready:
        arm.run(1)
        behind = max(behind, np.abs(arm.plant.q - arm.motion.q_target).max())
    assert behind < 0.04
    arm.settle()
    assert np.allclose(arm.plant.q, target, atol=1e-4)


def test_speedj_accelerates_the_leading_axis_and_keeps_the_proportions(arm: Arm):
    arm.motion.speedj([0.2, 0, 0, 0, 0, -0.4], 0.8, 1.0)
    arm.run(125)
    arm.run(1)
    assert np.allclose(arm.plant.qd, [0.1, 0, 0, 0, 0, -0.2], atol=4e-3)
    arm.run(374)
    assert arm.motion.ready
    assert np.allclose(arm.plant.qd, [0.2, 0, 0, 0, 0, -0.4], atol=4e-3)


def test_a_speed_whose_time_is_over_comes_to_rest_by_itself(arm: Arm):
    arm.motion.speedj([0, 0, 0, 0, 0, 0.4], 2.0, 0.3)
    assert arm.until_ready() == 150
    arm.run(100 + 10)
    assert not arm.motion.moving
    arm.settle()
    assert np.abs(arm.plant.qd).max() < 1e-4
    arm.run(STEADY)
    assert arm.motion.is_steady


def test_a_speed_without_a_time_is_kept_until_there_is_another_command(arm: Arm):
    arm.motion.speedj([0, 0, 0, 0, 0, 0.4], 2.0, 0.0)
    assert arm.until_ready() == 100
    arm.run(200)
    assert arm.plant.qd[5] == pytest.approx(0.4, abs=1e-3)
    arm.motion.stopj(4.0)
    assert arm.until_ready() == 50
    arm.settle()
    assert np.abs(arm.plant.qd).max() < 1e-4


def test_hold_brings_any_motion_to_rest(arm: Arm):
    _movej(arm, _away(arm))
    arm.run(200)
    arm.motion.hold()
    arm.run(100)
    arm.settle()
    rest = arm.plant.q
    arm.run(100)
    assert np.abs(arm.plant.q - rest).max() < 1e-5
    assert not arm.motion.moving


def test_freeze_takes_the_measured_joints_at_once(arm: Arm):
    _movej(arm, _away(arm))
    arm.run(200)
    measured = arm.plant.q
    arm.motion.freeze()
    assert np.array_equal(arm.motion.q_target, measured)
    assert not arm.motion.moving


@pytest.mark.parametrize(("lookahead", "gain"), [(0.03, 1200.0), (0.1, 300.0)])
def test_servoj_lags_a_moving_set_point_by_its_lookahead(arm: Arm, lookahead: float, gain: float):
    speed, target = 0.2, arm.motion.q_target.tolist()

    def servo() -> None:
        target[5] += speed * 0.002
        arm.motion.servoj(target, 0.002, lookahead, gain)

    arm.run(600, servo)
    assert (target[5] - arm.plant.q[5]) / speed == pytest.approx(lookahead, abs=0.004)
    assert not arm.motion.is_steady


def test_servoj_ends_at_its_last_set_point(arm: Arm):
    target = _away(arm, np.array([0.02, 0, 0, 0, 0, 0.05]))
    arm.motion.servoj(target, 0.002, 0.1, 300.0)
    arm.run(1500)
    assert np.allclose(arm.plant.q, target, atol=1e-5)
    assert arm.motion.is_steady


def test_a_higher_gain_follows_a_jump_sooner(arm: Arm):
    def travelled(gain: float) -> float:
        arm.plant.place((0.28, -0.11, 0.15))
        start = arm.plant.q[5]
        target = _away(arm, np.array([0, 0, 0, 0, 0, 0.05]))
        arm.run(25, lambda: arm.motion.servoj(target, 0.002, 0.1, gain))
        return arm.plant.q[5] - start

    assert travelled(2000.0) > 1.2 * travelled(300.0) > 0.0


def test_the_end_of_a_joint_s_range_is_a_fault(arm: Arm):
    _movej(arm, _away(arm, np.array([0, 0, 0, 0, 8.0, 0])), a=20.0, v=6.0)
    for _ in range(2000):
        arm.run(1)
        if arm.motion.fault:
            break
    assert arm.motion.fault == "joint 5 is at the end of its range"
    assert arm.plant.q[4] < 2 * np.pi + 0.1
