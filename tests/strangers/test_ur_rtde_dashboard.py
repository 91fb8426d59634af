"""`DashboardClient` and `ScriptClient` of ur_rtde operate the emulated controller as a teach pendant's user would."""

from collections.abc import Iterator

import pytest
from dashboard_client import DashboardClient
from rtde_receive import RTDEReceiveInterface
from script_client import ScriptClient

from tests.strangers.emulated_robot import EmulatedRobot, until

PROGRAM = """def wave():
  while True:
    movej(get_actual_joint_positions() + [0, 0, 0, 0, 0, 0.2], a=2, v=1)
    movej(get_actual_joint_positions() - [0, 0, 0, 0, 0, 0.2], a=2, v=1)
  end
end
"""


@pytest.fixture
def dashboard(robot: EmulatedRobot) -> Iterator[DashboardClient]:
    client = DashboardClient(robot.host)
    client.connect()
    yield client
    client.disconnect()


def test_the_controller_says_what_it_is(robot: EmulatedRobot, dashboard: DashboardClient) -> None:
    assert dashboard.isConnected()
    assert dashboard.polyscopeVersion().startswith("5.21.")
    assert dashboard.getRobotModel() == "UR3"
    assert dashboard.getSerialNumber() == str(robot.get("serial"))
    assert dashboard.isInRemoteControl()
    assert dashboard.robotmode() == "Robotmode: RUNNING"
    assert dashboard.safetymode() == "Safetymode: NORMAL"
    assert dashboard.safetystatus() == "Safetystatus: NORMAL"


def test_a_program_is_loaded_played_paused_and_stopped(robot: EmulatedRobot, dashboard: DashboardClient) -> None:
    robot.lay_out()
    robot.call("programs.__setitem__", "wave.urp", PROGRAM)
    with pytest.raises(RuntimeError, match="File not found"):
        dashboard.loadURP("nothing.urp")
    dashboard.loadURP("wave.urp")
    assert dashboard.getLoadedProgram().endswith("wave.urp")
    assert not dashboard.running()
    start = robot.truth().q[5]
    dashboard.play()
    assert until(lambda: robot.truth().q[5] > start + 0.05)
    assert dashboard.running()
    assert dashboard.programState() == "PLAYING wave.urp"
    dashboard.pause()
    assert until(lambda: dashboard.programState() == "PAUSED wave.urp")
    assert robot.is_at_rest()
    paused = robot.truth().q[5]
    dashboard.play()
    assert until(lambda: abs(robot.truth().q[5] - paused) > 0.02)
    dashboard.stop()
    assert robot.is_at_rest()
    assert dashboard.programState() == "STOPPED wave.urp"
    assert not dashboard.running()


def test_popups_and_the_log_take_text(dashboard: DashboardClient) -> None:
    dashboard.popup("the peg stands askew")
    dashboard.closePopup()
    dashboard.addToLog("checked the peg")
    assert dashboard.isConnected()


def test_power_goes_off_and_comes_back_in_its_stages(robot: EmulatedRobot, dashboard: DashboardClient) -> None:
    receive = RTDEReceiveInterface(robot.host)
    try:
        dashboard.powerOff()
        assert until(lambda: dashboard.robotmode() == "Robotmode: POWER_OFF", 10.0)
        assert until(lambda: receive.getRobotMode() == 3)
        assert receive.getRobotStatus() & 1 == 0
        dashboard.powerOn()
        assert until(lambda: dashboard.robotmode() == "Robotmode: IDLE", 10.0)
        assert until(lambda: receive.getRobotMode() == 5)
        dashboard.brakeRelease()
        assert until(lambda: dashboard.robotmode() == "Robotmode: RUNNING", 10.0)
        assert until(lambda: receive.getRobotMode() == 7)
        dashboard.restartSafety()
        assert until(lambda: dashboard.robotmode() == "Robotmode: POWER_OFF", 10.0)
        dashboard.powerOn()
        dashboard.brakeRelease()
        assert until(lambda: dashboard.robotmode() == "Robotmode: RUNNING", 20.0)
    finally:
        receive.disconnect()


def test_leaving_remote_control_locks_the_clients_out(robot: EmulatedRobot, dashboard: DashboardClient) -> None:
    from rtde_control import RTDEControlInterface

    robot.set("remote_control", False)
    try:
        assert not dashboard.isInRemoteControl()
        with pytest.raises(RuntimeError, match="remote control"):
            RTDEControlInterface(robot.host)
    finally:
        robot.set("remote_control", True)
    assert dashboard.isInRemoteControl()


def test_a_script_is_sent_and_runs(robot: EmulatedRobot) -> None:
    robot.lay_out()
    client = ScriptClient(robot.host, 5, 21)
    client.connect()
    try:
        start = robot.truth().q[5]
        assert client.sendScriptCommand("movej(get_actual_joint_positions() + [0,0,0,0,0,0.1], a=3, v=1)\n")
        assert until(lambda: abs(robot.truth().q[5] - start - 0.1) < 2e-3)
        assert client.sendScriptCommand("set_standard_digital_out(5, True)\n")
        assert until(lambda: bool(robot.get("terminals.digital_outputs") >> 5 & 1))
        assert client.sendScriptCommand("sec off():\n  set_standard_digital_out(5, False)\nend\n")
        assert until(lambda: not robot.get("terminals.digital_outputs") >> 5 & 1)
    finally:
        client.disconnect()


def test_quit_ends_the_conversation(robot: EmulatedRobot) -> None:
    client = DashboardClient(robot.host)
    client.connect()
    client.quit()
    client.disconnect()
    assert not client.isConnected()
