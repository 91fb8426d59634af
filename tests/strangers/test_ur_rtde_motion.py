"""`RTDEControlInterface` of ur_rtde moves the emulated arm; what moved is judged in the world."""

import time
from itertools import pairwise
from pathlib import Path as FilePath

import numpy as np
import numpy.typing as npt
import pytest
from rtde_control import Path, PathEntry, RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

from tests.strangers.emulated_robot import EmulatedRobot, Recording, plus, until
from wire.arrays import FloatArray
from wire.pose import rotation_from_rotvec, rotvec_from_rotation

TICK_S = 0.002
SERVO = (0.0, 0.0, TICK_S, 0.05, 500.0)
"""Speed and acceleration (without effect), time, look-ahead and gain of a servo command."""


def pose_of(robot: EmulatedRobot) -> FloatArray:
    truth = robot.truth()
    return np.concatenate([truth.position, rotvec_from_rotation(truth.rotation)])


def assert_pose(robot: EmulatedRobot, pose: npt.ArrayLike, tolerance_m: float = 1e-3) -> None:
    truth, pose = robot.truth(), np.asarray(pose)
    np.testing.assert_allclose(truth.position, pose[:3], atol=tolerance_m)
    turn = rotation_from_rotvec(pose[3:]).T @ truth.rotation
    assert np.linalg.norm(rotvec_from_rotation(turn)) < 5e-3


def flange_of(control: RTDEControlInterface) -> FloatArray:
    """The flange's pose; this client reads the answer before it can have come, so that the first one is an old one."""
    control.getActualToolFlangePose()
    time.sleep(0.05)
    return np.array(control.getActualToolFlangePose())


def from_line(recording: Recording) -> float:
    """Greatest distance of the path from the straight line between its ends, m."""
    start, end = recording.position[0], recording.position[-1]
    along = (end - start) / np.linalg.norm(end - start)
    offset = recording.position - start
    return float(np.linalg.norm(offset - np.outer(offset @ along, along), axis=1).max())


def test_movej_takes_the_joints_to_their_target_at_the_speed_asked(
    robot: EmulatedRobot, control: RTDEControlInterface
) -> None:
    target = plus(robot.truth().q, 0.3, 0.1, -0.1, 0.2, -0.2, 0.6)
    with robot.recording() as recorded:
        assert control.moveJ(target, 1.0, 2.0)
        path = recorded()
    assert robot.is_at_rest()
    np.testing.assert_allclose(robot.truth().q, target, atol=2e-3)
    fastest = np.abs(path.qd).max(axis=0)
    assert fastest[5] == pytest.approx(1.0, rel=0.05)
    assert fastest[0] == pytest.approx(0.5, rel=0.1)  # all joints arrive together


def test_movel_follows_a_straight_line_at_the_speed_asked(robot: EmulatedRobot, control: RTDEControlInterface) -> None:
    pose = plus(pose_of(robot), 0.06, 0.05, 0.03, 0.0, 0.0, 0.0)
    with robot.recording() as recorded:
        assert control.moveL(pose, 0.1, 0.8)
        path = recorded()
    assert_pose(robot, pose)
    assert from_line(path) < 1e-3
    assert np.median(path.speed[path.speed > 0.08]) == pytest.approx(0.1, rel=0.05)


def test_movej_ik_and_movel_fk_accept_the_other_kind_of_target(
    robot: EmulatedRobot, control: RTDEControlInterface
) -> None:
    pose = plus(pose_of(robot), 0.0, 0.05, 0.02, 0.0, 0.0, 0.0)
    joints = robot.truth().q
    assert control.moveJ_IK(pose, 1.0, 2.0)
    assert_pose(robot, pose)
    with robot.recording() as recorded:
        assert control.moveL_FK(joints, 0.1, 0.8)
        path = recorded()
    np.testing.assert_allclose(robot.truth().q, joints, atol=2e-3)
    assert from_line(path) < 1e-3


