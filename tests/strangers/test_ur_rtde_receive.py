"""`RTDEReceiveInterface` of ur_rtde reads what the world holds, every 2 ms."""

import csv
import time
from pathlib import Path

import numpy as np
import pytest
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

from sim_backend.world import scene
from tests.strangers.emulated_robot import EmulatedRobot, until
from wire.pose import rotation_from_rotvec


def test_ticks_arrive_on_the_grid_of_two_milliseconds(robot: EmulatedRobot, tmp_path: Path) -> None:
    client = RTDEReceiveInterface(robot.host)
    recording = tmp_path / "ticks.csv"
    try:
        assert client.startFileRecording(str(recording), ["timestamp", "actual_q"])
        time.sleep(0.6)
        assert client.stopFileRecording()
    finally:
        client.disconnect()
    with recording.open() as lines:
        times = np.array([float(row["timestamp"]) for row in csv.DictReader(lines)])
    ticks = times / 0.002
    np.testing.assert_allclose(ticks, np.round(ticks), atol=1e-3)
    steps = np.diff(np.round(ticks))
    assert (steps >= 0).all()
    assert np.count_nonzero(steps == 1) > 10  # its recorder samples by a clock of its own


def test_an_arm_at_rest_reads_as_it_stands(
    robot: EmulatedRobot, control: RTDEControlInterface, receive: RTDEReceiveInterface
) -> None:
    time.sleep(0.1)
    truth = robot.truth()
    np.testing.assert_allclose(receive.getActualQ(), truth.q, atol=1e-4)
    np.testing.assert_allclose(receive.getActualQd(), truth.qd, atol=5e-3)
    pose = np.array(receive.getActualTCPPose())
    np.testing.assert_allclose(pose[:3], truth.position, atol=1e-4)
    np.testing.assert_allclose(rotation_from_rotvec(pose[3:]), truth.rotation, atol=1e-4)
    np.testing.assert_allclose(receive.getTargetQ(), truth.q, atol=5e-3)
    np.testing.assert_allclose(receive.getTargetTCPPose()[:3], truth.position, atol=2e-3)
    assert receive.getTargetQd() == receive.getTargetQdd() == receive.getTargetTCPSpeed() == [0.0] * 6
    assert np.abs(receive.getActualTCPSpeed()).max() < 5e-3
    assert receive.getPayload() == pytest.approx(scene.PAYLOAD_KG)
    assert receive.getPayloadCog() == pytest.approx([0.0, 0.0, scene.PAYLOAD_COM_M])
    assert len(receive.getPayloadInertia()) == 6
    weight = np.linalg.norm(receive.getFtRawWrench()[:3])
    assert weight == pytest.approx(scene.PAYLOAD_KG * 9.81, abs=8.0)  # not compensated, and with the sensor's bias


def test_the_controllers_state_is_told_in_its_own_numbers(
    robot: EmulatedRobot, control: RTDEControlInterface, receive: RTDEReceiveInterface
) -> None:
    assert receive.getRobotMode() == 7
    assert receive.getSafetyMode() == 1
    assert receive.getSafetyStatusBits() == 1
    assert receive.getRuntimeState() == 2
    assert receive.getRobotStatus() & 0b11 == 0b11
    assert receive.getJointMode() == [253] * 6
    assert not receive.isProtectiveStopped()
    assert not receive.isEmergencyStopped()
    assert receive.getSpeedScaling() == pytest.approx(1.0)
    assert receive.getTargetSpeedFraction() == pytest.approx(1.0)
    assert receive.getSpeedScalingCombined() == pytest.approx(1.0)


def test_what_has_no_place_in_the_world_is_told_as_plausible_figures(
    robot: EmulatedRobot, receive: RTDEReceiveInterface
) -> None:
    assert receive.getActualMainVoltage() == pytest.approx(48.0, abs=5.0)
    assert receive.getActualRobotVoltage() == pytest.approx(48.0, abs=5.0)
    assert 0.0 <= receive.getActualRobotCurrent() < 10.0
    assert all(15.0 < t < 70.0 for t in receive.getJointTemperatures())
    assert all(v == pytest.approx(48.0, abs=5.0) for v in receive.getActualJointVoltage())
    acceleration = np.linalg.norm(receive.getActualToolAccelerometer())
    assert acceleration == pytest.approx(9.81, abs=0.5)
    for six in (
        receive.getActualCurrent(),
        receive.getTargetCurrent(),
        receive.getTargetMoment(),
        receive.getJointControlOutput(),
    ):
        assert len(six) == 6
        assert np.isfinite(six).all()
    assert 0.0 <= receive.getActualExecutionTime() < 100.0
    assert receive.getActualMomentum() >= 0.0


def test_a_moving_arm_reads_as_it_moves(
    robot: EmulatedRobot, control: RTDEControlInterface, receive: RTDEReceiveInterface
) -> None:
    assert control.speedL([0.0, 0.04, 0.0, 0.0, 0.0, 0.1], 0.5)
    time.sleep(0.4)
    truth, told, target = robot.truth(), receive.getActualTCPSpeed(), receive.getTargetTCPSpeed()
    q, qd, later = receive.getActualQ(), receive.getActualQd(), robot.truth()
    assert control.speedStop()
    np.testing.assert_allclose(told, truth.twist, atol=5e-3)
    np.testing.assert_allclose(target, [0.0, 0.04, 0.0, 0.0, 0.0, 0.1], atol=1e-4)
    np.testing.assert_allclose(qd, truth.qd, atol=1e-2)
    for joint in range(6):
        low, high = sorted((truth.q[joint], later.q[joint]))
        assert low - 1e-3 <= q[joint] <= high + 1e-3


def test_a_client_chooses_its_variables_and_its_rate(robot: EmulatedRobot) -> None:
    clients = [RTDEReceiveInterface(robot.host, rate, ["timestamp", "actual_q"]) for rate in (500.0, 125.0, 10.0)]
    try:
        for client in clients:
            assert client.isConnected()
            first = client.getTimestamp()
            assert until(lambda client=client, first=first: client.getTimestamp() > first)
            np.testing.assert_allclose(client.getActualQ(), robot.truth().q, atol=1e-3)
    finally:
        for client in clients:
            client.disconnect()


def test_a_client_reconnects(robot: EmulatedRobot) -> None:
    client = RTDEReceiveInterface(robot.host)
    try:
        client.disconnect()
        assert not client.isConnected()
        assert client.reconnect()
        first = client.getTimestamp()
        assert until(lambda: client.getTimestamp() > first)
    finally:
        client.disconnect()


def test_a_variable_that_does_not_exist_is_refused_by_name(robot: EmulatedRobot) -> None:
    with pytest.raises(RuntimeError, match="no_such_variable"):
        RTDEReceiveInterface(robot.host, 500.0, ["timestamp", "no_such_variable"])
