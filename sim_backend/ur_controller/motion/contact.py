"""What the arm has lately measured, and whether it has just touched something."""

import numpy as np

from wire.arrays import FloatArray

TICKS = 500
"""How far back it remembers: 1 s."""
_BEFORE = 50
"""The oldest ticks of the memory, whose mean is the load before a contact."""
_SMOOTH = 4
_TOUCH_N, _START_N = 5.0, 2.0
"""Change of the load that is a contact, and the change at which it has begun: above the noise of the sensor."""


class ContactMemory:
    """The last second of joint angles and of forces on the tool."""

    def __init__(self) -> None:
        self._q = np.zeros((TICKS, 6))
        self._force = np.zeros((TICKS, 3))
        self._ticks = 0

    def record(self, q: FloatArray, wrench: FloatArray) -> None:
        """Remember a tick: joint angles (6,) and the wrench on the tool (6,), base axes."""
        slot = self._ticks % TICKS
        self._q[slot] = q
        self._force[slot] = wrench[:3]
        self._ticks += 1

    def forget(self) -> None:
        """Forget everything, as when the arm is put somewhere else."""
        self._ticks = 0

    def joints(self, steps: int) -> FloatArray | None:
        """Joint angles (6,) `steps` ticks before the last one; None when that is longer ago than it remembers."""
        if not 0 <= steps < min(self._ticks, TICKS):
            return None
        return self._q[(self._ticks - 1 - steps) % TICKS]

    def touched(self, direction: FloatArray) -> int:
        """Ticks since the tool touched something on its way in `direction` (3,), base axes; any way where it is zero.

        0: there is no contact. The load is compared with that of a second ago, so it needs no zeroed sensor, and a
        contact that has lasted for longer is none.
        """
        known = min(self._ticks, TICKS)
        if known < 2 * _BEFORE:
            return 0
        force = np.roll(self._force, -(self._ticks % TICKS), axis=0)[TICKS - known :]
        change = force - force[:_BEFORE].mean(axis=0)
        length = np.sqrt((direction * direction).sum())
        # a few ticks' mean, for one alone may be noise
        window = np.ones(_SMOOTH) / _SMOOTH
        if length > 0.0:
            against = np.convolve(-(change @ direction) / length, window, "valid")
        else:
            smooth = np.stack([np.convolve(change[:, i], window, "valid") for i in range(3)], axis=1)
            against = np.sqrt((smooth * smooth).sum(axis=1))
        if against[-1] < _TOUCH_N:
            return 0
        quiet = np.flatnonzero(against < _START_N)
        return len(against) - 1 - int(quiet[-1]) if quiet.size else len(against) - 1