@pytest.mark.parametrize("asynchronous", [False, True])
def test_stopj_ends_an_asynchronous_movej_before_its_target(
    robot: EmulatedRobot, control: RTDEControlInterface, asynchronous: bool
) -> None:
    start = robot.truth().q
    target = plus(start, 0.8, 0.0, 0.0, 0.0, 0.0, 0.0)
    control.moveJ(target, 0.6, 1.5, True)
    assert until(lambda: bool(robot.truth().qd[0] > 0.3))
    assert control.getAsyncOperationProgressEx().isAsyncOperationRunning()
    control.stopJ(3.0, asynchronous)
    assert until(lambda: not control.getAsyncOperationProgressEx().isAsyncOperationRunning())
    assert robot.is_at_rest()
    assert 0.03 < robot.truth().q[0] - start[0] < 0.6


def test_stopl_ends_an_asynchronous_movel_before_its_target(
    robot: EmulatedRobot, control: RTDEControlInterface
) -> None:
    start = pose_of(robot)
    control.moveL(plus(start, 0.0, 0.15, 0.0, 0.0, 0.0, 0.0), 0.1, 0.5, True)
    assert until(lambda: bool(robot.truth().twist[1] > 0.08))
    control.stopL(1.0)
    assert robot.is_at_rest()
    moved = robot.truth().position - start[:3]
    assert 0.005 < moved[1] < 0.1
    assert np.abs(moved[[0, 2]]).max() < 1e-3


def test_an_asynchronous_move_reports_its_end(robot: EmulatedRobot, control: RTDEControlInterface) -> None:
    pose = plus(pose_of(robot), 0.02, 0.0, 0.0, 0.0, 0.0, 0.0)
    before = control.getAsyncOperationProgressEx().operationId()
    control.moveL(pose, 0.1, 1.0, True)
    assert until(lambda: control.getAsyncOperationProgressEx().operationId() != before)
    assert until(lambda: control.getAsyncOperationProgress() < 0)
    assert_pose(robot, pose)


def test_a_path_of_moves_blends_past_its_corner(robot: EmulatedRobot, control: RTDEControlInterface) -> None:
    start = pose_of(robot)
    corner, end = plus(start, 0.05, 0, 0, 0, 0, 0), plus(start, 0.05, 0.05, 0, 0, 0, 0)
    path = Path()
    kinds = PathEntry.MoveL, PathEntry.PositionTcpPose
    path.addEntry(PathEntry(*kinds, [*corner, 0.1, 1.0, 0.015]))
    path.addEntry(PathEntry(*kinds, [*end, 0.1, 1.0, 0.0]))
    with robot.recording() as recorded:
        assert control.movePath(path)
        moved = recorded()
    assert_pose(robot, end)
    passed = np.linalg.norm(moved.position - corner[:3], axis=1).min()
    assert 1e-3 < passed < 0.015
    nearest = int(np.linalg.norm(moved.position - corner[:3], axis=1).argmin())
    assert moved.speed[nearest - 5 : nearest + 5].min() > 0.03


def test_movej_along_a_list_of_joints(robot: EmulatedRobot, control: RTDEControlInterface) -> None:
    start = robot.truth().q
    waypoints = [plus(start, 0.1, 0, 0, 0, 0, 0), plus(start, 0.1, 0, 0, 0, 0, 0.2)]
    with robot.recording() as recorded:
        assert control.moveJ([[*q, 1.0, 2.0, 0.0] for q in waypoints])
        path = recorded()
    np.testing.assert_allclose(robot.truth().q, waypoints[1], atol=2e-3)
    assert np.abs(path.q - waypoints[0]).max(axis=1).min() < 3e-3


def test_servoj_follows_a_streamed_joint_trajectory(robot: EmulatedRobot, control: RTDEControlInterface) -> None:
    start = robot.truth().q
    with robot.recording() as recorded:
        for step in range(300):
            began = control.initPeriod()
            lift = 0.1 * (1 - np.cos(2 * np.pi * step / 300)) / 2
            assert control.servoJ(plus(start, 0, 0, 0, 0, 0, lift), *SERVO)
            control.waitPeriod(began)
        path = recorded()
    assert control.servoStop()
    assert robot.is_at_rest()
    assert path.q[:, 5].max() - start[5] == pytest.approx(0.1, abs=0.01)
    np.testing.assert_allclose(robot.truth().q[:5], start[:5], atol=2e-3)
    assert abs(robot.truth().q[5] - start[5]) < 0.01


