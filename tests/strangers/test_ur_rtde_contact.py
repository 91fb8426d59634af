"""`RTDEControlInterface` of ur_rtde in contact: the force is what the physics solved, not what a sensor told."""

import time
from collections.abc import Iterator

import numpy as np
import pytest
from dashboard_client import DashboardClient
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

from tests.strangers.emulated_robot import EmulatedRobot, plus, reupload, until

BASE = [0.0] * 6
LIMITS = [0.1, 0.1, 0.05, 0.5, 0.5, 0.5]
"""Speeds along compliant axes, deviations along the others."""
GRAVITY_M_S2 = 9.81


@pytest.fixture
def dashboard(robot: EmulatedRobot) -> Iterator[DashboardClient]:
    client = DashboardClient(robot.host)
    client.connect()
    yield client
    client.disconnect()


@pytest.fixture
def above_block(robot: EmulatedRobot, control: RTDEControlInterface) -> RTDEControlInterface:
    """The peg 10 mm above the block's top, beside the hole, sensor zeroed."""
    robot.place_over_the_block(0.010)
    assert robot.is_at_rest()
    assert control.zeroFtSensor()
    return control


def mean_contact(robot: EmulatedRobot, seconds: float = 0.3) -> np.ndarray:
    """(3,) contact force on the peg, averaged."""
    samples = []
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        samples.append(robot.truth().contact)
        time.sleep(0.005)
    return np.mean(samples, axis=0)


def mean_force(receive: RTDEReceiveInterface) -> np.ndarray:
    """(3,) force that the sensor reads, averaged."""
    return np.mean([receive.getActualTCPForce()[:3] for _ in range(50) if not time.sleep(0.004)], axis=0)


def test_force_mode_lowers_the_peg_and_presses_with_the_force_asked(
    robot: EmulatedRobot, above_block: RTDEControlInterface
) -> None:
    start = robot.truth().position
    assert above_block.forceMode(BASE, [0, 0, 1, 0, 0, 0], [0.0, 0.0, -12.0, 0.0, 0.0, 0.0], 2, LIMITS)
    assert until(lambda: bool(robot.truth().contact[2] > 6.0), 8.0)
    time.sleep(1.0)
    force = mean_contact(robot)
    assert force[2] == pytest.approx(12.0, abs=1.5)
    moved = robot.truth().position - start
    assert moved[2] == pytest.approx(-0.010, abs=1e-3)
    assert np.abs(moved[:2]).max() < 1e-3
    assert above_block.forceModeStop()
    assert robot.is_at_rest()
    assert above_block.speedL([0.0, 0.0, 0.03, 0.0, 0.0, 0.0], 0.5)
    assert until(lambda: not robot.truth().contact.any())
    assert above_block.speedStop()


def test_force_mode_holds_the_force_while_the_tool_slides(
    robot: EmulatedRobot, above_block: RTDEControlInterface
) -> None:
    assert above_block.forceMode(BASE, [0, 0, 1, 0, 0, 0], [0.0, 0.0, -12.0, 0.0, 0.0, 0.0], 2, LIMITS)
    assert until(lambda: bool(robot.truth().contact[2] > 6.0), 8.0)
    truth = robot.truth()
    across = np.array([np.cos(truth.hole_yaw), np.sin(truth.hole_yaw), 0.0])
    assert above_block.speedL([*(0.01 * across).tolist(), 0.0, 0.0, 0.0], 0.5)
    time.sleep(0.8)
    force = mean_contact(robot)
    slid = (robot.truth().position - truth.position) @ across
    assert above_block.speedStop()
    assert above_block.forceModeStop()
    assert force[2] == pytest.approx(12.0, abs=2.0)
    assert force @ across == pytest.approx(-0.3 * force[2], rel=0.25)  # friction, against the motion
    assert slid == pytest.approx(0.011, abs=3e-3)


