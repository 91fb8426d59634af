"""What one policy step felt, from the samples of the force/torque sensor within it."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from wire.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class WrenchSummary:
    """A window of wrenches in a few numbers; base frame, at the TCP.

    Attributes:
        mean: (..., 6) N and N·m.
        fz_min: (...) N.
        fz_max: (...) N.
        fz_std: (...) N.
    """

    mean: FloatArray
    fz_min: FloatArray
    fz_max: FloatArray
    fz_std: FloatArray


def summarise(wrench_window: npt.ArrayLike, samples: int | None = None) -> WrenchSummary:
    """Summarise the newest samples of a window.

    Args:
        wrench_window: (T, ..., 6) N and N·m, oldest first, T >= 1.
        samples: how many of the newest to use; None: all. A window that holds fewer gives what it has.
    """
    window = np.asarray(wrench_window, np.float64)
    if samples is not None:
        window = window[-samples:]
    mean = window.mean(0)
    fz = window[..., 2]
    spread = fz - mean[..., 2]
    return WrenchSummary(mean, fz.min(0), fz.max(0), np.sqrt((spread * spread).mean(0)))
