"""Maps a network's output to a displacement of the tool, for any batch shape."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import numpy.typing as npt

from service.safety.pose import rotate
from wire.arrays import FloatArray

COMPONENTS = ("dx", "dy", "dz", "dyaw")
"""The displacement's components, in the order of its array."""


class ActionComponent(Protocol):
    """Fields of a contract's action entry that the map reads."""

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
        """Prepare the map.

        Args:
            entries: action entries of a checked contract, in the order of the network's output.
        """
        self.size = len(entries)
        self._columns = [COMPONENTS.index(entry.name) for entry in entries]
        self._limits = np.array([entry.limit for entry in entries])
        self._squared = np.array([entry.map == "signed_square" for entry in entries])
        self._in_tool_frame = any(entry.frame == "tool" and entry.name in ("dx", "dy") for entry in entries)

    def displacement(self, action: npt.ArrayLike, yaw: npt.ArrayLike) -> FloatArray:
        """Map one action.

        Args:
            action: (..., size), the network's output. It is first cut to [-1, 1]; NaN stays NaN, which the bounds
                refuse.
            yaw: (...) rad, measured.

        Returns:
            (..., 4) dx, dy, dz in m and dyaw in rad, base frame. A component that the policy lacks is zero.
        """
        unit = np.clip(np.asarray(action, np.float64), -1.0, 1.0)
        values = np.where(self._squared, unit * np.abs(unit), unit) * self._limits
        out = np.zeros((*values.shape[:-1], len(COMPONENTS)))
        out[..., self._columns] = values
        return rotate(yaw, out) if self._in_tool_frame else out

    def unit(self, action: npt.ArrayLike) -> FloatArray:
        """Return an action (..., size) as the next observation holds it.

        Returns:
            (..., 4), cut to [-1, 1]. A component that the policy lacks is zero.
        """
        out = np.zeros((*np.shape(action)[:-1], len(COMPONENTS)))
        out[..., self._columns] = np.clip(action, -1.0, 1.0)
        return out

    def constants(self) -> dict[str, npt.ArrayLike]:
        """Return the map's constants, as the compiled step takes them."""
        return {
            "column": self._columns,
            "limit": self._limits,
            "squared": self._squared,
            "in_tool_frame": self._in_tool_frame,
        }
