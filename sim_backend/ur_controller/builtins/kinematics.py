"""URScript's kinematics, and the queries of motion targets."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from sim_backend.ur_controller.controller import Controller
from sim_backend.ur_controller.geometry import compose
from sim_backend.ur_controller.motion.inverse import inverse_at
from sim_backend.ur_controller.script import Builtin, Pose, ScriptRuntimeError, Value
from sim_backend.ur_controller.script.budget import BUDGET
from sim_backend.ur_controller.script.values import number, pose, vector
from sim_backend.world import kinematics
from sim_backend.world.kinematics import JOINT_RANGE_RAD, KinematicsError

from .motion import NO_SOLUTION

ACTIVE_TCP = "active_tcp"
_SOLUTION_COST, _JACOBIAN_COST = 1000, 500
"""Operations charged for the eight solutions and for a Jacobian, in addition to those of any call."""
_MEASURED: list[float] = []
"""Default of joint angles that a script leaves out; it stands for the present measurement."""


def kinematics_builtins(controller: Controller) -> dict[str, Builtin]:
    """Return the kinematic functions of one controller by script name."""
    motion = controller.motion
    plant = controller.plant

    def offset_of(tcp: Value) -> Sequence[float]:
        return plant.tcp_offset if tcp == ACTIVE_TCP else pose(tcp, "tcp")

    def solve(x: Value, qnear: Value, tcp: Value) -> list[float] | None:
        near = plant.q.tolist() if qnear == _MEASURED else vector(qnear, 6, "qnear")
        BUDGET.take(_SOLUTION_COST)
        try:
            return inverse_at(pose(x, "x"), offset_of(tcp), near)
        except KinematicsError:
            return None

    def get_inverse_kin(
        x: Value,
        qnear: Value = _MEASURED,
        maxPositionError: Value = 1e-10,  # noqa: N803 - the manual's name
        maxOrientationError: Value = 1e-10,  # noqa: N803 - the manual's name
        tcp: Value = ACTIVE_TCP,
    ) -> list[float]:
        _errors(maxPositionError, maxOrientationError)
        q = solve(x, qnear, tcp)
        if q is None:
            raise ScriptRuntimeError(NO_SOLUTION)
        return q

    def get_inverse_kin_has_solution(
        pose: Value,
        qnear: Value = _MEASURED,
        maxPositionError: Value = 1e-10,  # noqa: N803 - the manual's name
        maxOrientationError: Value = 1e-10,  # noqa: N803 - the manual's name
        tcp: Value = ACTIVE_TCP,
    ) -> bool:
        _errors(maxPositionError, maxOrientationError)
        return solve(pose, qnear, tcp) is not None

    def get_forward_kin(q: Value = _MEASURED, tcp: Value = ACTIVE_TCP) -> Pose:
        angles = plant.q.tolist() if q == _MEASURED else vector(q, 6, "q")
        return Pose(compose(plant.flange_pose_of(angles), offset_of(tcp)))

    def get_jacobian(q: Value = _MEASURED, tcp: Value = ACTIVE_TCP) -> list[list[float]]:
        angles = plant.q.tolist() if q == _MEASURED else vector(q, 6, "q")
        BUDGET.take(_JACOBIAN_COST)
        return kinematics.jacobian(angles, offset_of(tcp)[:3]).tolist()

    def get_target_tcp_pose() -> Pose:
        return Pose(motion.target_tcp_pose())

    def get_target_tcp_speed() -> list[float]:
        return motion.target_tcp_speed()

    def get_target_joint_positions() -> list[float]:
        return motion.q_target.tolist()

    def get_target_joint_speeds() -> list[float]:
        return motion.qd_target.tolist()

    def get_target_joint_accelerations() -> list[float]:
        return motion.qdd_target.tolist()

    def get_target_waypoint() -> Pose:
        return Pose(motion.waypoint())

    def is_within_safety_limits(x: Value) -> bool:
        if type(x) is Pose:
            BUDGET.take(_SOLUTION_COST)
            return motion.reachable(x)
        return bool((np.abs(vector(x, 6, "x")) <= JOINT_RANGE_RAD).all())

    functions: tuple[Callable[..., Any], ...] = (
        get_inverse_kin,
        get_inverse_kin_has_solution,
        get_forward_kin,
        get_jacobian,
        get_target_tcp_pose,
        get_target_tcp_speed,
        get_target_joint_positions,
        get_target_joint_speeds,
        get_target_joint_accelerations,
        get_target_waypoint,
        is_within_safety_limits,
    )
    return {function.__name__: Builtin.of(function) for function in functions}


def _errors(position: Value, orientation: Value) -> None:
    """Check the errors allowed to a numerical solution; this solution is exact."""
    number(position, "maxPositionError")
    number(orientation, "maxOrientationError")
