"""A force/torque sensor that lies to everything above it, for tests: the arm's law, both ceilings, lock and monitor."""

from collections.abc import Callable, Mapping

import numpy as np

from sim_backend.world.world import World
from wire.arrays import FloatArray

Lie = Callable[[FloatArray, FloatArray], FloatArray]
"""Makes of an honest reading (6,), and of the one at the lie's onset (6,), the reading that is told (6,)."""

_CHANNELS = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")


def _frozen(*channels: int) -> Lie:
    def lie(honest: FloatArray, onset: FloatArray) -> FloatArray:
        told = honest.copy()
        told[list(channels)] = onset[list(channels)]
        return told

    return lie


def _scaled(factor: float, *channels: int) -> Lie:
    def lie(honest: FloatArray, onset: FloatArray) -> FloatArray:
        told = honest.copy()
        told[list(channels)] = (onset + factor * (honest - onset))[list(channels)]
        return told

    return lie


def _swapped(first: int, second: int) -> Lie:
    order = np.arange(6)
    order[[first, second, first + 3, second + 3]] = second, first, second + 3, first + 3
    return lambda honest, onset: onset + (honest - onset)[order]


LIES: Mapping[str, Lie] = {
    **{f"{name} frozen": _frozen(index) for index, name in enumerate(_CHANNELS)},
    "forces frozen": _frozen(0, 1, 2),
    "torques frozen": _frozen(3, 4, 5),
    **{f"sign of {name}": _scaled(-1.0, index) for index, name in enumerate(_CHANNELS[:3])},
    "sign of forces": _scaled(-1.0, 0, 1, 2),
    "sign of all": _scaled(-1.0, *range(6)),
    **{f"gain {gain:g}": _scaled(gain, *range(6)) for gain in (0.2, 0.5, 0.67, 2.0, 5.0)},
    "x and y swapped": _swapped(0, 1),
    "x and z swapped": _swapped(0, 2),
}
"""Lies by name. Begun in a run they start from the honest reading, so that no step gives them away."""


class LyingSensor:
    """Takes over the sensor of a world of one cell.

    Args:
        world: the world; its sensor is honest until `begin`.

    Attributes:
        peak_n: largest true contact force since the last `be_honest`, N.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._honest = world.sensor.sense
        self._lie: Lie | None = None
        self._onset: FloatArray = np.zeros(6)
        self._newest: FloatArray = np.zeros(6)
        self.peak_n = 0.0
        world.sensor.sense = self._sense  # type: ignore[method-assign]

    def begin(self, lie: Lie, *, absolute: bool = False) -> None:
        """Lie from the next reading on.

        Args:
            lie: one of `LIES`.
            absolute: lie about the whole reading, the payload's weight included, as a sensor that was mounted or wired
                wrongly; otherwise about its change from now on.
        """
        self._lie, self._onset = lie, np.zeros(6) if absolute else self._newest.copy()

    def be_honest(self) -> None:
        """Tell the truth again, and begin a new peak of the true force."""
        self._lie, self.peak_n = None, 0.0

    def _sense(self, carried: FloatArray) -> FloatArray:
        readings = self._honest(carried)
        self._newest = readings[0].copy()
        self.peak_n = max(self.peak_n, float(np.linalg.norm(self._world.contact_force[0])))
        if self._lie is not None:
            readings[0] = self._lie(self._newest, self._onset)
        return readings
