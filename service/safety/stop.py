"""Confirms by measured velocity that a stop took effect."""

from dataclasses import dataclass
from enum import StrEnum
from math import hypot, isfinite

from wire.arrays import FloatArray

STANDSTILL_M_S = 2e-3
STANDSTILL_RAD_S = 0.02


class StopState(StrEnum):
    WAITING = "WAITING"
    CONFIRMED = "CONFIRMED"
    UNCONFIRMED = "UNCONFIRMED"
    """The deadline passed while the arm moved or was not measured: escalate."""


@dataclass(frozen=True, slots=True)
class StopParameters:
    """Criteria of a confirmed stop.

    Attributes:
        deadline_s: latest time of the confirmation, s after the command.
        linear_mps: TCP speed below which the arm stands, m/s.
        angular_radps: angular TCP speed below which the arm stands, rad/s.
        settle_s: uninterrupted standstill that confirms the stop, s.
    """

    deadline_s: float
    linear_mps: float = STANDSTILL_M_S
    angular_radps: float = STANDSTILL_RAD_S
    settle_s: float = 0.02

    def __post_init__(self) -> None:
        """Refuse limits that confirm nothing.

        Raises:
            ValueError: a field is out of range; the text names it.
        """
        for name in ("linear_mps", "angular_radps", "settle_s", "deadline_s"):
            value = getattr(self, name)
            if not (isfinite(value) and value > 0):
                raise ValueError(f"stop.{name} must be finite and above zero, not {value!r}")
        if self.settle_s >= self.deadline_s:
            raise ValueError("stop.settle_s must be shorter than stop.deadline_s")


class StopConfirmation:
    """Watches one stop from its command on. CONFIRMED and UNCONFIRMED are final."""

    __slots__ = ("_commanded_at", "_parameters", "_state", "_still_since")

    def __init__(self, parameters: StopParameters, now: float) -> None:
        """Begin to watch.

        Args:
            parameters: criteria.
            now: time at which the stop command left, on the caller's monotonic clock, s.
        """
        self._parameters = parameters
        self._commanded_at = now
        self._still_since: float | None = None
        self._state = StopState.WAITING

    def observe(self, velocity: FloatArray, now: float) -> StopState:
        """Take in the velocity of a new sample.

        Args:
            velocity: (6,) m/s and rad/s, measured TCP velocity. A velocity that is not finite counts as moving.
            now: time of arrival, s.
        """
        vx, vy, vz, wx, wy, wz = velocity.tolist()
        linear, angular = hypot(vx, vy, vz), hypot(wx, wy, wz)
        # A comparison with NaN is False, so NaN counts as moving
        still = linear < self._parameters.linear_mps and angular < self._parameters.angular_radps
        if not still:
            self._still_since = None
        elif self._still_since is None:
            self._still_since = now
        if (
            self._state is StopState.WAITING
            and self._still_since is not None
            and now - self._still_since >= self._parameters.settle_s
            and now - self._commanded_at <= self._parameters.deadline_s
        ):
            self._state = StopState.CONFIRMED
        return self.check(now)

    def check(self, now: float) -> StopState:
        """Return the state of the stop. Call it every tick, with or without a new sample."""
        if self._state is StopState.WAITING and now - self._commanded_at >= self._parameters.deadline_s:
            self._state = StopState.UNCONFIRMED
        return self._state
