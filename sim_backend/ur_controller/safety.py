"""Power, brakes and safety modes of an e-Series robot.

The emulation of a robot's safety functions is a model of how they look on the network. It protects nothing.
"""

from collections.abc import Callable
from dataclasses import dataclass

from wire.records import TICK_S
from wire.rtde.modes import RobotMode, SafetyMode

UNLOCK_AFTER_S = 5.0
"""A protective stop is not unlocked earlier than this."""
UNLOCK_TOO_EARLY = (
    "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop before unlocking"
)
ASKED_BY_PROGRAM = "the program has asked for it"
"""Reason of a protective stop that a script has called for; clients get another error code for it."""


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
    """How long the steps of starting up take, s of simulated time; a robot needs several seconds for each."""

    power_on_s: float = 0.2
    brake_release_s: float = 0.2
    restart_safety_s: float = 0.2


class Safety:
    """The robot's power and its reasons to stand still; every method takes effect at once unless it says otherwise.

    Several reasons may hold at a time; the mode is the gravest of them.

    Args:
        durations: of the steps that take time.
        announce: hears of every change of the safety mode, with the reason.

    Attributes:
        robot_mode: at first RUNNING, powered with the brakes released.
        safety_mode: at first NORMAL.
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
        """Powered, brakes released, and no reason to stand still."""
        return self.robot_mode is RobotMode.RUNNING and not self._reasons

    @property
    def is_powered(self) -> bool:
        """Whether the joints have power."""
        return self.robot_mode >= RobotMode.POWER_ON

    @property
    def status_bits(self) -> int:
        """`safety_status_bits`."""
        return _MODE_BIT[self.safety_mode] | (_STOPPED_DUE_TO_SAFETY if self._reasons else 0)

    def power_on(self) -> None:
        """Power the joints, which takes time and ends at IDLE; nothing where they have power or must not get any."""
        if self.robot_mode is RobotMode.POWER_OFF and self.safety_mode not in _UNPOWERED:
            self._begin(RobotMode.BOOTING, RobotMode.IDLE, self._durations.power_on_s)

    def power_off(self) -> None:
        """Take the power from the joints; the brakes hold them."""
        self._release, self._next = False, None
        self.robot_mode = RobotMode.POWER_OFF

    def brake_release(self) -> None:
        """Release the brakes, which takes time and ends at RUNNING; powers on before where that is needed."""
        self.power_on()
        if self.robot_mode is RobotMode.IDLE and self._next is None:
            self._begin(RobotMode.IDLE, RobotMode.RUNNING, self._durations.brake_release_s)
        else:
            self._release = self.robot_mode is RobotMode.BOOTING and self._next is RobotMode.IDLE

    def protective_stop(self, reason: str) -> None:
        """Stand still until somebody unlocks."""
        if SafetyMode.PROTECTIVE_STOP not in self._reasons:
            self._protective_ticks = 0
        self._add(SafetyMode.PROTECTIVE_STOP, reason)

    def unlock_protective_stop(self, *, at_once: bool = False) -> bool:
        """Leave a protective stop; returns False, and changes nothing, when it is too young and not `at_once`."""
        if SafetyMode.PROTECTIVE_STOP in self._reasons:
            if not at_once and self._protective_ticks * TICK_S < UNLOCK_AFTER_S:
                return False
            self._remove(SafetyMode.PROTECTIVE_STOP, "unlocked")
        return True

    def press_emergency_stop(self, *, system: bool = False) -> None:
        """Press the emergency stop, the robot's own or the system's; the joints lose their power."""
        self._add(EMERGENCIES[not system], "emergency stop")
        self.power_off()

    def release_emergency_stop(self) -> None:
        """Release both; the robot has to be powered on again."""
        self._remove(SafetyMode.ROBOT_EMERGENCY_STOP, "emergency stop released")
        self._remove(SafetyMode.SYSTEM_EMERGENCY_STOP, "emergency stop released")

    def open_safeguard(self) -> None:
        """Open the safeguard's circuit."""
        self._add(SafetyMode.SAFEGUARD_STOP, "safeguard open")

    def close_safeguard(self) -> None:
        """Close it; the robot may move again."""
        self._remove(SafetyMode.SAFEGUARD_STOP, "safeguard closed")

    def violate(self, reason: str) -> None:
        """Trip a safety limit: the joints lose their power until safety is restarted."""
        self._add(SafetyMode.VIOLATION, reason)
        self.power_off()

    def fault(self, reason: str) -> None:
        """Fail: as a violation."""
        self._add(SafetyMode.FAULT, reason)
        self.power_off()

    def restart(self) -> None:
        """Restart the safety system: forgets violation, fault and protective stop; takes time, ends powered off."""
        self._reasons -= {SafetyMode.VIOLATION, SafetyMode.FAULT, SafetyMode.PROTECTIVE_STOP}
        self.power_off()
        self._begin(RobotMode.BOOTING, RobotMode.POWER_OFF, self._durations.restart_safety_s)
        self._update("safety restarted")

    def tick(self) -> None:
        """Let 2 ms pass."""
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
