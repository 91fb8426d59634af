"""An emulated robot, and the clients of `ur_rtde` that are connected to it: they know nothing of this project."""

from collections.abc import Iterator

import pytest
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

from tests.strangers.emulated_robot import EmulatedRobot, reupload


@pytest.fixture(scope="session")
def robot() -> Iterator[EmulatedRobot]:
    """One controller for all of them, at an address of its own: these clients know only the standard ports."""
    served = EmulatedRobot([f"127.0.0.{number}" for number in range(26, 30)])
    yield served
    served.close()


@pytest.fixture(scope="module")
def receive(robot: EmulatedRobot) -> Iterator[RTDEReceiveInterface]:
    client = RTDEReceiveInterface(robot.host)
    yield client
    client.disconnect()


@pytest.fixture(scope="module")
def connected(robot: EmulatedRobot) -> Iterator[RTDEControlInterface]:
    client = RTDEControlInterface(robot.host)
    yield client
    client.stopScript()
    client.disconnect()


@pytest.fixture
def control(robot: EmulatedRobot, connected: RTDEControlInterface) -> RTDEControlInterface:
    """The client's own control script running on an arm that rests at the start pose."""
    robot.lay_out()
    if not connected.isProgramRunning():
        assert reupload(connected)
    assert robot.is_at_rest()
    return connected
