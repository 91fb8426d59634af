"""A client of ur_rtde whose process ends without a word: the watchdog on the controller stops the arm."""

import subprocess
import sys

from tests.strangers.emulated_robot import EmulatedRobot, until

STOPPED, NORMAL = 1, 1
"""UR's numbers of a runtime state and of a safety mode."""
PUSH = """
import sys, time
from rtde_control import RTDEControlInterface
control = RTDEControlInterface(sys.argv[1])
while not control.setWatchdog(5.0):
    pass
while not control.speedL([0.0, 0.0, -0.002, 0.0, 0.0, 0.0], 0.5):
    control.kickWatchdog()
while True:
    control.kickWatchdog()
    time.sleep(0.02)
"""


def test_a_client_that_is_killed_while_it_pushes_leaves_an_arm_that_stops(robot: EmulatedRobot) -> None:
    robot.lay_out()
    robot.place_over_the_block(0.001)
    client = subprocess.Popen([sys.executable, "-c", PUSH, robot.host])
    try:
        assert until(lambda: bool(robot.truth().contact[2] > 10.0), 10.0)
        with robot.recording() as recorded:
            client.kill()
            client.wait()
            assert until(lambda: robot.get("runtime_state") == STOPPED, 1.0)
            assert robot.is_at_rest()
            path = recorded()
    finally:
        client.kill()
        client.wait()
    assert robot.get("safety_mode") == NORMAL
    sunk = path.position[0, 2] - path.position[:, 2].min()
    assert sunk < 0.002 * 0.3  # a fifth of a second of the watchdog, and then the deceleration
    assert path.load.max() - path.load[0] < 15.0
