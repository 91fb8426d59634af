"""The compiled tick: what numpy does at every tick of a world and its drives, in C and bit for bit the same.

The numpy code is the specification, and all there is where the extension is not built. Installation builds it if the
machine has a C compiler. `docs/explanation/decisions/0027-a-compiled-tick.md` has the reasons and the figures.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol, cast

import numpy.typing as npt

from wire import extension
from wire.arrays import BoolArray, FloatArray

Arrays = tuple[npt.NDArray[Any], ...]
"""Arrays of one object, in the order of the extension's names; one row per cell."""
Bound = tuple[Arrays, FloatArray]
"""Arrays and constants of one object."""


class Tick(Protocol):
    """Functions of the extension. They check types and shapes and write into the arrays that they are given."""

    SOURCES: str
    MUJOCO: int
    """Version of MuJoCo that it was built for."""
    INVERTS: int
    """1 if it found numpy's inverse of a matrix."""
    CONTROL: int
    """Address of MuJoCo's control callback for `advance`."""
    CLOCK: int
    """Address of a clock for MuJoCo's timers that stands still."""
    CALL: int
    """How many numbers `advance` needs for itself."""
    ARM: tuple[str, ...]
    SENSOR: tuple[str, ...]
    CELLS: tuple[str, ...]
    DRIVES: tuple[str, ...]
    TELLING: tuple[str, ...]
    REPORT: tuple[str, ...]
    TOGETHER: tuple[str, ...]
    ARM_CONSTANTS: Mapping[str, int]
    SENSOR_CONSTANTS: Mapping[str, int]
    CELLS_CONSTANTS: Mapping[str, int]
    DRIVES_CONSTANTS: Mapping[str, int]
    TOGETHER_CONSTANTS: Mapping[str, int]

    def lead(
        self,
        arm: Arrays,
        constants: FloatArray,
        joints: FloatArray,
        wrench: FloatArray,
        position: FloatArray,
        orientation: FloatArray,
        saturated: BoolArray,
        /,
    ) -> int:
        """Run the first half of `ArmController.update`; return how many Jacobians are to be inverted."""
        ...

    def follow(self, arm: Arrays, constants: FloatArray, inverses: FloatArray, set_points: FloatArray, /) -> None:
        """Run the second half, with the inverses of those Jacobians."""
        ...

    def sense(self, sensor: Arrays, constants: FloatArray, carried: FloatArray, slot: int, /) -> None:
        """Run `ForceTorqueSensor.sense`, into its array `sensed`."""
        ...

    def compensate(self, sensor: Arrays, constants: FloatArray, sensed: FloatArray, rotation: FloatArray, /) -> None:
        """Run the rest of `ForceTorqueSensor.read`."""
        ...

    def unzeroed(self, sensor: Arrays, constants: FloatArray, rotation: FloatArray, out: FloatArray, /) -> None:
        """Run `ForceTorqueSensor.unzeroed`."""
        ...

    def measure(self, cells: Arrays, constants: FloatArray, /) -> None:
        """Run all of `World._step` between the physics and the sensor."""
        ...

    def feel(self, drives: Arrays, constants: FloatArray, effort: Arrays, noise: FloatArray, /) -> None:
        """Run `JointSense.read`; `noise` (1, 6) has unit variance."""
        ...

    def tell(self, telling: Arrays, report: Arrays, /) -> None:
        """Run `Telling.write`."""
        ...

    def advance(
        self,
        arm: Arrays,
        arm_constants: FloatArray,
        cells: Arrays,
        cells_constants: FloatArray,
        sensor: Arrays,
        sensor_constants: FloatArray,
        together: Arrays,
        together_constants: FloatArray,
        call: FloatArray,
        readings: FloatArray,
        slot: int,
        step: Callable[[int], None],
        /,
    ) -> None:
        """Run `World.tick` for each row of `readings` (ticks, n, 6), within one call of `step` with that number.

        `step` is to make so many steps of MuJoCo, which is to call `CONTROL` in each. `call` (CALL,) is the extension's
        own; it must live as long as the simulations.

        Raises:
            RuntimeError: `call` is in use, or MuJoCo has not called `CONTROL` once in each step.
        """
        ...


def arrays(names: tuple[str, ...], found: Mapping[str, Any]) -> Arrays:
    """Return the arrays of an object in the order of `names`; `found` has them by name, with `_` if they are private.

    The object must never replace one of them.
    """
    return tuple(found[name] if name in found else found[f"_{name}"] for name in names)


def load(name: str = f"{__name__}._tick") -> tuple[Tick | None, str]:
    """Return the extension of that name and "", or None and the reason why it is not used."""
    found, reason = extension.load(name, Path(__file__).parent)
    return cast(Tick | None, found), reason


tick, absence = load()
"""The extension, None without it; and why it is not used."""


def describe() -> str:
    """Return a line that says which implementation computes the ticks of worlds made from now on."""
    return extension.describe("simulated ticks", "compiled tick", absence)
