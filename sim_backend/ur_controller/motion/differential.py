"""Conversion between joint speeds and tool speeds of the UR3e, in plain floats and closed form.

Joints 2, 3 and 4 turn about one direction and the last three nearly about one point, so the Jacobian is neither built
nor inverted: the wrist's centre gives joint 1, the tool's orientation gives the wrist, and the rest is two links in a
plane. A division by zero in a step is a singularity; each of the three steps has one.
"""

import math
from collections.abc import Sequence

from sim_backend.world.kinematics import UR3E

SINGULAR = 0.01
"""Margin, as `kinematics.singularity_margin`, below which tool motions are not followed."""

_D1, _D4, _D5 = UR3E[0].d_m, UR3E[3].d_m, UR3E[4].d_m
_A2, _A3 = UR3E[1].a_m, UR3E[2].a_m
_REACH = abs(_A2) + abs(_A3) + _D5


def joint_rates(
    q: Sequence[float], point: Sequence[float], twist: Sequence[float], margin: float = SINGULAR
) -> list[float] | None:
    """Return the joint speeds that give a point fixed to the flange a twist.

    Args:
        q: six joint angles, rad.
        point: (3,) present position of the point, base frame, m.
        twist: (6,) linear velocity of the point and angular velocity, base frame.
        margin: smallest allowed margin to a singularity, 0 … 1.

    Returns:
        Six joint speeds, rad/s; None if the arm is nearer to a singularity.
    """
    q1, q2, q3, q4, q5, _ = q
    vx, vy, vz, wx, wy, wz = twist
    s1, c1 = math.sin(q1), math.cos(q1)
    s2, c2 = math.sin(q2), math.cos(q2)
    q23 = q2 + q3
    s23, c23 = math.sin(q23), math.cos(q23)
    s234, c234 = math.sin(q23 + q4), math.cos(q23 + q4)
    s3, s5, c5 = math.sin(q3), math.sin(q5), math.cos(q5)
    reach = _A2 * c2 + _A3 * c23 + _D5 * s234
    if abs(reach) < margin * _REACH or abs(s3) < margin or abs(s5) < margin:
        return None
    # velocity of the wrist's centre: along the arm's plane (c1, s1), across it (s1, -c1), and up
    from_x = c1 * reach + s1 * _D4 - point[0]
    from_y = s1 * reach - c1 * _D4 - point[1]
    from_z = _D1 + _A2 * s2 + _A3 * s23 - _D5 * c234 - point[2]
    vx += wy * from_z - wz * from_y
    vy += wz * from_x - wx * from_z
    vz += wx * from_y - wy * from_x
    rate1 = (c1 * vy - s1 * vx) / reach
    along = c1 * vx + s1 * vy - _D4 * rate1
    # rotation by the wrist and the sum of joints 2 to 4; the last axis is c5 · across - s5 · (c234 along + s234 up)
    wz -= rate1
    w_along, w_across = c1 * wx + s1 * wy, s1 * wx - c1 * wy
    rate6 = -(c234 * w_along + s234 * wz) / s5
    rate5 = s234 * w_along - c234 * wz
    pitch = w_across - c5 * rate6
    # two links in the plane
    along -= _D5 * c234 * pitch
    up = vz - _D5 * s234 * pitch
    upper = (along * c23 + up * s23) / (_A2 * s3)
    fore = -(along * c2 + up * s2) / (_A3 * s3)
    return [rate1, upper, fore - upper, pitch - fore, rate5, rate6]


def tool_twist(q: Sequence[float], point: Sequence[float], rates: Sequence[float]) -> list[float]:
    """Return the twist (6,) of a point fixed to the flange, base frame, for joint speeds; inverts `joint_rates`."""
    q1, q2, q3, q4, q5, _ = q
    rate1, rate2, rate3, rate4, rate5, rate6 = rates
    s1, c1 = math.sin(q1), math.cos(q1)
    q23 = q2 + q3
    s234, c234 = math.sin(q23 + q4), math.cos(q23 + q4)
    s5, c5 = math.sin(q5), math.cos(q5)
    upper_x, upper_z = _A2 * math.cos(q2), _A2 * math.sin(q2)
    fore_x, fore_z = _A3 * math.cos(q23), _A3 * math.sin(q23)
    hand_x, hand_z = _D5 * s234, -_D5 * c234
    reach = upper_x + fore_x + hand_x
    fore, pitch = rate2 + rate3, rate2 + rate3 + rate4
    along = _D4 * rate1 - (upper_z * rate2 + fore_z * fore + hand_z * pitch)
    across = -reach * rate1
    up = upper_x * rate2 + fore_x * fore + hand_x * pitch
    w_across = pitch + c5 * rate6
    w_along = s234 * rate5 - s5 * c234 * rate6
    wx, wy = c1 * w_along + s1 * w_across, s1 * w_along - c1 * w_across
    wz = rate1 - c234 * rate5 - s5 * s234 * rate6
    to_x = point[0] - (c1 * reach + s1 * _D4)
    to_y = point[1] - (s1 * reach - c1 * _D4)
    to_z = point[2] - (_D1 + upper_z + fore_z + hand_z)
    return [
        c1 * along + s1 * across + wy * to_z - wz * to_y,
        s1 * along - c1 * across + wz * to_x - wx * to_z,
        up + wx * to_y - wy * to_x,
        wx,
        wy,
        wz,
    ]