def test_force_mode_yields_to_a_push_along_a_free_axis_only(
    robot: EmulatedRobot, above_block: RTDEControlInterface
) -> None:
    """With no force asked along z, an arm that is pressed into the block comes back out until nothing presses."""
    assert above_block.moveUntilContact([0.0, 0.0, -0.02, 0.0, 0.0, 0.0])
    assert above_block.speedL([0.0, 0.0, -0.01, 0.0, 0.0, 0.0], 0.5)
    assert until(lambda: bool(robot.truth().contact[2] > 15.0))
    assert above_block.speedStop()
    assert mean_contact(robot, 0.1)[2] > 8.0
    assert above_block.forceMode(BASE, [0, 0, 1, 0, 0, 0], [0.0] * 6, 2, LIMITS)
    assert until(lambda: bool(robot.truth().contact[2] < 3.0))
    assert above_block.forceModeStop()


def test_move_until_contact_stops_at_the_surface(robot: EmulatedRobot, above_block: RTDEControlInterface) -> None:
    with robot.recording() as recorded:
        assert above_block.moveUntilContact([0.0, 0.0, -0.03, 0.0, 0.0, 0.0])
        path = recorded()
    assert robot.is_at_rest()
    truth = robot.truth()
    assert truth.position[2] == pytest.approx(truth.hole[2], abs=1.5e-3)
    assert path.load.max() - path.load[0] < 60.0
    assert above_block.toolContact([0.0] * 6) >= 0


def test_contact_detection_stops_an_asynchronous_move(robot: EmulatedRobot, above_block: RTDEControlInterface) -> None:
    assert above_block.startContactDetection([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])
    pose = above_block.getForwardKinematics()
    assert not above_block.readContactDetection()
    above_block.moveL([*pose[:2], pose[2] - 0.05, *pose[3:]], 0.02, 0.5, True)
    assert until(lambda: bool(robot.truth().contact[2] > 0.0))
    assert until(lambda: not robot.truth().contact.any() or robot.is_at_rest())
    assert robot.is_at_rest()
    assert above_block.readContactDetection()
    truth = robot.truth()
    assert truth.position[2] == pytest.approx(truth.hole[2], abs=1.5e-3)
    assert above_block.stopContactDetection()


def test_zeroing_takes_away_the_bias_of_the_sensor(
    robot: EmulatedRobot, control: RTDEControlInterface, receive: RTDEReceiveInterface
) -> None:
    robot.lay_out(seed=5)
    time.sleep(0.05)

    def reading() -> np.ndarray:
        samples = []
        for _ in range(40):
            samples.append(receive.getActualTCPForce())
            time.sleep(0.004)
        return np.mean(samples, axis=0)[:3]

    assert np.linalg.norm(reading()) > 1.0
    assert control.zeroFtSensor()
    time.sleep(0.05)
    assert np.linalg.norm(reading()) < 0.6


def test_a_payload_that_is_not_there_is_zeroed_away_and_reads_as_a_force_once_the_tool_tilts(
    robot: EmulatedRobot, control: RTDEControlInterface, receive: RTDEReceiveInterface
) -> None:
    kg, cog, q = receive.getPayload(), receive.getPayloadCog(), receive.getActualQ()
    try:
        assert control.setPayload(kg + 0.5, cog)
        assert until(lambda: abs(receive.getPayload() - kg - 0.5) < 1e-9)
        time.sleep(0.1)
        assert np.linalg.norm(mean_force(receive)) < 0.7, "a controller zeroes the sensor when the payload is set"
        tilt_rad = 0.5
        assert control.moveJ(plus(q, 0, 0, 0, 0, tilt_rad, 0), 1.0, 2.0)
        assert robot.is_at_rest()
        expected_n = 2.0 * np.sin(tilt_rad / 2) * 0.5 * GRAVITY_M_S2
        assert np.linalg.norm(mean_force(receive)) == pytest.approx(expected_n, abs=0.7)
        assert control.setTargetPayload(kg, [0.0, 0.0, 0.07], [0.001, 0.001, 0.001, 0.0, 0.0, 0.0])
        assert until(lambda: receive.getPayloadCog() == [0.0, 0.0, 0.07])
        assert receive.getPayloadInertia() == [0.001, 0.001, 0.001, 0.0, 0.0, 0.0]
    finally:
        assert control.setPayload(kg, cog)
        assert control.moveJ(q, 1.0, 2.0)