def test_servol_follows_a_streamed_pose(robot: EmulatedRobot, control: RTDEControlInterface) -> None:
    start = pose_of(robot)
    for step in range(1, 301):
        began = control.initPeriod()
        assert control.servoL(plus(start, 0, 0.04 * step / 300, 0, 0, 0, 0), *SERVO)
        control.waitPeriod(began)
    assert until(lambda: bool(np.abs(robot.truth().position - start[:3] - [0, 0.04, 0]).max() < 1e-3))
    assert control.servoStop()
    assert_pose(robot, plus(start, 0, 0.04, 0, 0, 0, 0), 2e-3)


def test_speedl_moves_the_tcp_with_the_twist_asked(robot: EmulatedRobot, control: RTDEControlInterface) -> None:
    start = robot.truth().position
    assert control.speedL([0.0, 0.03, 0.02, 0.0, 0.0, 0.1], 0.5)
    time.sleep(0.5)
    truth = robot.truth()
    np.testing.assert_allclose(truth.twist, [0.0, 0.03, 0.02, 0.0, 0.0, 0.1], atol=2e-3)
    assert control.speedStop()
    assert robot.is_at_rest()
    assert robot.truth().position[1] - start[1] > 0.01


def test_speedl_for_a_time_comes_to_an_end_when_not_renewed(
    robot: EmulatedRobot, control: RTDEControlInterface
) -> None:
    assert control.speedL([0.0, 0.02, 0.0, 0.0, 0.0, 0.0], 0.5, 0.1)
    assert until(lambda: bool(robot.truth().twist[1] > 0.019))
    assert control.speedStop()
    assert robot.is_at_rest()


def test_speedj_moves_the_joints_with_the_speeds_asked(robot: EmulatedRobot, control: RTDEControlInterface) -> None:
    assert control.speedJ([0.0, 0.0, 0.0, 0.05, 0.0, 0.2], 0.5)
    time.sleep(0.6)
    np.testing.assert_allclose(robot.truth().qd, [0.0, 0.0, 0.0, 0.05, 0.0, 0.2], atol=5e-3)
    assert control.speedStop()
    assert robot.is_at_rest()


def test_jogging_moves_along_the_feature_asked(robot: EmulatedRobot, control: RTDEControlInterface) -> None:
    assert control.jogStart([0.0, 0.0, 0.02, 0.0, 0.0, 0.0], RTDEControlInterface.FEATURE_BASE)
    assert until(lambda: bool(robot.truth().twist[2] > 0.018))
    assert control.jogStop()
    assert robot.is_at_rest()
    assert control.jogStart([0.0, 0.0, 0.02, 0.0, 0.0, 0.0], RTDEControlInterface.FEATURE_TOOL)
    assert until(lambda: bool(robot.truth().twist[2] < -0.018))  # the tool's z axis points down
    assert control.jogStop()
    assert robot.is_at_rest()


def test_freedrive_lets_the_arm_stand_and_tells_so(robot: EmulatedRobot, control: RTDEControlInterface) -> None:
    start = robot.truth().q
    assert control.freedriveMode()
    assert control.getFreedriveStatus() == 0
    assert control.endFreedriveMode()
    assert control.teachMode()
    assert control.endTeachMode()
    assert np.abs(robot.truth().q - start).max() < 0.01


def test_the_speed_slider_slows_a_move(robot: EmulatedRobot, control: RTDEControlInterface) -> None:
    robot.call("set_speed_slider", 0.5)
    try:
        pose = plus(pose_of(robot), 0.0, 0.03, 0.0, 0.0, 0.0, 0.0)
        with robot.recording() as recorded:
            assert control.moveL(pose, 0.1, 1.0)
            path = recorded()
    finally:
        robot.call("set_speed_slider", 1.0)
    assert_pose(robot, pose)
    assert path.speed.max() == pytest.approx(0.05, rel=0.1)


