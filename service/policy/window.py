"""Summary of the force/torque samples within one policy step."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from wire.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class WrenchSummary:
    """Statistics of a window of wrenches; base frame, at the TCP.

    Attributes:
        mean: (..., 6) mean wrench, N and N·m.
        fz_min: (...) smallest Fz, N.
        fz_max: (...) largest Fz, N.
        fz_std: (...) standard deviation of Fz, N.
    """

    mean: FloatArray
    fz_min: FloatArray
    fz_max: FloatArray
    fz_std: FloatArray


def summarise(wrench_window: npt.ArrayLike, samples: int | None = None) -> WrenchSummary:
    """Summarise the newest samples of a window.

    Args:
        wrench_window: (T, ..., 6) N and N·m, oldest first, T >= 1.
        samples: number of newest samples to use; None: all. A shorter window is used whole.
    """
    window = np.asarray(wrench_window, np.float64)
    if samples is not None:
        window = window[-samples:]
    mean = window.mean(0)
    fz = window[..., 2]
    # Of three channels: numpy adds a single one in another order for one cell than for many
    spread = window[..., :3] - mean[..., :3]
    return WrenchSummary(mean, fz.min(0), fz.max(0), np.sqrt((spread * spread).mean(0)[..., 2]))
