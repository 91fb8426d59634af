"""Names of the array types that the whole project uses. The declaration of an array states its shape, frame, unit."""

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
