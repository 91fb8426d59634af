"""Kinematics of the UR3e: constants, forward and inverse kinematics, Jacobian, distance to singularities.

The Denavit-Hartenberg table, link masses and centres of mass are Universal Robots' published DH parameters of the UR3e.
Inertias are the cylinder approximations of UR's ROS description; limits are those of the data sheet. A real arm
deviates from the nominal values; its calibration is read from the arm.

The base frame is the controller's: z up, joint 1 about z. Positions in m, joint angles in rad. All functions take any
batch shape. The flange is the DH frame 6.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from wire.arrays import BoolArray, FloatArray

GRAVITY_M_S2 = 9.81
"""Gravity along the base's -z: the arm stands upright."""


class KinematicsError(ValueError):
    """A pose that the arm cannot reach; the text names the pose."""


@dataclass(frozen=True, slots=True)
class Joint:
    """One joint and the link that it moves.

    Attributes:
        a_m: DH link length.
        d_m: DH link offset.
        alpha_rad: DH link twist.
        mass_kg: mass of the link.
        com_m: centre of mass of the link, in the DH frame that moves with it.
        inertia_kg_m2: principal inertias about the centre of mass, along the axes of that frame.
        range_rad: largest angle to either side; infinite for a joint without end stops.
        speed_rad_s: largest speed.
        torque_nm: largest torque.
    """

    a_m: float
    d_m: float
    alpha_rad: float
    mass_kg: float
    com_m: tuple[float, float, float]
    inertia_kg_m2: tuple[float, float, float]
    range_rad: float
    speed_rad_s: float
    torque_nm: float


_TURN = 2.0 * math.pi
_UPRIGHT = math.pi / 2.0
_SLOW, _FAST = math.radians(180.0), math.radians(360.0)

UR3E: tuple[Joint, ...] = (
    Joint(0.0, 0.15185, _UPRIGHT, 1.98, (0.0, -0.02, 0.0), (0.00809, 0.00563, 0.00809), _TURN, _SLOW, 54.0),
    Joint(-0.24355, 0.0, 0.0, 3.4445, (0.13, 0.0, 0.1157), (0.00962, 0.02173, 0.02173), _TURN, _SLOW, 54.0),
    Joint(-0.2132, 0.0, 0.0, 1.437, (0.05, 0.0, 0.0238), (0.00354, 0.00654, 0.00654), _TURN, _SLOW, 28.0),
    Joint(0.0, 0.13105, _UPRIGHT, 0.871, (0.0, 0.0, 0.01), (0.00209, 0.00209, 0.00225), _TURN, _FAST, 9.0),
    Joint(0.0, 0.08535, -_UPRIGHT, 0.805, (0.0, 0.0, 0.01), (0.00209, 0.00209, 0.00225), _TURN, _FAST, 9.0),
    Joint(0.0, 0.0921, 0.0, 0.261, (0.0, 0.0, -0.02), (0.000136, 0.000136, 0.000179), math.inf, _FAST, 9.0),
)
"""Frames from base to flange."""

RATED_PAYLOAD_KG = 3.0
JOINT_RANGE_RAD: FloatArray = np.array([joint.range_rad for joint in UR3E])
JOINT_SPEED_RAD_S: FloatArray = np.array([joint.speed_rad_s for joint in UR3E])
JOINT_TORQUE_NM: FloatArray = np.array([joint.torque_nm for joint in UR3E])
for _constant in (JOINT_RANGE_RAD, JOINT_SPEED_RAD_S, JOINT_TORQUE_NM):
    _constant.setflags(write=False)

_D1, _D4, _D5, _D6 = UR3E[0].d_m, UR3E[3].d_m, UR3E[4].d_m, UR3E[5].d_m
_A2, _A3 = UR3E[1].a_m, UR3E[2].a_m
LENGTHS_M: Mapping[str, float] = MappingProxyType({"d1": _D1, "a2": _A2, "a3": _A3, "d4": _D4, "d5": _D5, "d6": _D6})
"""DH lengths and offsets that are not zero, m."""
_EDGE = 1e-9  # rounding tolerance at the rim of the workspace, in sines and cosines


