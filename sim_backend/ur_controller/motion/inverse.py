"""Inverse kinematics of one arm: a few Newton steps where they lead there, the eight solutions otherwise."""

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
"""Farthest that Newton steps are trusted to stay on the branch that they begin on …"""
_CLEAR = 0.3
"""… which they are at this margin, as `kinematics.singularity_margin`: the next branch is twice as far away."""
_EXACT = 1e-11
_RANGE: tuple[float, ...] = tuple(JOINT_RANGE_RAD.tolist())


def inverse(position: Vector, rotation: Rotation, q_near: Sequence[float]) -> list[float]:
    """Joint angles (6,) nearest to `q_near` (6,) that bring the flange to a position (m) and rotation, base frame.

    The same as `kinematics.inverse`; for a set-point that is near, which is what a servo loop asks for, much faster.

    Raises:
        KinematicsError: no solution within the joint range.
    """
    q = _newton(position, rotation, q_near)
    if q is None:
        q = kinematics.inverse(np.array(position), np.array(rotation).reshape(3, 3), np.array(q_near)).tolist()
    return q


def inverse_at(pose: Sequence[float], offset: Sequence[float], q_near: Sequence[float]) -> list[float]:
    """Joint angles (6,) nearest to `q_near` (6,) that bring a TCP, by its pose in the flange's frame, to a pose.

    Raises:
        KinematicsError: no solution within the joint range.
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
