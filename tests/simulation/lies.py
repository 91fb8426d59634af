"""Sensors that lie. Each makes of the true wrench what the sensor says. The arm's own law believes it, too."""

import math

from tests.simulation.plant import Lie


class Scaled(Lie):
    """Every channel is multiplied by a factor of its own."""

    def __init__(self, name: str, *factors: float) -> None:
        self.name, self._factors = name, factors if len(factors) == 6 else factors * 6

    def __call__(self, wrench: list[float], tick: int) -> list[float]:
        return [value * factor for value, factor in zip(wrench, self._factors, strict=True)]


class Frozen(Lie):
    """Some channels stand still; the others live."""

    def __init__(self, name: str, *channels: int) -> None:
        self.name, self._channels = name, channels
        self._kept: list[float] | None = None

    def __call__(self, wrench: list[float], tick: int) -> list[float]:
        if self._kept is None:
            self._kept = wrench
        return [self._kept[i] if i in self._channels else value for i, value in enumerate(wrench)]


class Invalid(Lie):
    """One channel is not a number."""

    name = "not a number"

    def __call__(self, wrench: list[float], tick: int) -> list[float]:
        return [*wrench[:2], math.nan, *wrench[3:]]


class Biased(Lie):
    """The zero drifts away, by some newtons a second."""

    name = "drift"

    def __init__(self) -> None:
        self._first: int | None = None

    def __call__(self, wrench: list[float], tick: int) -> list[float]:
        if self._first is None:
            self._first = tick
        return [*wrench[:2], wrench[2] + 3.0 * (tick - self._first) * 2e-3, *wrench[3:]]


LIES = {
    "gain 0.2": lambda: Scaled("gain 0.2", 0.2),
    "gain 0.5": lambda: Scaled("gain 0.5", 0.5),
    "gain 3": lambda: Scaled("gain 3", 3.0),
    "sign of z": lambda: Scaled("sign of z", 1, 1, -1, 1, 1, 1),
    "all signs": lambda: Scaled("all signs", -1),
    "z frozen": lambda: Frozen("z frozen", 2),
    "forces frozen": lambda: Frozen("forces frozen", 0, 1, 2),
    "torques frozen": lambda: Frozen("torques frozen", 3, 4, 5),
    "all frozen": lambda: Frozen("all frozen", 0, 1, 2, 3, 4, 5),
    "not a number": Invalid,
    "drift": Biased,
}
