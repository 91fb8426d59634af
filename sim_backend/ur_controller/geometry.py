"""Poses and the UR3e's forward kinematics for one arm, in plain floats.

The arithmetic is that of `wire.pose` and `kinematics`, which serve batches. This module serves a single arm several
times per 2 ms tick, where numpy's cost per call would take most of the tick. Poses are `[x, y, z, rx, ry, rz]` (m,
rotation vector rad); a rotation is its matrix as nine floats, row by row.
"""

import math
from collections.abc import Sequence

import numpy as np

from sim_backend.world.kinematics import UR3E
from wire.arrays import FloatArray

Vector = tuple[float, float, float]
Rotation = tuple[float, float, float, float, float, float, float, float, float]

_D1, _D4, _D5, _D6 = UR3E[0].d_m, UR3E[3].d_m, UR3E[4].d_m, UR3E[5].d_m
_A2, _A3 = UR3E[1].a_m, UR3E[2].a_m


def rotation_of(rx: float, ry: float, rz: float) -> Rotation:
    """Return the rotation matrix of a rotation vector, rad."""
    squared = rx * rx + ry * ry + rz * rz
    if squared < 1e-16:
        return (1.0, -rz, ry, rz, 1.0, -rx, -ry, rx, 1.0)
    angle = math.sqrt(squared)
    cosine = math.cos(angle)
    sine = math.sin(angle) / angle
    versine = 2.0 * (math.sin(0.5 * angle) / angle) ** 2
    xy, xz, yz = versine * rx * ry, versine * rx * rz, versine * ry * rz
    return (
        versine * rx * rx + cosine,
        xy - sine * rz,
        xz + sine * ry,
        xy + sine * rz,
        versine * ry * ry + cosine,
        yz - sine * rx,
        xz - sine * ry,
        yz + sine * rx,
        versine * rz * rz + cosine,
    )


def rotvec_of(rotation: Rotation) -> Vector:
    """Return the rotation vector, length 0 … π rad, through the quaternion's best-conditioned component.

    It is accurate at every angle. At exactly π both signs of the axis describe the rotation; the sign returned depends
    on rounding.
    """
    xx, xy, xz, yx, yy, yz, zx, zy, zz = rotation
    trace = xx + yy + zz
    if trace >= xx and trace >= yy and trace >= zz:
        w, x, y, z = 1.0 + trace, zy - yz, xz - zx, yx - xy
    elif xx >= yy and xx >= zz:
        w, x, y, z = zy - yz, 1.0 + xx - yy - zz, xy + yx, xz + zx
    elif yy >= zz:
        w, x, y, z = xz - zx, xy + yx, 1.0 - xx + yy - zz, yz + zy
    else:
        w, x, y, z = yx - xy, xz + zx, yz + zy, 1.0 - xx - yy + zz
    sine = math.sqrt(x * x + y * y + z * z)
    if sine == 0.0:
        return (0.0, 0.0, 0.0)
    scale = 2.0 * math.atan2(sine, abs(w)) / sine
    if w < 0.0:
        scale = -scale
    return (x * scale, y * scale, z * scale)


def multiply(a: Rotation, b: Rotation) -> Rotation:
    """Return the rotation `b` followed by `a`."""
    a0, a1, a2, a3, a4, a5, a6, a7, a8 = a
    b0, b1, b2, b3, b4, b5, b6, b7, b8 = b
    return (
        a0 * b0 + a1 * b3 + a2 * b6,
        a0 * b1 + a1 * b4 + a2 * b7,
        a0 * b2 + a1 * b5 + a2 * b8,
        a3 * b0 + a4 * b3 + a5 * b6,
        a3 * b1 + a4 * b4 + a5 * b7,
        a3 * b2 + a4 * b5 + a5 * b8,
        a6 * b0 + a7 * b3 + a8 * b6,
        a6 * b1 + a7 * b4 + a8 * b7,
        a6 * b2 + a7 * b5 + a8 * b8,
    )


def transpose(rotation: Rotation) -> Rotation:
    """Return the inverse rotation."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz = rotation
    return (xx, yx, zx, xy, yy, zy, xz, yz, zz)


def rotate(rotation: Rotation, vector: Sequence[float]) -> Vector:
    """Rotate a vector (3,)."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz = rotation
    x, y, z = vector
    return (xx * x + xy * y + xz * z, yx * x + yy * y + yz * z, zx * x + zy * y + zz * z)


def cross(a: Sequence[float], b: Sequence[float]) -> Vector:
    """Return the vector product of (3,) and (3,)."""
    ax, ay, az = a
    bx, by, bz = b
    return (ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)


