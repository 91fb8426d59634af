"""Joint target of one arm, and the TCP at that target."""

import math
from collections.abc import Sequence

import numpy as np

from sim_backend.ur_controller.geometry import (
    Rotation,
    Vector,
    flange_of,
    multiply,
    rotate,
    rotation_of,
    rotvec_of,
    transpose,
)
from sim_backend.ur_controller.plant import Plant
from sim_backend.world.kinematics import JOINT_RANGE_RAD, JOINT_SPEED_RAD_S
from wire.arrays import FloatArray
from wire.records import TICK_S

from .differential import joint_rates, tool_twist
from .joint import JOINT_RAD_S2

_JOINTS = range(6)
_RANGE: tuple[float, ...] = tuple(JOINT_RANGE_RAD.tolist())
_SPEED: tuple[float, ...] = tuple(JOINT_SPEED_RAD_S.tolist())
_CAUTION = 0.95
_ROUNDING_RAD_S = 1e-9
_REST = np.zeros(6)
_REST.setflags(write=False)


class CannotMove(Exception):  # noqa: N818 - the limits of the arm are no error of a program
    """The arm cannot reach its target because of joint range, joint speed or a singularity; the text says which."""


class JointTarget:
    """Commanded joints at the end of the tick.

    A tool motion gives positions of the TCP. They are kept beside the joints, which follow them by one Newton step per
    tick: a twist integrates exactly, and the next step corrects the remainder of the last one.

    Args:
        plant: the arm, whose configured TCP is used.

    Attributes:
        q, qd: (6,) rad and rad/s, as plain floats; replaced, never changed in place.
        q_array, qd_array, qdd_array: the same as arrays, and rad/s²; replaced, never changed in place.
    """

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self.take_measured()

    def take_measured(self) -> None:
        """Set the target to the measured joints, at rest."""
        self.q: list[float] = self._plant.q.tolist()
        self.qd = [0.0] * 6
        self.q_array: FloatArray = np.array(self.q)
        self.qd_array: FloatArray = _REST
        self.qdd_array: FloatArray = _REST
        self._take_tool()

    @property
    def moving(self) -> bool:
        """A joint moves by more than the rounding of a tool motion at rest."""
        return any(abs(v) > _ROUNDING_RAD_S for v in self.qd)

    @property
    def retooled(self) -> bool:
        """Another TCP has been configured since the last tool motion."""
        return self._offset is not self._plant.tcp_offset

    def tool(self) -> tuple[Vector, Rotation]:
        """Return position and rotation of the TCP at the target, base frame."""
        if self.retooled:
            self._take_tool()
        if self._tool is None:
            self._tool = self.tool_at(self.q)
        return self._tool

    def tool_at(self, q: Sequence[float]) -> tuple[Vector, Rotation]:
        """Return position and rotation of the TCP at joint angles (6,)."""
        (x, y, z), rotation = flange_of(q)
        dx, dy, dz = rotate(rotation, self._offset[:3])
        return (x + dx, y + dy, z + dz), multiply(rotation, self._tool_rotation)

    def pose(self) -> list[float]:
        """Return the pose of the TCP at the target."""
        position, rotation = self.tool()
        return [*position, *rotvec_of(rotation)]

    def twist(self) -> list[float]:
        """Return the twist (6,) of the TCP at the target, base axes."""
        if self._twist is not None and not self.retooled:
            return list(self._twist)
        return tool_twist(self.q, self.tool()[0], self.qd) if self.moving else [0.0] * 6

    def twist_of(self, q: Sequence[float], qd: Sequence[float]) -> list[float]:
        """Return the twist (6,) of the TCP at joint angles and speeds (6,)."""
        return tool_twist(q, self.tool_at(q)[0], qd)

    def rest(self) -> None:
        """Keep the joints where they are."""
        if any(self.qd):
            self._twist = None
            self._set(self.q, [0.0] * 6)
        else:
            self.qdd_array = _REST

    def set_joints(self, q: list[float], qd: list[float]) -> None:
        """Set joint angles (6,) and speeds (6,).

        Raises:
            CannotMove: a joint would leave its range.
        """
        self._tool = self._twist = None
        self._set(q, qd)

    def set_tool(self, position: Vector, rotation: Rotation, twist: list[float]) -> None:
        """Set a position and rotation of the TCP, with a twist (6,), base frame.

        Raises:
            CannotMove: the arm is too near to a singularity, or a joint would exceed its speed or leave its range.
        """
        rates = self._rates_to(position, rotation)
        for i in _JOINTS:
            if abs(rates[i]) > _SPEED[i]:
                raise CannotMove(f"joint {i + 1} would have to turn faster than it can")
        self._set([a + TICK_S * v for a, v in zip(self.q, rates, strict=True)], rates)
        self._tool = position, rotation
        self._twist = twist

    def share_possible(self, position: Vector, rotation: Rotation) -> float:
        """Return the share, up to 1, of the way to a position and rotation of the TCP that the joints can go in one
        tick.

        Raises:
            CannotMove: the arm is too near to a singularity.
        """
        share = 1.0
        for rate, last, limit in zip(self._rates_to(position, rotation), self.qd, _SPEED, strict=True):
            size = abs(rate)
            most = min(_CAUTION * limit, max(math.copysign(1.0, rate) * last, 0.0) + JOINT_RAD_S2 * TICK_S)
            if share * size > most:
                share = most / size
        return share

    def _rates_to(self, position: Vector, rotation: Rotation) -> list[float]:
        """Return the joint speeds (6,) that bring the TCP there in one tick."""
        (x, y, z), here = self.tool_at(self.q)
        rx, ry, rz = rotvec_of(multiply(rotation, transpose(here)))
        rate = 1.0 / TICK_S
        rates = joint_rates(
            self.q,
            (x, y, z),
            (
                rate * (position[0] - x),
                rate * (position[1] - y),
                rate * (position[2] - z),
                rate * rx,
                rate * ry,
                rate * rz,
            ),
        )
        if rates is None:
            raise CannotMove("the arm is too close to a singularity for a motion of the tool")
        return rates

    def _set(self, q: list[float], qd: list[float]) -> None:
        for i in _JOINTS:
            if abs(q[i]) > _RANGE[i] and abs(q[i]) > abs(self.q[i]):
                raise CannotMove(f"joint {i + 1} is at the end of its range")
        self.qdd_array = np.array([(b - a) / TICK_S for a, b in zip(self.qd, qd, strict=True)])
        self.q, self.qd = q, qd
        self.q_array, self.qd_array = np.array(q), np.array(qd)

    def _take_tool(self) -> None:
        """Take the present TCP configuration as the tool."""
        self._offset = self._plant.tcp_offset
        self._tool_rotation = rotation_of(*self._offset[3:])
        self._tool: tuple[Vector, Rotation] | None = None
        self._twist: list[float] | None = None
