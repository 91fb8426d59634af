"""The newest wrenches of one arm, side by side in memory, so that a policy step takes them in one copy."""

import numpy as np

from wire.arrays import FloatArray


class Recent:
    """Keeps the newest wrenches.

    Args:
        capacity: number of them that are kept.
    """

    def __init__(self, capacity: int) -> None:
        self._rows = np.zeros((2 * capacity, 6))
        self._capacity = capacity
        self._end = self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(self, wrench: FloatArray) -> None:
        """Add a wrench (6,), N and N·m."""
        if self._end == len(self._rows):
            self._rows[: self._capacity] = self._rows[self._capacity :]
            self._end = self._capacity
        self._rows[self._end] = wrench
        self._end += 1
        self._count = min(self._count + 1, self._capacity)

    def clear(self) -> None:
        """Forget them all."""
        self._count = 0

    def newest(self, most: int) -> FloatArray:
        """Return a copy (k, 6) of the newest wrenches, oldest first; k is `most`, or less where less are kept."""
        return self._rows[self._end - min(most, self._count) : self._end].copy()
