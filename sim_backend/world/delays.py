"""Delays of the targets that n arms are given."""

import numpy as np

from sim_backend.world.errors import JITTERS
from wire.arrays import CellIndices


class TargetDelays:
    """Ticks from a target's arrival to its effect, for the targets of n arms in their order."""

    def __init__(self, n: int) -> None:
        self._ticks = np.zeros((n, JITTERS), np.int64)
        self._given = np.zeros(n, np.int64)

    def begin(self, cells: CellIndices, ticks: CellIndices) -> None:
        """Begin anew in `cells` (k,) with `ticks`: (k,), or (k, JITTERS) for one target after another."""
        self._ticks[cells] = ticks[:, None] if ticks.ndim == 1 else ticks
        self._given[cells] = 0

    def next(self, cells: CellIndices) -> CellIndices:
        """Return the ticks (k,) of the next target of `cells`, and count it."""
        given = self._given[cells]
        self._given[cells] = given + 1
        return self._ticks[cells, given % JITTERS]