def test_kinematics_agree_with_the_world(robot: EmulatedRobot, control: RTDEControlInterface) -> None:
    truth, pose = robot.truth(), pose_of(robot)
    here = np.array(control.getForwardKinematics())
    np.testing.assert_allclose(here[:3], truth.position, atol=1e-4)
    offset = np.array(control.getTCPOffset())
    q = plus(truth.q, 0.2, -0.1, 0.1, 0.0, 0.0, 0.0)
    there = control.getForwardKinematics(q, offset.tolist())
    np.testing.assert_allclose(control.getInverseKinematics(there, q), q, atol=1e-6)
    assert control.getInverseKinematicsHasSolution(there)
    assert not control.getInverseKinematicsHasSolution([2.0, 0.0, 0.2, 0.0, 3.14, 0.0])
    near = control.getInverseKinematics(pose)
    np.testing.assert_allclose(near, truth.q, atol=1e-3)
    flange = flange_of(control)
    down = rotation_from_rotvec(flange[3:]) @ offset[:3]
    np.testing.assert_allclose(flange[:3] + down, truth.position, atol=1e-4)
    np.testing.assert_allclose(
        control.poseTrans([0.1, 0.2, 0.3, 0.0, 0.0, np.pi / 2], [0.1, 0.0, 0.0, 0.0, 0.0, 0.0]),
        [0.1, 0.3, 0.3, 0.0, 0.0, np.pi / 2],
        atol=1e-9,
    )


