"""Gears between the drives and the links of n arms: with backlash, and not quite even."""

from collections.abc import Sequence

import numpy as np

from sim_backend.world.errors import Errors
from wire.arrays import CellIndices, FloatArray

RIPPLE_WAVES = 202.0
"""Waves of a gear's uneven motion per turn of the joint: a strain wave gear of 1:101 has two per turn of its drive."""


class Gears:
    """Gears of n arms. The drives follow their set-points, the links follow the drives.

    A link moves when its drive has taken up the play, and loads do not push it back across. It is off by a sine of its
    angle.

    Attributes:
        play: (n, 6) angles of the links before the ripple, rad.
        errors: (n, 2) half the backlash, and amplitude of the ripple, rad.
    """

    def __init__(self, n: int) -> None:
        self.play = np.zeros((n, 6))
        self.errors = np.zeros((n, 2))
        self._uneven = False

    def write(self, cells: CellIndices, episodes: Sequence[Errors]) -> None:
        """Give `cells` (k,) the gears of k episodes."""
        self.errors[cells] = [(0.5 * one.joint_backlash, one.joint_ripple) for one in episodes]
        self._uneven = bool(self.errors.any())

    def transmit(self, set_points: FloatArray) -> None:
        """Turn set-points (n, 6) of the drives into those of the links, rad, in place."""
        if not self._uneven:
            return
        cells = np.flatnonzero(self.errors.any(1))
        half, ripple = self.errors[cells, :1], self.errors[cells, 1:]
        wanted = set_points[cells]
        play = np.minimum(np.maximum(self.play[cells], wanted - half), wanted + half)
        self.play[cells] = play
        set_points[cells] = play + ripple * np.sin(RIPPLE_WAVES * play)