def test_the_watchdog_stops_the_arm_when_nobody_kicks_it(robot: EmulatedRobot, control: RTDEControlInterface) -> None:
    assert control.setWatchdog(10.0)
    assert control.speedL([0.0, 0.02, 0.0, 0.0, 0.0, 0.0], 0.5)
    for _ in range(25):
        assert control.kickWatchdog()
        time.sleep(0.02)
    assert robot.truth().twist[1] == pytest.approx(0.02, abs=2e-3)
    assert until(lambda: not control.isProgramRunning(), 1.0)
    assert robot.is_at_rest()
    assert reupload(control)
    start = robot.truth().q
    assert control.moveJ(plus(start, 0, 0, 0, 0, 0, 0.1), 1.0, 2.0)
    assert robot.truth().q[5] - start[5] == pytest.approx(0.1, abs=2e-3)


def test_a_protective_stop_is_left_only_after_its_time_and_by_hand(
    robot: EmulatedRobot, control: RTDEControlInterface, receive: RTDEReceiveInterface, dashboard: DashboardClient
) -> None:
    """The arm drives the peg into the block faster than it can know: its own protection ends that."""
    start = robot.truth()
    control.moveL([*start.hole[:2], 0.0, *control.getForwardKinematics()[3:]], 0.25, 1.5, True)
    assert until(receive.isProtectiveStopped)
    assert robot.is_at_rest()
    stopped = robot.truth()
    assert stopped.contact[2] > 0.0
    assert until(lambda: not control.isProgramRunning())
    assert dashboard.safetystatus() == "Safetystatus: PROTECTIVE_STOP"
    with pytest.raises(RuntimeError, match="until 5s after"):
        dashboard.unlockProtectiveStop()
    time.sleep(5.1)
    dashboard.closeSafetyPopup()
    dashboard.unlockProtectiveStop()
    assert until(lambda: not receive.isProtectiveStopped())
    assert dashboard.robotmode() == "Robotmode: RUNNING"
    assert reupload(control)
    pose = control.getForwardKinematics()
    assert control.moveL([*pose[:2], pose[2] + 0.05, *pose[3:]], 0.1, 0.5)
    assert robot.truth().position[2] - stopped.position[2] == pytest.approx(0.05, abs=5e-3)


def test_a_program_may_ask_for_the_protective_stop(
    robot: EmulatedRobot, control: RTDEControlInterface, receive: RTDEReceiveInterface, dashboard: DashboardClient
) -> None:
    control.moveJ(plus(robot.truth().q, 0.8, 0, 0, 0, 0, 0), 0.3, 1.0, True)
    assert until(lambda: bool(robot.truth().qd[0] > 0.2))
    control.triggerProtectiveStop()
    assert until(receive.isProtectiveStopped)
    assert robot.is_at_rest()
    assert until(lambda: not control.isProgramRunning())
    time.sleep(5.1)
    dashboard.unlockProtectiveStop()
    assert until(lambda: not receive.isProtectiveStopped())


def test_an_emergency_stop_takes_the_power_and_the_way_back_is_the_operators(
    robot: EmulatedRobot, control: RTDEControlInterface, receive: RTDEReceiveInterface, dashboard: DashboardClient
) -> None:
    control.speedJ([0.0, 0.0, 0.0, 0.0, 0.0, 0.3], 1.0)
    assert until(lambda: bool(robot.truth().qd[5] > 0.25))
    robot.call("press_emergency_stop")
    assert until(receive.isEmergencyStopped)
    assert robot.is_at_rest()
    robot.call("release_emergency_stop")
    assert until(lambda: not receive.isEmergencyStopped())
    dashboard.closeSafetyPopup()
    dashboard.powerOn()
    dashboard.brakeRelease()
    assert until(lambda: dashboard.robotmode() == "Robotmode: RUNNING", 20.0)
    assert not control.speedStop()  # refused, and so it clears the command that still stands in the registers
    assert reupload(control)
    assert control.moveJ(plus(robot.truth().q, 0, 0, 0, 0, 0, -0.1), 1.0, 2.0)