def compose(first: Sequence[float], second: Sequence[float]) -> list[float]:
    """Return the pose `second`, given in the frame of `first`, in the frame in which `first` is given: `pose_trans`."""
    rotation = rotation_of(first[3], first[4], first[5])
    x, y, z = rotate(rotation, second[:3])
    turn = rotvec_of(multiply(rotation, rotation_of(second[3], second[4], second[5])))
    return [first[0] + x, first[1] + y, first[2] + z, *turn]


def invert(pose: Sequence[float]) -> list[float]:
    """Return the inverse of a pose: `pose_inv`."""
    rotation = transpose(rotation_of(pose[3], pose[4], pose[5]))
    x, y, z = rotate(rotation, pose[:3])
    return [-x, -y, -z, -pose[3], -pose[4], -pose[5]]


def flange_of(q: Sequence[float]) -> tuple[Vector, Rotation]:
    """Return position (m) and rotation of the flange, base frame, at six joint angles (rad): `kinematics.forward`."""
    q1, q2, q3, q4, q5, q6 = q
    s1, c1 = math.sin(q1), math.cos(q1)
    s5, c5 = math.sin(q5), math.cos(q5)
    s6, c6 = math.sin(q6), math.cos(q6)
    q23 = q2 + q3
    s234, c234 = math.sin(q23 + q4), math.cos(q23 + q4)
    wrist_x = _A2 * math.cos(q2) + _A3 * math.cos(q23)
    wrist_z = _A2 * math.sin(q2) + _D1 + _A3 * math.sin(q23)
    x4_x, x4_y, x4_z = c1 * c234, s1 * c234, s234
    z4_x, z4_y, z4_z = c1 * s234, s1 * s234, -c234
    x5_x, x5_y, x5_z = c5 * x4_x + s5 * s1, c5 * x4_y - s5 * c1, c5 * x4_z
    axis_x, axis_y, axis_z = c5 * s1 - s5 * x4_x, -c5 * c1 - s5 * x4_y, -s5 * x4_z
    position = (
        c1 * wrist_x + _D4 * s1 + _D5 * z4_x + _D6 * axis_x,
        s1 * wrist_x - _D4 * c1 + _D5 * z4_y + _D6 * axis_y,
        wrist_z + _D5 * z4_z + _D6 * axis_z,
    )
    rotation = (
        c6 * x5_x - s6 * z4_x,
        -s6 * x5_x - c6 * z4_x,
        axis_x,
        c6 * x5_y - s6 * z4_y,
        -s6 * x5_y - c6 * z4_y,
        axis_y,
        c6 * x5_z - s6 * z4_z,
        -s6 * x5_z - c6 * z4_z,
        axis_z,
    )
    return position, rotation


def jacobian_of(q: Sequence[float], point: Sequence[float]) -> FloatArray:
    """Return the geometric Jacobian (6, 6) at `point` (3,), base frame, linear rows first: `kinematics.jacobian`.

    The point is given in the base frame and moves with the flange.
    """
    q1, q2, q3, q4, q5, _ = q
    x, y, z = point
    s1, c1 = math.sin(q1), math.cos(q1)
    s5, c5 = math.sin(q5), math.cos(q5)
    q23 = q2 + q3
    s234, c234 = math.sin(q23 + q4), math.cos(q23 + q4)
    elbow_x, elbow_z = _A2 * math.cos(q2), _A2 * math.sin(q2) + _D1
    wrist_x, wrist_z = elbow_x + _A3 * math.cos(q23), elbow_z + _A3 * math.sin(q23)
    reach = x * c1 + y * s1
    up2, up3, up4 = z - _D1, z - elbow_z, z - wrist_z
    z4_x, z4_y, z4_z = c1 * s234, s1 * s234, -c234
    z5_x, z5_y, z5_z = c5 * s1 - s5 * c1 * c234, -c5 * c1 - s5 * s1 * c234, -s5 * s234
    from_x = x - (c1 * wrist_x + _D4 * s1 + _D5 * z4_x)
    from_y = y - (s1 * wrist_x - _D4 * c1 + _D5 * z4_y)
    from_z = z - (wrist_z + _D5 * z4_z)
    return np.array(
        (
            (-y, -c1 * up2, -c1 * up3, -c1 * up4, z4_y * from_z - z4_z * from_y, z5_y * from_z - z5_z * from_y),
            (x, -s1 * up2, -s1 * up3, -s1 * up4, z4_z * from_x - z4_x * from_z, z5_z * from_x - z5_x * from_z),
            (
                0.0,
                reach,
                reach - elbow_x,
                reach - wrist_x,
                z4_x * from_y - z4_y * from_x,
                z5_x * from_y - z5_y * from_x,
            ),
            (0.0, s1, s1, s1, z4_x, z5_x),
            (0.0, -c1, -c1, -c1, z4_y, z5_y),
            (1.0, 0.0, 0.0, 0.0, z4_z, z5_z),
        )
    )
