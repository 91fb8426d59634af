"""Inverse kinematics of one arm: a few Newton steps where they converge, the eight solutions otherwise."""

from collections.abc import Sequence

import numpy as np

from sim_backend.ur_controller.geometry import (
    Rotation,
    Vector,
    compose,
    flange_of,
    invert,
    multiply,
    rotation_of,
    rotvec_of,
    transpose,
)
from sim_backend.world import kinematics
from sim_backend.world.kinematics import JOINT_RANGE_RAD

from .differential import joint_rates

_STEPS = 4
_NEAR_RAD = 0.1
"""Largest distance over which Newton steps are trusted to stay on their initial branch, rad, at margin `_CLEAR`."""
_CLEAR = 0.3
"""Margin, as `kinematics.singularity_margin`, at which `_NEAR_RAD` holds: the next branch is twice as far away."""
_EXACT = 1e-11
_RANGE: tuple[float, ...] = tuple(JOINT_RANGE_RAD.tolist())


def inverse(position: Vector, rotation: Rotation, q_near: Sequence[float]) -> list[float]:
    """Return the joint angles (6,) nearest to `q_near` (6,) for the flange at a position (m) and rotation, base frame.

    The result is that of `kinematics.inverse`; for a near set-point, as in a servo loop, it is much faster.

    Raises:
        KinematicsError: there is no solution within the joint range.
    """
    q = _newton(position, rotation, q_near)
    if q is None:
        q = kinematics.inverse(np.array(position), np.array(rotation).reshape(3, 3), np.array(q_near)).tolist()
    return q


def inverse_at(pose: Sequence[float], offset: Sequence[float], q_near: Sequence[float]) -> list[float]:
    """Return the joint angles (6,) nearest to `q_near` (6,) for a TCP, given in the flange's frame, at a pose.

    Raises:
        KinematicsError: there is no solution within the joint range.
    """
    flange = compose(pose, invert(offset))
    return inverse((flange[0], flange[1], flange[2]), rotation_of(*flange[3:]), q_near)


def _newton(position: Vector, rotation: Rotation, q_near: Sequence[float]) -> list[float] | None:
    q = list(q_near)
    for _ in range(_STEPS):
        here, turned = flange_of(q)
        error = (
            position[0] - here[0],
            position[1] - here[1],
            position[2] - here[2],
            *rotvec_of(multiply(rotation, transpose(turned))),
        )
        if max(map(abs, error)) < _EXACT:
            inside = all(abs(angle) <= limit for angle, limit in zip(q, _RANGE, strict=True))
            return q if inside else None
        step = joint_rates(q, here, error, margin=_CLEAR)
        if step is None:
            return None
        q = [a + d for a, d in zip(q, step, strict=True)]
        if max(abs(a - b) for a, b in zip(q, q_near, strict=True)) > _NEAR_RAD:
            return None
    return None
