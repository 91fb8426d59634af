"""Orientations as unit quaternions, scalar first, (n, 4): the cheapest form for the 500 Hz law.

Slower code uses the rotation matrices and rotation vectors of `wire.pose`.
"""

import numpy as np

from wire.arrays import FloatArray

_NEXT, _AFTER = np.array([1, 2, 0]), np.array([2, 0, 1])


def between(start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the rotation vector (n, 3), base axes, rad, that turns `start` into `end`; exact, the short way round."""
    vector = start[:, :1] * end[:, 1:] - end[:, :1] * start[:, 1:] + _cross(start[:, 1:], end[:, 1:])
    scalar = (start * end).sum(1)
    sine = np.sqrt((vector * vector).sum(1))
    angle = 2.0 * np.arctan2(sine, np.abs(scalar))
    return vector * (np.copysign(angle, scalar) / np.maximum(sine, 1e-12))[:, None]


def turn(quaternion: FloatArray, half_step: FloatArray) -> None:
    """Turn `quaternion` in place by twice `half_step` (n, 3) rad, base axes; a step is far below a radian."""
    scalar = quaternion[:, :1] - (half_step * quaternion[:, 1:]).sum(1, keepdims=True)
    quaternion[:, 1:] += half_step * quaternion[:, :1] + _cross(half_step, quaternion[:, 1:])
    quaternion[:, :1] = scalar
    quaternion /= np.sqrt((quaternion * quaternion).sum(1, keepdims=True))


def product(second: FloatArray, first: FloatArray) -> FloatArray:
    """Return the quaternions that turn by `first` and then by `second`, base axes."""
    vector = second[:, :1] * first[:, 1:] + first[:, :1] * second[:, 1:] + _cross(second[:, 1:], first[:, 1:])
    scalar = second[:, :1] * first[:, :1] - (second[:, 1:] * first[:, 1:]).sum(1, keepdims=True)
    return np.concatenate([scalar, vector], axis=1)


def from_rotvec(rotvec: FloatArray) -> FloatArray:
    """Return the quaternions of rotation vectors (n, 3), rad."""
    angle = np.sqrt((rotvec * rotvec).sum(-1, keepdims=True))
    return np.concatenate([np.cos(0.5 * angle), rotvec * (0.5 * np.sinc(angle / (2.0 * np.pi)))], axis=-1)


def to_rotvec(quaternion: FloatArray) -> FloatArray:
    """Return the rotation vectors (n, 3), length at most π rad."""
    identity = np.zeros_like(quaternion)
    identity[:, 0] = 1.0
    return between(identity, quaternion)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return a[:, _NEXT] * b[:, _AFTER] - a[:, _AFTER] * b[:, _NEXT]
