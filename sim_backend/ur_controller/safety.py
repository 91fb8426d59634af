"""Power, brakes and safety modes of an e-Series robot.

This models how a robot's safety functions appear on the network. It protects nothing.
"""

from collections.abc import Callable
from dataclasses import dataclass

from wire.records import TICK_S
from wire.rtde.modes import RobotMode, SafetyMode

UNLOCK_AFTER_S = 5.0
"""Age before which a protective stop is not unlocked, s."""
UNLOCK_TOO_EARLY = (
    "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop before unlocking"
)
ASKED_BY_PROGRAM = "the program has asked for it"
"""Reason of a protective stop called by a script; clients receive a different error code for it."""


EMERGENCIES = (SafetyMode.SYSTEM_EMERGENCY_STOP, SafetyMode.ROBOT_EMERGENCY_STOP)
_UNPOWERED = (*EMERGENCIES, SafetyMode.VIOLATION, SafetyMode.FAULT)
_MODE_BIT = {
    SafetyMode.NORMAL: 1 << 0,
    SafetyMode.REDUCED: 1 << 1,
    SafetyMode.PROTECTIVE_STOP: 1 << 2,
    SafetyMode.RECOVERY: 1 << 3,
    SafetyMode.SAFEGUARD_STOP: 1 << 4,
    SafetyMode.SYSTEM_EMERGENCY_STOP: 1 << 5 | 1 << 7,
    SafetyMode.ROBOT_EMERGENCY_STOP: 1 << 6 | 1 << 7,
    SafetyMode.VIOLATION: 1 << 8,
    SafetyMode.FAULT: 1 << 9,
}
_STOPPED_DUE_TO_SAFETY = 1 << 10


@dataclass(frozen=True, slots=True)
class Durations:
    """Durations of the start-up steps, s of simulated time; a real robot needs several seconds for each."""

    power_on_s: float = 0.2
    brake_release_s: float = 0.2
    restart_safety_s: float = 0.2


class Safety:
    """Power and reasons to stand still; every method takes effect at once unless it says otherwise.

    Several reasons may hold at a time; the mode is that of the gravest.

    Args:
        durations: durations of the steps that take time.
        announce: called with every new safety mode and its reason.

    Attributes:
        robot_mode: initially RUNNING, powered with the brakes released.
        safety_mode: initially NORMAL.
    """

    def __init__(self, durations: Durations, announce: Callable[[SafetyMode, str], None]) -> None:
        self.robot_mode = RobotMode.RUNNING
        self.safety_mode = SafetyMode.NORMAL
        self._durations = durations
        self._announce = announce
        self._reasons: set[SafetyMode] = set()
        self._next: RobotMode | None = None
        self._left = 0
        self._release = False
        self._protective_ticks = 0

    @property
    def may_move(self) -> bool:
        """The joints are powered, the brakes released, and there is no reason to stand still."""
        return self.robot_mode is RobotMode.RUNNING and not self._reasons

    @property
    def is_powered(self) -> bool:
        """The joints have power."""
        return self.robot_mode >= RobotMode.POWER_ON

    @property
    def status_bits(self) -> int:
        """Value of RTDE's `safety_status_bits`."""
        return _MODE_BIT[self.safety_mode] | (_STOPPED_DUE_TO_SAFETY if self._reasons else 0)

    def power_on(self) -> None:
        """Power the joints, which takes time and ends at IDLE. No effect if they have power or must not get it."""
        if self.robot_mode is RobotMode.POWER_OFF and self.safety_mode not in _UNPOWERED:
            self._begin(RobotMode.BOOTING, RobotMode.IDLE, self._durations.power_on_s)

    def power_off(self) -> None:
        """Remove power from the joints; the brakes hold them."""
        self._release, self._next = False, None
        self.robot_mode = RobotMode.POWER_OFF

    def brake_release(self) -> None:
        """Release the brakes, which takes time and ends at RUNNING; power on first if needed."""
        self.power_on()
        if self.robot_mode is RobotMode.IDLE and self._next is None:
            self._begin(RobotMode.IDLE, RobotMode.RUNNING, self._durations.brake_release_s)
        else:
            self._release = self.robot_mode is RobotMode.BOOTING and self._next is RobotMode.IDLE

    def protective_stop(self, reason: str) -> None:
        """Stand still until the stop is unlocked."""
        if SafetyMode.PROTECTIVE_STOP not in self._reasons:
            self._protective_ticks = 0
        self._add(SafetyMode.PROTECTIVE_STOP, reason)

    def unlock_protective_stop(self, *, at_once: bool = False) -> bool:
        """Leave a protective stop; return False, and change nothing, if it is too young and not `at_once`."""
        if SafetyMode.PROTECTIVE_STOP in self._reasons:
            if not at_once and self._protective_ticks * TICK_S < UNLOCK_AFTER_S:
                return False
            self._remove(SafetyMode.PROTECTIVE_STOP, "unlocked")
        return True

    def press_emergency_stop(self, *, system: bool = False) -> None:
        """Press the emergency stop of the robot or of the system; the joints lose their power."""
        self._add(EMERGENCIES[not system], "emergency stop")
        self.power_off()

    def release_emergency_stop(self) -> None:
        """Release both emergency stops; the robot must be powered on again."""
        self._remove(SafetyMode.ROBOT_EMERGENCY_STOP, "emergency stop released")
        self._remove(SafetyMode.SYSTEM_EMERGENCY_STOP, "emergency stop released")

    def open_safeguard(self) -> None:
        """Open the safeguard's circuit."""
        self._add(SafetyMode.SAFEGUARD_STOP, "safeguard open")

    def close_safeguard(self) -> None:
        """Close the safeguard's circuit; the robot may move again."""
        self._remove(SafetyMode.SAFEGUARD_STOP, "safeguard closed")

    def violate(self, reason: str) -> None:
        """Trip a safety limit; the joints have no power until safety is restarted."""
        self._add(SafetyMode.VIOLATION, reason)
        self.power_off()

    def fault(self, reason: str) -> None:
        """Report a fault; the effect is that of a violation."""
        self._add(SafetyMode.FAULT, reason)
        self.power_off()

    def restart(self) -> None:
        """Restart the safety system: clear violation, fault and protective stop; takes time and ends powered off."""
        self._reasons -= {SafetyMode.VIOLATION, SafetyMode.FAULT, SafetyMode.PROTECTIVE_STOP}
        self.power_off()
        self._begin(RobotMode.BOOTING, RobotMode.POWER_OFF, self._durations.restart_safety_s)
        self._update("safety restarted")

    def tick(self) -> None:
        """Advance by 2 ms."""
        self._protective_ticks += 1
        if self._next is None:
            return
        self._left -= 1
        if self._left <= 0:
            self.robot_mode, self._next = self._next, None
            if self._release and self.robot_mode is RobotMode.IDLE:
                self._release = False
                self.brake_release()

    def _begin(self, meanwhile: RobotMode, then: RobotMode, time_s: float) -> None:
        self.robot_mode, self._next, self._left = meanwhile, then, round(time_s / TICK_S)

    def _add(self, mode: SafetyMode, reason: str) -> None:
        self._reasons.add(mode)
        self._update(reason)

    def _remove(self, mode: SafetyMode, reason: str) -> None:
        self._reasons.discard(mode)
        self._update(reason)

    def _update(self, reason: str) -> None:
        mode = max(self._reasons, default=SafetyMode.NORMAL)
        if mode is not self.safety_mode:
            self.safety_mode = mode
            self._announce(mode, reason)
