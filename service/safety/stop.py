"""Whether a stop took effect, by measured velocity."""

from dataclasses import dataclass
from enum import StrEnum
from math import hypot, isfinite

import numpy as np
import numpy.typing as npt

STANDSTILL_M_S = 2e-3
STANDSTILL_RAD_S = 0.02


class StopState(StrEnum):
    WAITING = "WAITING"
    CONFIRMED = "CONFIRMED"
    UNCONFIRMED = "UNCONFIRMED"
    """The deadline passed with the arm moving or unseen: escalate."""


@dataclass(frozen=True, slots=True)
class StopParameters:
    """What counts as stopped.

    Attributes:
        linear_mps: TCP speed below which the arm stands, m/s.
        angular_radps: likewise, rad/s.
        settle_s: how long it must stand without a break, s.
        deadline_s: when the stop must be confirmed at the latest, s after the command.
    """

    linear_mps: float = STANDSTILL_M_S
    angular_radps: float = STANDSTILL_RAD_S
    settle_s: float = 0.02
    deadline_s: float = 0.5

    def __post_init__(self) -> None:
        """Refuse limits that confirm nothing.

        Raises:
            ValueError: the text names the field.
        """
        for name in ("linear_mps", "angular_radps", "settle_s", "deadline_s"):
            value = getattr(self, name)
            if not (isfinite(value) and value > 0):
                raise ValueError(f"stop.{name} must be finite and above zero, not {value!r}")
        if self.settle_s >= self.deadline_s:
            raise ValueError("stop.settle_s must be shorter than stop.deadline_s")


class StopConfirmation:
    """Watches one stop from its command on; CONFIRMED and UNCONFIRMED are final."""

    __slots__ = ("_commanded_at", "_parameters", "_speed", "_state", "_still_since")

    def __init__(self, parameters: StopParameters, now: float) -> None:
        """`now`: when the stop command left, s of the caller's monotonic clock."""
        self._parameters = parameters
        self._commanded_at = now
        self._still_since: float | None = None
        self._speed: float | None = None
        self._state = StopState.WAITING

    @property
    def last_speed_mps(self) -> float | None:
        """Newest measured TCP speed, m/s; None when no finite sample came."""
        return self._speed

    def observe(self, velocity: npt.NDArray[np.float64], now: float) -> StopState:
        """Take in the velocity of a new sample.

        Args:
            velocity: (6,) m/s and rad/s, measured TCP velocity. One that is not finite counts as moving.
            now: arrival, s.
        """
        vx, vy, vz, wx, wy, wz = velocity.tolist()
        linear, angular = hypot(vx, vy, vz), hypot(wx, wy, wz)
        if isfinite(linear):
            self._speed = linear
        # Written so that NaN is not still
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
        """Say where the stop stands; to be asked every tick, whether a sample came or not."""
        if self._state is StopState.WAITING and now - self._commanded_at >= self._parameters.deadline_s:
            self._state = StopState.UNCONFIRMED
        return self._state
