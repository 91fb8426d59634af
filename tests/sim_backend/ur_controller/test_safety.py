import pytest

from sim_backend.ur_controller.safety import UNLOCK_AFTER_S, Durations, Safety
from wire.records import TICK_S
from wire.rtde.modes import RobotMode, SafetyMode

DURATIONS = Durations(power_on_s=0.1, brake_release_s=0.2, restart_safety_s=0.3)


class Panel:
    def __init__(self):
        self.heard = []
        self.safety = Safety(DURATIONS, lambda mode, reason: self.heard.append((mode, reason)))

    def wait(self, time_s):
        for _ in range(round(time_s / TICK_S)):
            self.safety.tick()


@pytest.fixture
def panel():
    return Panel()


def test_a_robot_starts_powered_with_its_brakes_released(panel):
    assert panel.safety.robot_mode is RobotMode.RUNNING
    assert panel.safety.safety_mode is SafetyMode.NORMAL
    assert panel.safety.may_move
    assert panel.safety.status_bits == 1


def test_power_comes_in_steps_that_take_their_time(panel):
    panel.safety.power_off()
    assert panel.safety.robot_mode is RobotMode.POWER_OFF
    assert not panel.safety.is_powered
    panel.safety.power_on()
    panel.wait(0.098)
    assert panel.safety.robot_mode is RobotMode.BOOTING
    panel.wait(0.002)
    assert panel.safety.robot_mode is RobotMode.IDLE
    assert panel.safety.is_powered
    panel.wait(1.0)
    assert panel.safety.robot_mode is RobotMode.IDLE
    panel.safety.brake_release()
    panel.wait(0.198)
    assert not panel.safety.may_move
    panel.wait(0.002)
    assert panel.safety.may_move


@pytest.mark.parametrize("asked_at_s", [0.0, 0.05])
def test_a_brake_release_powers_on_first(panel, asked_at_s):
    panel.safety.power_off()
    if asked_at_s:
        panel.safety.power_on()
        panel.wait(asked_at_s)
    panel.safety.brake_release()
    panel.wait(0.298 - asked_at_s)
    assert panel.safety.robot_mode is RobotMode.IDLE
    panel.wait(0.002)
    assert panel.safety.robot_mode is RobotMode.RUNNING


def test_power_off_calls_a_brake_release_off(panel):
    panel.safety.power_off()
    panel.safety.brake_release()
    panel.wait(0.05)
    panel.safety.power_off()
    panel.wait(1.0)
    assert panel.safety.robot_mode is RobotMode.POWER_OFF


def test_powering_on_what_has_power_changes_nothing(panel):
    panel.safety.power_on()
    panel.safety.brake_release()
    panel.wait(1.0)
    assert panel.safety.robot_mode is RobotMode.RUNNING


def test_a_protective_stop_is_unlocked_after_five_seconds_and_not_before(panel):
    panel.safety.protective_stop("too much")
    assert panel.heard == [(SafetyMode.PROTECTIVE_STOP, "too much")]
    assert panel.safety.status_bits == 1 << 2 | 1 << 10
    assert not panel.safety.may_move
    panel.wait(UNLOCK_AFTER_S - TICK_S)
    assert not panel.safety.unlock_protective_stop()
    assert panel.safety.safety_mode is SafetyMode.PROTECTIVE_STOP
    panel.wait(TICK_S)
    assert panel.safety.unlock_protective_stop()
    assert panel.safety.may_move
    assert panel.heard[-1][0] is SafetyMode.NORMAL


def test_a_second_reason_does_not_prolong_a_protective_stop(panel):
    panel.safety.protective_stop("first")
    panel.wait(4.0)
    panel.safety.protective_stop("second")
    panel.wait(1.0)
    assert panel.safety.unlock_protective_stop()
    assert [reason for _, reason in panel.heard] == ["first", "unlocked"]


@pytest.mark.parametrize(
    ("system", "mode", "bits"),
    [
        (False, SafetyMode.ROBOT_EMERGENCY_STOP, 1 << 6 | 1 << 7 | 1 << 10),
        (True, SafetyMode.SYSTEM_EMERGENCY_STOP, 1 << 5 | 1 << 7 | 1 << 10),
    ],
)
def test_an_emergency_stop_takes_the_power_and_keeps_it_away_until_released(panel, system, mode, bits):
    panel.safety.press_emergency_stop(system=system)
    assert panel.safety.safety_mode is mode
    assert panel.safety.status_bits == bits
    panel.safety.brake_release()
    panel.wait(1.0)
    assert panel.safety.robot_mode is RobotMode.POWER_OFF
    panel.safety.release_emergency_stop()
    assert panel.safety.safety_mode is SafetyMode.NORMAL
    assert not panel.safety.may_move
    panel.safety.brake_release()
    panel.wait(0.3)
    assert panel.safety.may_move


def test_the_gravest_reason_shows_and_the_others_remain(panel):
    panel.safety.open_safeguard()
    panel.safety.protective_stop("force")
    assert panel.safety.safety_mode is SafetyMode.SAFEGUARD_STOP
    panel.safety.press_emergency_stop()
    panel.safety.violate("joint speed")
    assert panel.safety.safety_mode is SafetyMode.VIOLATION
    panel.safety.restart()
    assert panel.safety.safety_mode is SafetyMode.ROBOT_EMERGENCY_STOP
    panel.safety.release_emergency_stop()
    assert panel.safety.safety_mode is SafetyMode.SAFEGUARD_STOP
    panel.safety.close_safeguard()
    assert panel.safety.safety_mode is SafetyMode.NORMAL


@pytest.mark.parametrize("trip", [Safety.violate, Safety.fault])
def test_violation_and_fault_need_a_restart_that_takes_time_and_ends_without_power(panel, trip):
    trip(panel.safety, "why")
    assert panel.heard[-1][1] == "why"
    panel.safety.brake_release()
    assert panel.safety.unlock_protective_stop()
    panel.wait(10.0)
    assert panel.safety.robot_mode is RobotMode.POWER_OFF
    assert not panel.safety.may_move
    panel.safety.restart()
    assert panel.safety.safety_mode is SafetyMode.NORMAL
    panel.wait(0.298)
    assert panel.safety.robot_mode is RobotMode.BOOTING
    panel.wait(0.002)
    assert panel.safety.robot_mode is RobotMode.POWER_OFF
    panel.safety.brake_release()
    panel.wait(0.3)
    assert panel.safety.may_move
