"""Names of the array and tuple types that the whole project uses. A declaration states shape, frame and unit."""

from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Float32Array = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int32]
BoolArray = npt.NDArray[np.bool_]
CellIndices = npt.NDArray[np.int64]
"""(k,) indices of cells within a batch."""
RecordArray = npt.NDArray[Any]
"""Structured array of the simulated cell's records, `wire.records`."""
Six = tuple[float, float, float, float, float, float]
"""One number per axis: x, y, z, then the rotations about them."""
Corner = tuple[float, float, float]
"""Corner of a box: x, y, z."""
