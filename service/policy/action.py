"""From a network's output to a displacement of the tool. Any batch shape."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import numpy.typing as npt

from service.safety.pose import rotate
from wire.arrays import FloatArray

COMPONENTS = ("dx", "dy", "dz", "dyaw")
"""The displacement's components, in the order of its array."""


class ActionComponent(Protocol):
    """What the map needs of an action entry of a contract."""

    @property
    def name(self) -> str: ...
    @property
    def limit(self) -> float: ...
    @property
    def frame(self) -> str: ...
    @property
    def map(self) -> str: ...


class ActionMap:
    """Turns outputs in [-1, 1] into metres and radians in the base frame."""

    def __init__(self, entries: Sequence[ActionComponent]) -> None:
        """`entries`: of a checked contract, in the order of the network's output."""
        self.size = len(entries)
        self._columns = [COMPONENTS.index(entry.name) for entry in entries]
        self._limits = np.array([entry.limit for entry in entries])
        self._squared = np.array([entry.map == "signed_square" for entry in entries])
        self._in_tool_frame = any(entry.frame == "tool" and entry.name in ("dx", "dy") for entry in entries)

    def displacement(self, action: npt.ArrayLike, yaw: npt.ArrayLike) -> FloatArray:
        """Map one action.

        Args:
            action: (..., size), the network's output; cut to [-1, 1] first. NaN stays NaN, for the bounds to refuse.
            yaw: (...) rad, measured.

        Returns:
            (..., 4) dx, dy, dz in m and dyaw in rad, base frame; zero for a component that the policy lacks.
        """
        unit = np.clip(np.asarray(action, np.float64), -1.0, 1.0)
        values = np.where(self._squared, unit * np.abs(unit), unit) * self._limits
        out = np.zeros((*values.shape[:-1], len(COMPONENTS)))
        out[..., self._columns] = values
        return rotate(yaw, out) if self._in_tool_frame else out

    def unit(self, action: npt.ArrayLike) -> FloatArray:
        """An action (..., size) as the next observation has it: (..., 4) cut to [-1, 1], zero where it lacks one."""
        out = np.zeros((*np.shape(action)[:-1], len(COMPONENTS)))
        out[..., self._columns] = np.clip(action, -1.0, 1.0)
        return out

    def excess(self, action: npt.ArrayLike) -> FloatArray:
        """Largest |component| (...) of an action: above 1 it was cut; a run counts large ones in a row."""
        return np.abs(np.asarray(action, np.float64)).max(-1)
