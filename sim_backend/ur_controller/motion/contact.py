"""Recent measurements of the arm, and the detection of a contact in them."""

import numpy as np

from wire.arrays import FloatArray

TICKS = 500
"""Length of the memory, ticks: 1 s."""
_BEFORE = 50
"""Number of the oldest ticks in the memory; their mean is the load before a contact."""
_SMOOTH = 4
_TOUCH_N, _START_N = 5.0, 2.0
"""Change of the load that counts as a contact, and change at which the contact begins: above the sensor's noise."""


class ContactMemory:
    """Joint angles and forces on the tool during the last second."""

    def __init__(self) -> None:
        self._q = np.zeros((TICKS, 6))
        self._force = np.zeros((TICKS, 3))
        self._ticks = 0

    def record(self, q: FloatArray, wrench: FloatArray) -> None:
        """Store a tick: joint angles (6,) and the wrench on the tool (6,), base axes."""
        slot = self._ticks % TICKS
        self._q[slot] = q
        self._force[slot] = wrench[:3]
        self._ticks += 1

    def forget(self) -> None:
        """Clear the memory, for instance when the arm is put elsewhere."""
        self._ticks = 0

    def joints(self, steps: int) -> FloatArray | None:
        """Return the joint angles (6,) `steps` ticks before the last one; None if the memory does not reach back so
        far.
        """
        if not 0 <= steps < min(self._ticks, TICKS):
            return None
        return self._q[(self._ticks - 1 - steps) % TICKS]

    def touched(self, direction: FloatArray) -> int:
        """Return ticks since the tool touched something on its way in `direction` (3,), base axes; zero means any
        direction.

        0 means no contact. The load is compared with that of a second ago, so the sensor need not be zeroed, and a
        contact that has lasted for longer is not detected.
        """
        known = min(self._ticks, TICKS)
        if known < 2 * _BEFORE:
            return 0
        force = np.roll(self._force, -(self._ticks % TICKS), axis=0)[TICKS - known :]
        change = force - force[:_BEFORE].mean(axis=0)
        length = np.sqrt((direction * direction).sum())
        # a mean over a few ticks, because a single one may be noise
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
