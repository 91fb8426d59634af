"""Yaw and tilt of a tool that points down: `R = Rz(yaw) · Rx(π)`, plus a small tilt.

`docs/reference/frames.md` defines the frames.
"""

import numpy as np
import numpy.typing as npt

from wire.arrays import FloatArray


def wrap(angle: npt.ArrayLike) -> FloatArray:
    """Return angles, rad, wrapped into [-π, π)."""
    return np.remainder(np.asarray(angle, np.float64) + np.pi, 2 * np.pi) - np.pi


def rotvec_from_yaw(yaw: npt.ArrayLike) -> FloatArray:
    """Return the rotation vector (..., 3), base frame, of the untilted tool at `yaw` (...), rad.

    `Rz(yaw) · Rx(π)` is the half turn about the horizontal axis at yaw/2.
    """
    half = np.asarray(yaw, np.float64) / 2
    return np.stack((np.pi * np.cos(half), np.pi * np.sin(half), np.zeros_like(half)), axis=-1)


def yaw_and_tilt(rotvec: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Split an orientation into yaw and tilt.

    Args:
        rotvec: (..., 3), rad, base frame.

    Returns:
        yaw: (...), rad in [-π, π], angle of the TCP's x axis about the base z axis.
        tilt: (..., 2), rad, x and y of the smallest rotation, base frame, that takes straight down to the tool's z.
    """
    vector = np.asarray(rotvec, np.float64)
    squared = (vector * vector).sum(-1)
    angle = np.sqrt(squared)
    # Rodrigues: R = I + s [v]x + c (v vT - |v|² I), s = sin(a)/a, c = (1 - cos a)/a², both finite at a = 0
    s = np.sinc(angle / np.pi)
    half = np.sinc(angle / (2 * np.pi))
    c = 0.5 * (half * half)
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    yaw = np.arctan2(s * z + c * x * y, 1 - c * (y * y + z * z))
    tool_x, tool_y = s * y + c * x * z, -s * x + c * y * z
    tool_z = 1 - c * (x * x + y * y)
    sine = np.hypot(tool_x, tool_y)
    tilt_angle = np.arctan2(sine, -tool_z)
    ratio = np.where(sine > 1e-12, tilt_angle / np.maximum(sine, 1e-12), 1.0)
    return yaw, np.stack((tool_y * ratio, -tool_x * ratio), axis=-1)


def rotate(yaw: npt.ArrayLike, vector: npt.ArrayLike) -> FloatArray:
    """Turn the first two components of `vector` (..., k), k >= 2, by `yaw` (...), rad, about base z; the others stay.

    `rotate(yaw, v)` takes tool axes (x along the TCP's x axis, z up) to base axes; `rotate(-yaw, v)` the other way.
    """
    out = np.array(vector, np.float64)
    x, y = out[..., 0].copy(), out[..., 1].copy()
    cosine, sine = np.cos(yaw), np.sin(yaw)
    out[..., 0] = cosine * x - sine * y
    out[..., 1] = sine * x + cosine * y
    return out