def forward(q: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the flange's position (..., 3) and rotation (..., 3, 3) in the base frame for joint angles (..., 6)."""
    return _Chain(q).flange()


def jacobian(q: npt.ArrayLike, tool_offset: npt.ArrayLike) -> FloatArray:
    """Return the geometric Jacobian at a point fixed to the flange.

    Args:
        q: (..., 6) joint angles.
        tool_offset: (..., 3) the point, in the flange's frame.

    Returns:
        (..., 6, 6), base frame; rows are the point's linear velocity, then the angular velocity, per joint speed.
    """
    return forward_and_jacobian(q, tool_offset)[2]


def forward_and_jacobian(q: npt.ArrayLike, tool_offset: npt.ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the flange's pose as `forward` and the Jacobian as `jacobian`, at the cost of one of them."""
    chain = _Chain(q)
    position, rotation = chain.flange()
    offset = np.asarray(tool_offset, np.float64)
    x, y, z = offset[..., :1], offset[..., 1:2], offset[..., 2:]
    point = position + (rotation[..., 0] * x + rotation[..., 1] * y + rotation[..., 2] * z)
    return position, rotation, chain.jacobian(point)


def singularity_margin(q: npt.ArrayLike) -> FloatArray:
    """Return the distances of joint angles (..., 6) from the three singularities: (..., 3), each 0 (singular) … 1.

    In order: shoulder (wrist centre above the base axis, as a fraction of its largest distance), elbow (arm straight,
    |sin q3|), wrist (joints 4 and 6 in line, |sin q5|). The determinant of the Jacobian is their product times a
    constant, so the smallest value identifies the nearest singularity.
    """
    chain = _Chain(q)
    angles = np.asarray(q, np.float64)
    shoulder = np.abs(chain.wrist_x + _D5 * chain.s234) / (abs(_A2) + abs(_A3) + _D5)
    return np.stack((shoulder, np.abs(np.sin(angles[..., 2])), np.abs(chain.s5)), -1)


def inverse(position: npt.ArrayLike, rotation: npt.ArrayLike, q_near: npt.ArrayLike) -> FloatArray:
    """Return the joint angles (..., 6) nearest to `q_near` that bring the flange to a pose.

    Args:
        position: (..., 3) position of the flange, base frame.
        rotation: (..., 3, 3) orientation of the flange.
        q_near: (..., 6) preferred joint angles, within the joint range. With the wrist singular, joint 6 keeps its
            value, even if only another value has a solution. Next to a limit the nearest solution can be a whole turn
            or another branch away, so a caller that follows a path must check the returned step.

    Raises:
        KinematicsError: a pose has no solution within the joint range.
    """
    q, found = inverse_where_found(position, rotation, q_near)
    if not found.all():
        positions = np.broadcast_to(np.asarray(position, np.float64), (*found.shape, 3))
        x, y, z = positions[~found][0]
        raise KinematicsError(
            f"no joint angles within range bring the UR3e's flange to [{x:.4f}, {y:.4f}, {z:.4f}] m in the orientation"
            f" asked for ({int((~found).sum())} of {found.size} poses); move the target closer to the base or turn it"
        )
    return q


def inverse_where_found(
    position: npt.ArrayLike, rotation: npt.ArrayLike, q_near: npt.ArrayLike
) -> tuple[FloatArray, BoolArray]:
    """Return the result of `inverse` and the mask (...) of poses with a solution; without one the angles are
    `q_near`.
    """
    near = np.asarray(q_near, np.float64)
    candidates, valid = _branches(np.asarray(position, np.float64), np.asarray(rotation, np.float64), near)
    reference = near[..., None, :]
    candidates = reference + np.remainder(candidates - reference + np.pi, _TURN) - np.pi
    # A whole turn brings an angle that the nearest wrap moved out of the joint's range back into it.
    candidates -= _TURN * np.sign(candidates) * (np.abs(candidates) > JOINT_RANGE_RAD)
    distance = ((candidates - reference) ** 2).sum(-1)
    distance = np.where(valid & np.isfinite(distance), distance, np.inf)
    best = distance.argmin(-1)[..., None]
    found = np.isfinite(np.take_along_axis(distance, best, -1)[..., 0])
    q = np.take_along_axis(candidates, best[..., None], -2)[..., 0, :]
    return np.where(found[..., None], q, near), found


def _branches(position: FloatArray, rotation: FloatArray, near: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the eight solutions (..., 8, 6), angles modulo 2π, and which of them are real (..., 8)."""
    shape = np.broadcast_shapes(position.shape[:-1], rotation.shape[:-2], near.shape[:-1])
    side = np.array([1.0, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0, -1.0])
    flip = np.array([1.0, 1.0, -1.0, -1.0, 1.0, 1.0, -1.0, -1.0])
    bend = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    x_axis, y_axis, z_axis = (rotation[..., None, :, i] for i in range(3))

    # Shoulder: the wrist is offset from the arm's vertical plane by d4.
    wrist = position[..., None, :] - _D6 * z_axis
    radius = np.hypot(wrist[..., 0], wrist[..., 1])
    ratio = _D4 / np.maximum(radius, 1e-12)
    valid = ratio <= 1.0 + _EDGE
    lean = np.arcsin(np.minimum(ratio, 1.0))
    q1 = np.arctan2(wrist[..., 1], wrist[..., 0]) + np.where(side > 0.0, lean, np.pi - lean)
    s1, c1 = np.sin(q1), np.cos(q1)

    # Wrist: the flange's axes along the plane's normal (s1, -c1, 0).
    along_x = x_axis[..., 0] * s1 - x_axis[..., 1] * c1
    along_y = y_axis[..., 0] * s1 - y_axis[..., 1] * c1
    along_z = z_axis[..., 0] * s1 - z_axis[..., 1] * c1
    sine5 = np.hypot(along_x, along_y)
    q5 = flip * np.arctan2(sine5, along_z)
    q6 = np.where(sine5 > 1e-9, np.arctan2(-flip * along_y, flip * along_x), near[..., None, 5])
    s6, c6 = np.sin(q6)[..., None], np.cos(q6)[..., None]
    wrist_axis = -(s6 * x_axis + c6 * y_axis)
    s234 = wrist_axis[..., 0] * c1 + wrist_axis[..., 1] * s1
    c234 = -wrist_axis[..., 2]

    # Elbow: two links in the plane.
    u = wrist[..., 0] * c1 + wrist[..., 1] * s1 - _D5 * s234
    v = wrist[..., 2] - _D1 + _D5 * c234
    cosine3 = (u * u + v * v - _A2 * _A2 - _A3 * _A3) / (2.0 * _A2 * _A3)
    valid = valid & (np.abs(cosine3) <= 1.0 + _EDGE)
    q3 = bend * np.arccos(np.clip(cosine3, -1.0, 1.0))
    q2 = np.arctan2(v, u) - np.arctan2(_A3 * np.sin(q3), _A2 + _A3 * np.cos(q3))
    q4 = np.arctan2(s234, c234) - q2 - q3

    solutions = np.empty((*shape, 8, 6))
    for joint, angle in enumerate((q1, q2, q3, q4, q5, q6)):
        solutions[..., joint] = angle
    return solutions, np.broadcast_to(valid, (*shape, 8))


class _Chain:
    """Sines, cosines and in-plane coordinates of the arm; joints 2, 3 and 4 turn in one vertical plane."""

    __slots__ = ("c1", "c5", "c6", "c234", "elbow_x", "elbow_z", "s1", "s5", "s6", "s234", "wrist_x", "wrist_z")

    def __init__(self, q: npt.ArrayLike) -> None:
        angles = np.asarray(q, np.float64)
        sums = np.empty_like(angles)  # q1, q2, q2 + q3, q2 + q3 + q4, q5, q6
        sums[..., 0] = angles[..., 0]
        np.cumsum(angles[..., 1:4], -1, out=sums[..., 1:4])
        sums[..., 4:] = angles[..., 4:]
        sine, cosine = np.sin(sums), np.cos(sums)
        self.s1, self.c1 = sine[..., 0], cosine[..., 0]
        self.elbow_x, self.elbow_z = _A2 * cosine[..., 1], _A2 * sine[..., 1] + _D1
        self.wrist_x = self.elbow_x + _A3 * cosine[..., 2]
        self.wrist_z = self.elbow_z + _A3 * sine[..., 2]
        self.s234, self.c234 = sine[..., 3], cosine[..., 3]
        self.s5, self.c5 = sine[..., 4], cosine[..., 4]
        self.s6, self.c6 = sine[..., 5], cosine[..., 5]

    def flange(self) -> tuple[FloatArray, FloatArray]:
        s1, c1, s5, c5, s6, c6 = self.s1, self.c1, self.s5, self.c5, self.s6, self.c6
        rotation = np.empty((*s1.shape, 3, 3))
        x4_x, x4_y, x4_z = c1 * self.c234, s1 * self.c234, self.s234
        z4_x, z4_y, z4_z = c1 * self.s234, s1 * self.s234, -self.c234
        x5_x, x5_y, x5_z = c5 * x4_x + s5 * s1, c5 * x4_y - s5 * c1, c5 * x4_z
        rotation[..., 0, 0] = c6 * x5_x - s6 * z4_x
        rotation[..., 1, 0] = c6 * x5_y - s6 * z4_y
        rotation[..., 2, 0] = c6 * x5_z - s6 * z4_z
        rotation[..., 0, 1] = -s6 * x5_x - c6 * z4_x
        rotation[..., 1, 1] = -s6 * x5_y - c6 * z4_y
        rotation[..., 2, 1] = -s6 * x5_z - c6 * z4_z
        rotation[..., 0, 2] = c5 * s1 - s5 * x4_x
        rotation[..., 1, 2] = -c5 * c1 - s5 * x4_y
        rotation[..., 2, 2] = -s5 * x4_z
        position = np.empty((*s1.shape, 3))
        position[..., 0] = c1 * self.wrist_x + _D4 * s1 + _D5 * z4_x
        position[..., 1] = s1 * self.wrist_x - _D4 * c1 + _D5 * z4_y
        position[..., 2] = self.wrist_z + _D5 * z4_z
        position += _D6 * rotation[..., 2]
        return position, rotation

    def jacobian(self, point: FloatArray) -> FloatArray:
        """Return the Jacobian (..., 6, 6) at `point` (..., 3), base frame."""
        s1, c1 = self.s1, self.c1
        x, y, z = point[..., 0], point[..., 1], point[..., 2]
        result = np.zeros((*np.broadcast_shapes(point.shape[:-1], s1.shape), 6, 6))
        result[..., 0, 0], result[..., 1, 0], result[..., 5, 0] = -y, x, 1.0
        reach = x * c1 + y * s1  # the point in the arm's plane, in which joints 2 to 4 turn it
        for joint, (centre_x, centre_z) in enumerate(
            ((0.0, _D1), (self.elbow_x, self.elbow_z), (self.wrist_x, self.wrist_z)), start=1
        ):
            up = z - centre_z
            result[..., 0, joint] = -c1 * up
            result[..., 1, joint] = -s1 * up
            result[..., 2, joint] = reach - centre_x
            result[..., 3, joint] = s1
            result[..., 4, joint] = -c1
        z4_x, z4_y, z4_z = c1 * self.s234, s1 * self.s234, -self.c234
        z5_x = self.c5 * s1 - self.s5 * c1 * self.c234
        z5_y = -self.c5 * c1 - self.s5 * s1 * self.c234
        z5_z = -self.s5 * self.s234
        # The centre of frame 5 lies on both wrist axes.
        from_x = x - (c1 * self.wrist_x + _D4 * s1 + _D5 * z4_x)
        from_y = y - (s1 * self.wrist_x - _D4 * c1 + _D5 * z4_y)
        from_z = z - (self.wrist_z + _D5 * z4_z)
        for joint, (axis_x, axis_y, axis_z) in ((4, (z4_x, z4_y, z4_z)), (5, (z5_x, z5_y, z5_z))):
            result[..., 0, joint] = axis_y * from_z - axis_z * from_y
            result[..., 1, joint] = axis_z * from_x - axis_x * from_z
            result[..., 2, joint] = axis_x * from_y - axis_y * from_x
            result[..., 3, joint] = axis_x
            result[..., 4, joint] = axis_y
            result[..., 5, joint] = axis_z
        return result
