"""URScript's arithmetic of poses and wrenches. UR's script manual, "Module urmath".

The parameters of the pose functions must be poses; a list of six numbers is not accepted.
"""

import math
from typing import Final

from sim_backend.ur_controller.geometry import (
    compose,
    cross,
    invert,
    multiply,
    rotate,
    rotation_of,
    rotvec_of,
    transpose,
)
from sim_backend.ur_controller.script import Builtin, Pose, Value
from sim_backend.ur_controller.script.values import number, pose, vector


def pose_trans(p_from: Value, p_from_to: Value) -> Pose:
    """Return the pose `p_from_to`, given in the frame `p_from`, in the frame in which `p_from` is given."""
    return Pose(compose(pose(p_from, "p_from"), pose(p_from_to, "p_from_to")))


def pose_inv(p_from: Value) -> Pose:
    """Return the inverse; the length of its rotation vector is at most π, whatever that of `p_from` is."""
    x, y, z, rx, ry, rz = invert(pose(p_from, "p_from"))
    return Pose([x, y, z, *rotvec_of(rotation_of(rx, ry, rz))])


def pose_add(p_1: Value, p_2: Value) -> Pose:
    """Return the sum of the positions, and the rotation R1 R2."""
    first, second = pose(p_1, "p_1"), pose(p_2, "p_2")
    turn = rotvec_of(multiply(rotation_of(*first[3:]), rotation_of(*second[3:])))
    return Pose([a + b for a, b in zip(first[:3], second[:3], strict=True)] + list(turn))


def pose_sub(p_to: Value, p_from: Value) -> Pose:
    """Return the difference of the positions and the rotation R_from⁻¹ R_to: `pose_add(p_from, difference)` is `p_to`.

    The manual leaves the order of the rotations open.
    """
    end, start = pose(p_to, "p_to"), pose(p_from, "p_from")
    turn = rotvec_of(multiply(transpose(rotation_of(*start[3:])), rotation_of(*end[3:])))
    return Pose([a - b for a, b in zip(end[:3], start[:3], strict=True)] + list(turn))


def pose_dist(p_from: Value, p_to: Value) -> float:
    """Return the Euclidean length of the six elements of `pose_sub`; the manual says only that rotation counts."""
    return math.hypot(*pose_sub(p_to, p_from))


def point_dist(p_from: Value, p_to: Value) -> float:
    """Return the distance of the positions, m."""
    return math.dist(pose(p_from, "p_from")[:3], pose(p_to, "p_to")[:3])


def interpolate_pose(p_from: Value, p_to: Value, alpha: Value) -> Pose:
    """Interpolate from `p_from` at 0 to `p_to` at 1, straight and on the shortest rotation; extrapolate beyond."""
    start, end, share = pose(p_from, "p_from"), pose(p_to, "p_to"), number(alpha, "alpha")
    rotation = rotation_of(*start[3:])
    x, y, z = rotvec_of(multiply(transpose(rotation), rotation_of(*end[3:])))
    turn = rotvec_of(multiply(rotation, rotation_of(share * x, share * y, share * z)))
    return Pose([a + share * (b - a) for a, b in zip(start[:3], end[:3], strict=True)] + list(turn))


def wrench_trans(T_from_to: Value, w_from: Value) -> list[float]:  # noqa: N803  # the manual's name
    """Return the wrench `w_from`, force before torque, in the pose `T_from_to`: rotated, torque about that point."""
    to = pose(T_from_to, "T_from_to")
    wrench = vector(w_from, 6, "w_from")
    rotation = transpose(rotation_of(*to[3:]))
    moment = [m - lever for m, lever in zip(wrench[3:], cross(to[:3], wrench[:3]), strict=True)]
    return [*rotate(rotation, wrench[:3]), *rotate(rotation, moment)]


def rotvec2rpy(rotation_vector: Value) -> list[float]:
    """Return roll, pitch and yaw, rad, of R = Rz(yaw) Ry(pitch) Rx(roll)."""
    xx, _, _, yx, _, _, zx, zy, zz = rotation_of(*vector(rotation_vector, 3, "rotation_vector"))
    return [math.atan2(zy, zz), math.asin(min(1.0, max(-1.0, -zx))), math.atan2(yx, xx)]


def rpy2rotvec(rpy_vector: Value) -> list[float]:
    """Return the rotation vector, rad, of R = Rz(yaw) Ry(pitch) Rx(roll)."""
    roll, pitch, yaw = vector(rpy_vector, 3, "rpy_vector")
    turned = multiply(rotation_of(0.0, 0.0, yaw), multiply(rotation_of(0.0, pitch, 0.0), rotation_of(roll, 0.0, 0.0)))
    return list(rotvec_of(turned))


POSES: Final = {
    function.__name__: Builtin.of(function)
    for function in (
        interpolate_pose,
        point_dist,
        pose_add,
        pose_dist,
        pose_inv,
        pose_sub,
        pose_trans,
        rotvec2rpy,
        rpy2rotvec,
        wrench_trans,
    )
}
"""Builtins by script name."""
