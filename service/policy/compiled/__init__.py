"""The compiled policy step: what `PolicyStep` does with arrays of numpy, in C and bit for bit the same.

The numpy code is the specification, and all there is where the extension is not built. Installation builds it if the
machine has a C compiler. `docs/explanation/decisions/0028-a-compiled-policy-step.md` has the reasons and the figures.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, cast

import numpy.typing as npt

from service.safety import pose
from wire import extension
from wire.arrays import Float32Array, FloatArray

Arrays = tuple[npt.NDArray[Any], ...]
"""Arrays with one row per cell, in the order of the extension's names."""


class Step(Protocol):
    """Functions of the extension. They check types and shapes, change no argument and return new arrays.

    The mappings state the order of what the functions take and return, and how many numbers a cell has of each.
    """

    SOURCES: str
    LOCK_CONSTANTS: Mapping[str, int]
    BOUNDS_CONSTANTS: Mapping[str, int]
    ACTION_CONSTANTS: Mapping[str, int]
    OBSERVATION_CONSTANTS: Mapping[str, int]
    MEASUREMENT: Mapping[str, int]
    MEMORY: Mapping[str, int]
    LOCK_STATE: Mapping[str, int]
    LOCK_OUTPUT: Mapping[str, int]
    BOUNDED: Mapping[str, int]
    DUE: Mapping[str, int]
    ENTRIES: Mapping[str, int]

    def observe(
        self,
        constants: FloatArray,
        entries: npt.NDArray[Any],
        columns: npt.NDArray[Any],
        measurement: Arrays,
        wrench_window: FloatArray,
        memory: Arrays,
        frames: Float32Array,
        /,
    ) -> tuple[Float32Array, Arrays, Float32Array]:
        """Run `ObservationBuilder.build`; return the next frames, the rest of the memory, and the observation."""
        ...

    def act(
        self,
        constants: FloatArray,
        due: Arrays,
        wrench_window: FloatArray,
        lock: Arrays,
        /,
    ) -> tuple[Arrays, Arrays, Arrays, Arrays]:
        """Run `PolicyStep.act`.

        Returns:
            Displacement and unit action; the lock's next state; its output; the bounded command.
        """
        ...

    def yaw_and_tilt(self, rotvec: FloatArray, /) -> tuple[FloatArray, FloatArray]: ...

    def rotvec_from_yaw(self, yaw: npt.ArrayLike, /) -> FloatArray: ...


def load(name: str = f"{__name__}._step") -> tuple[Step | None, str]:
    """Return the extension of that name and "", or None and the reason why it is not used."""
    found, reason = extension.load(name, Path(__file__).parent)
    return cast(Step | None, found), reason


step, absence = load()
"""The extension, None without it; and why it is not used."""

yaw_and_tilt = pose.yaw_and_tilt if step is None else step.yaw_and_tilt
"""`service.safety.pose.yaw_and_tilt` of an array (..., 3)."""
rotvec_from_yaw = pose.rotvec_from_yaw if step is None else step.rotvec_from_yaw
"""`service.safety.pose.rotvec_from_yaw`."""


def describe() -> str:
    """Return a line that says which implementation computes policy steps."""
    return extension.describe("policy steps", "compiled step", absence)