def test_safety_limits_tell_what_is_within_reach(robot: EmulatedRobot, control: RTDEControlInterface) -> None:
    assert control.isPoseWithinSafetyLimits(pose_of(robot))
    assert not control.isPoseWithinSafetyLimits([3.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    q = robot.truth().q
    assert control.isJointsWithinSafetyLimits(q)
    assert not control.isJointsWithinSafetyLimits([7.0, *q[1:].tolist()])


def test_what_the_controller_tells_of_itself(robot: EmulatedRobot, control: RTDEControlInterface) -> None:
    assert until(lambda: control.getStepTime() == pytest.approx(TICK_S))
    assert until(control.isSteady)
    assert control.isProgramRunning()
    assert control.getRobotStatus() & 0b11 == 0b11  # powered, a program runs
    target = plus(pose_of(robot), 0.0, 0.02, 0.0, 0.0, 0.0, 0.0)
    assert control.moveL(target, 0.1, 1.0)
    np.testing.assert_allclose(control.getTargetWaypoint()[:3], target[:3], atol=1e-6)
    assert until(lambda: np.abs(control.getActualJointPositionsHistory(0) - robot.truth().q).max() < 1e-4)


def test_the_controller_remembers_where_the_joints_were(robot: EmulatedRobot, control: RTDEControlInterface) -> None:
    assert control.speedJ([0.0, 0.0, 0.0, 0.0, 0.0, 0.4], 2.0)
    time.sleep(0.6)
    control.getActualJointPositionsHistory(100)
    time.sleep(0.05)
    earlier, truth = control.getActualJointPositionsHistory(100), robot.truth()
    assert control.speedStop()
    assert truth.q[5] - earlier[5] == pytest.approx(100 * TICK_S * 0.4, abs=0.02)


def test_a_tcp_that_is_configured_changes_what_is_measured_and_where_moves_go(
    robot: EmulatedRobot, control: RTDEControlInterface, receive: RTDEReceiveInterface
) -> None:
    scene = control.getTCPOffset()
    before = robot.truth()
    try:
        assert control.setTcp([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
        flange = flange_of(control)
        expected = flange[:3] + 0.1 * before.rotation[:, 2]
        assert until(lambda: bool(np.abs(np.array(receive.getActualTCPPose()[:3]) - expected).max() < 1e-4))
        pose = np.array(receive.getTargetTCPPose())
        turn = rotation_from_rotvec([0.0, 0.2, 0.0]) @ before.rotation
        pose[3:] = rotvec_from_rotation(turn)
        assert control.moveL(pose, 0.1, 0.5)
        truth = robot.truth()
        tip = truth.position + (0.1 - scene[2]) * truth.rotation[:, 2]
        np.testing.assert_allclose(tip, expected, atol=1e-3)  # turned about the new TCP, which stayed
        assert np.linalg.norm(truth.position - before.position) > 0.01
    finally:
        control.setTcp(scene)


def test_a_function_of_the_users_own_runs_on_the_controller(
    robot: EmulatedRobot, control: RTDEControlInterface, receive: RTDEReceiveInterface
) -> None:
    assert control.sendCustomScriptFunction("answer", "write_output_integer_register(13, 42)\n")
    assert until(lambda: robot.get("output_registers.ints")[13] == 42)
    assert until(lambda: receive.getOutputIntRegister(13) == 42)
    start = robot.truth().q
    assert control.moveJ(plus(start, 0, 0, 0, 0, 0, 0.1), 1.0, 2.0)
    assert robot.truth().q[5] - start[5] == pytest.approx(0.1, abs=2e-3)


def test_a_script_file_of_the_users_own_moves_the_arm(
    robot: EmulatedRobot, control: RTDEControlInterface, tmp_path: FilePath
) -> None:
    """The client waits for 2 in output register 0, and uploads its own script again."""
    script = tmp_path / "turn.script"
    script.write_text(
        "def turn():\n"
        "  local q = get_actual_joint_positions()\n"
        "  q[5] = q[5] + 0.15\n"
        "  movej(q, a=2, v=1)\n"
        "  write_output_integer_register(0, 2)\n"
        "end\n"
    )
    start = robot.truth().q
    assert control.sendCustomScriptFile(str(script))
    assert until(lambda: abs(robot.truth().q[5] - start[5] - 0.15) < 2e-3)
    assert control.isProgramRunning()


def test_settings_reach_the_controller(robot: EmulatedRobot, control: RTDEControlInterface) -> None:
    assert control.forceModeSetDamping(0.1)
    assert control.forceModeSetGainScaling(1.5)
    assert robot.get("motion.force_damping") == pytest.approx(0.1)
    assert robot.get("motion.force_gain") == pytest.approx(1.5)
    assert control.setGravity([0.0, 0.0, 9.5])
    assert robot.get("gravity") == [0.0, 0.0, 9.5]
    assert control.setGravity([0.0, 0.0, 9.82])


def test_a_package_that_does_not_fit_its_recipe_does_no_harm(
    robot: EmulatedRobot, control: RTDEControlInterface
) -> None:
    """This version of the client sends the external wrench under the number of another recipe."""
    start = robot.truth().q
    assert control.setExternalForceTorque([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    assert control.moveJ(plus(start, 0, 0, 0, 0, 0, 0.1), 1.0, 2.0)
    assert robot.truth().q[5] - start[5] == pytest.approx(0.1, abs=2e-3)


def test_a_client_that_comes_back_is_served(robot: EmulatedRobot, control: RTDEControlInterface) -> None:
    control.disconnect()
    assert control.reconnect()
    start = robot.truth().q
    for sign in (1, -1):
        assert control.moveJ(plus(start, 0, 0, 0, 0, 0, 0.05 * (sign > 0)), 1.0, 2.0)
    np.testing.assert_allclose(robot.truth().q, start, atol=2e-3)


def test_many_short_commands_in_a_row_all_arrive(robot: EmulatedRobot, control: RTDEControlInterface) -> None:
    poses = [plus(pose_of(robot), 0.002 * k, 0, 0, 0, 0, 0) for k in (1, 2, 3, 4, 5)]
    for pose, following in pairwise(poses):
        assert control.moveL(pose, 0.2, 2.0)
        assert control.getInverseKinematicsHasSolution(following)
        assert_pose(robot, pose)
