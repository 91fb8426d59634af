"""Rotations of tool poses: rotation vectors and matrices of any batch shape, in radians.

A tool that points down is turned by exactly π, so every function here stays accurate there and at zero.
"""

import numpy as np
import numpy.typing as npt

from wire.arrays import FloatArray


def rotation_from_rotvec(rotvec: npt.ArrayLike) -> FloatArray:
    """Return the rotation matrix (..., 3, 3) of rotation vectors (..., 3), rad."""
    v = np.asarray(rotvec, np.float64)
    angle = np.sqrt((v * v).sum(-1))
    sine = np.sinc(angle / np.pi)  # sin(angle) / angle, finite at zero
    versine = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2  # (1 - cos(angle)) / angle²
    rotation = versine[..., None, None] * v[..., :, None] * v[..., None, :]
    x, y, z = sine * v[..., 0], sine * v[..., 1], sine * v[..., 2]
    cosine = np.cos(angle)
    rotation[..., 0, 0] += cosine
    rotation[..., 1, 1] += cosine
    rotation[..., 2, 2] += cosine
    rotation[..., 0, 1] -= z
    rotation[..., 1, 0] += z
    rotation[..., 0, 2] += y
    rotation[..., 2, 0] -= y
    rotation[..., 1, 2] -= x
    rotation[..., 2, 1] += x
    return rotation


def rotvec_from_rotation(rotation: npt.ArrayLike) -> FloatArray:
    """Return the rotation vector (..., 3), length 0 … π rad, of rotation matrices (..., 3, 3).

    Goes through the quaternion's best-conditioned component, so it is accurate at every angle. At exactly π both signs
    of the axis describe the rotation; the one returned depends on rounding.
    """
    m = np.asarray(rotation, np.float64)
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    # 4 q qᵀ, scalar first: every row is the quaternion times a factor, the row with the largest diagonal the best one
    outer = np.empty((*m.shape[:-2], 4, 4))
    outer[..., 0, 0] = 1.0 + xx + yy + zz
    outer[..., 1, 1] = 1.0 + xx - yy - zz
    outer[..., 2, 2] = 1.0 - xx + yy - zz
    outer[..., 3, 3] = 1.0 - xx - yy + zz
    outer[..., 0, 1] = outer[..., 1, 0] = m[..., 2, 1] - m[..., 1, 2]
    outer[..., 0, 2] = outer[..., 2, 0] = m[..., 0, 2] - m[..., 2, 0]
    outer[..., 0, 3] = outer[..., 3, 0] = m[..., 1, 0] - m[..., 0, 1]
    outer[..., 1, 2] = outer[..., 2, 1] = m[..., 0, 1] + m[..., 1, 0]
    outer[..., 1, 3] = outer[..., 3, 1] = m[..., 0, 2] + m[..., 2, 0]
    outer[..., 2, 3] = outer[..., 3, 2] = m[..., 1, 2] + m[..., 2, 1]
    best = np.diagonal(outer, axis1=-2, axis2=-1).argmax(-1)
    quaternion = np.take_along_axis(outer, best[..., None, None], -2)[..., 0, :]
    scalar = quaternion[..., 0]
    vector = quaternion[..., 1:] * np.where(scalar < 0.0, -1.0, 1.0)[..., None]
    sine = np.sqrt((vector * vector).sum(-1))
    angle = 2.0 * np.arctan2(sine, np.abs(scalar))
    moved = sine > 0.0
    return vector * np.where(moved, angle / np.where(moved, sine, 1.0), 0.0)[..., None]


def tool_down(yaw: npt.ArrayLike) -> FloatArray:
    """Return `Rz(yaw) @ Rx(π)`, (..., 3, 3): the tool's z axis down and its x axis at `yaw`, (...), rad."""
    angle = np.asarray(yaw, np.float64)
    cosine, sine = np.cos(angle), np.sin(angle)
    rotation = np.zeros((*angle.shape, 3, 3))
    rotation[..., 0, 0] = cosine
    rotation[..., 1, 0] = sine
    rotation[..., 0, 1] = sine
    rotation[..., 1, 1] = -cosine
    rotation[..., 2, 2] = -1.0
    return rotation


def yaw_of(rotation: npt.ArrayLike) -> FloatArray:
    """Return the angle (...), rad, -π … π, of the tool's x axis about the base z axis; `rotation` is (..., 3, 3)."""
    m = np.asarray(rotation, np.float64)
    return np.arctan2(m[..., 1, 0], m[..., 0, 0])
