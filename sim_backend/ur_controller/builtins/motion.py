"""URScript's motion functions: the `motion` module of the script manual.

Only one thread at a time can move the arm: the thread that waits in one of these functions. If that thread is killed,
the arm comes to rest by itself.
"""

from collections.abc import Callable, Generator
from typing import Any

import numpy as np

from sim_backend.ur_controller.controller import Controller
from sim_backend.ur_controller.motion import ForceTask, Motion
from sim_backend.ur_controller.script import Builtin, Pose, ScriptRuntimeError, Value
from sim_backend.ur_controller.script.values import integer, is_list, number, pose, quantities, text_of_kind, truth
from sim_backend.world.kinematics import JOINT_SPEED_RAD_S, KinematicsError
from wire.records import TICK_S

ANOTHER_THREAD = "Another thread is already controlling the robot"
NO_SOLUTION = "Unable to find an inverse kinematics solution"

Wait = Generator[None, None, None]

_SLOWEST_JOINT_RAD_S = float(JOINT_SPEED_RAD_S.min())
_OPTIMOVE_RAD_S2, _OPTIMOVE_M_S, _OPTIMOVE_M_S2 = 10.0, 1.0, 5.0
"""Values of a fraction of 1 in optimovej and optimovel. An assumption: UR publishes none."""
_ALL_FREE, _BASE = [1] * 6, Pose([0.0] * 6)
_LEAST_SHARE = 1e-6
_LEAST, _MOST = 1e-9, 1e6
"""Range of speeds, accelerations, times and radii: it exceeds any motion, and floats hold it without loss."""


def motion_builtins(controller: Controller) -> dict[str, Builtin]:
    """Return the motion functions of one controller by script name."""
    motion = controller.motion
    plant = controller.plant

    def moving(start: Callable[[], None]) -> Wait:
        """Move the arm and wait, as the only thread that may."""
        thread = None if controller.execution is None else controller.execution.current_thread
        if motion.owner is not None and motion.owner is not thread:
            raise ScriptRuntimeError(ANOTHER_THREAD)
        motion.owner = thread
        try:
            start()
            yield
            while not motion.ready:
                yield
        except GeneratorExit:
            motion.abandon()
            raise
        finally:
            if motion.owner is thread:
                motion.owner = None

    def joints_of(target: Value, what: str) -> list[float]:
        """Return the joint angles of a target, which is a list of them or a pose."""
        numbers = quantities(target, 6, what)
        if type(target) is not Pose:
            return numbers
        try:
            return motion.joints_at(numbers)
        except KinematicsError as error:
            raise ScriptRuntimeError(NO_SOLUTION) from error

    def pose_of(target: Value, what: str) -> list[float]:
        """Return the pose of a target, which is a pose or a list of joint angles."""
        numbers = quantities(target, 6, what)
        return numbers if type(target) is Pose else plant.tcp_pose_of(numbers)

    def movej(q: Value, a: Value = 1.4, v: Value = 1.05, t: Value = 0, r: Value = 0) -> Wait:
        target = joints_of(q, "q")
        limits = *_speeds(a, v, t), _not_negative(r, "r")
        return (yield from moving(lambda: motion.movej(target, *limits)))

    def movel(pose: Value, a: Value = 1.2, v: Value = 0.25, t: Value = 0, r: Value = 0) -> Wait:
        target = pose_of(pose, "pose")
        limits = *_speeds(a, v, t), _not_negative(r, "r")
        return (yield from moving(lambda: motion.movel(target, *limits)))

    def movep(pose: Value, a: Value = 1.2, v: Value = 0.25, r: Value = 0) -> Wait:
        target = pose_of(pose, "pose")
        limits = _positive(a, "a"), _positive(v, "v"), 0.0, _not_negative(r, "r")
        return (yield from moving(lambda: motion.movel(target, *limits)))

    def movec(pose_via: Value, pose_to: Value, a: Value = 1.2, v: Value = 0.25, r: Value = 0, mode: Value = 0) -> Wait:
        via, target = pose_of(pose_via, "pose_via"), pose_of(pose_to, "pose_to")
        limits = _positive(a, "a"), _positive(v, "v"), _not_negative(r, "r")
        fixed = integer(mode, "mode") == 1

        def start() -> None:
            try:
                motion.movec(via, target, *limits, fixed=fixed)
            except ValueError as error:
                raise ScriptRuntimeError(f"movec: {error}") from error

        return (yield from moving(start))

    def optimovej(goal: Value, a: Value = 0.3, v: Value = 0.3, r: Value = 0) -> Wait:
        target = joints_of(goal, "goal")
        limits = _share(a, "a") * _OPTIMOVE_RAD_S2, _share(v, "v") * _SLOWEST_JOINT_RAD_S, 0.0, _not_negative(r, "r")
        return (yield from moving(lambda: motion.movej(target, *limits)))

    def optimovel(goal: Value, a: Value = 0.3, v: Value = 0.3, r: Value = 0) -> Wait:
        target = pose_of(goal, "goal")
        limits = _share(a, "a") * _OPTIMOVE_M_S2, _share(v, "v") * _OPTIMOVE_M_S, 0.0, _not_negative(r, "r")
        return (yield from moving(lambda: motion.movel(target, *limits)))

    def servoj(
        q: Value, a: Value = 0, v: Value = 0, t: Value = TICK_S, lookahead_time: Value = 0.1, gain: Value = 300
    ) -> Wait:
        target = quantities(q, 6, "q")
        time_s = _not_negative(t, "t")
        lookahead_s = _between(lookahead_time, 0.03, 0.2, "lookahead_time")
        stiffness = _between(gain, 100.0, 2000.0, "gain")
        return (yield from moving(lambda: motion.servoj(target, time_s, lookahead_s, stiffness)))

    def servoc(pose: Value, a: Value = 1.2, v: Value = 0.25, r: Value = 0) -> Wait:
        target = pose_of(pose, "pose")
        limits = _positive(a, "a"), _positive(v, "v"), _not_negative(r, "r")
        return (yield from moving(lambda: motion.servoc(target, *limits)))

    def speedj(qd: Value, a: Value, t: Value = 0) -> Wait:
        speeds = quantities(qd, 6, "qd")
        limits = _positive(a, "a"), _not_negative(t, "t")
        return (yield from moving(lambda: motion.speedj(speeds, *limits)))

    def speedl(xd: Value, a: Value, t: Value = 0, aRot: Value = "a") -> Wait:  # noqa: N803 - the manual's name
        twist = quantities(xd, 6, "xd")
        acceleration, time_s = _positive(a, "a"), _not_negative(t, "t")
        turning = acceleration if aRot == "a" else _positive(aRot, "aRot")
        return (yield from moving(lambda: motion.speedl(twist, acceleration, time_s, turning)))

    def stopj(a: Value) -> Wait:
        deceleration = _positive(a, "a")
        return (yield from moving(lambda: motion.stopj(deceleration)))

    def stopl(a: Value, aRot: Value = "a") -> Wait:  # noqa: N803 - the manual's name
        deceleration = _positive(a, "a")
        turning = deceleration if aRot == "a" else _positive(aRot, "aRot")
        return (yield from moving(lambda: motion.stopl(deceleration, turning)))

    def force_mode(
        task_frame: Value,
        selection_vector: Value,
        wrench: Value,
        type_: Value,
        limits: Value,
    ) -> None:
        selection = [number(item, "selection_vector") for item in _list(selection_vector, "selection_vector")]
        if any(item not in (0.0, 1.0) for item in selection):
            raise ScriptRuntimeError("force_mode: selection_vector must hold 0 and 1 only")
        kind = integer(type_, "type")
        if kind not in (1, 2, 3):
            raise ScriptRuntimeError(f"force_mode: type must be 1, 2 or 3, not {kind}")
        largest = quantities(limits, 6, "limits")
        if min(largest) < 0.0:
            raise ScriptRuntimeError("force_mode: limits must not be negative")
        compliant = [item == 1.0 for item in selection]
        frame, force = quantities(task_frame, 6, "task_frame"), quantities(wrench, 6, "wrench")
        motion.force(ForceTask(frame, compliant, force, kind, largest))

    def force_mode_set_damping(damping: Value) -> None:
        motion.force_damping = _between(damping, 0.0, 1.0, "damping")

    def force_mode_set_gain_scaling(scaling: Value) -> None:
        motion.force_gain = _between(scaling, 0.0, 2.0, "scaling")

    def freedrive_mode(freeAxes: Value = _ALL_FREE, feature: Value = _BASE) -> None:  # noqa: N803 - the manual's name
        axes = [truth(item, "freeAxes") for item in _list(freeAxes, "freeAxes")]
        motion.freedrive(axes, _feature(motion, feature))

    def tool_contact(direction: Value) -> int:
        return motion.memory.touched(np.array(quantities(direction, 6, "direction")[:3]))

    def get_actual_joint_positions_history(steps: Value = 0) -> list[float]:
        past = motion.memory.joints(integer(steps, "steps"))
        if past is None:
            raise ScriptRuntimeError(f"get_actual_joint_positions_history: {steps} steps are beyond its buffer")
        return past.tolist()

    def is_steady() -> bool:
        return motion.is_steady

    def get_freedrive_status() -> int:
        return motion.freedrive_status()

    named: dict[str, Callable[..., Any]] = {
        "movej": movej,
        "movel": movel,
        "movep": movep,
        "movec": movec,
        "optimovej": optimovej,
        "optimovel": optimovel,
        "servoj": servoj,
        "servoc": servoc,
        "speedj": speedj,
        "speedl": speedl,
        "stopj": stopj,
        "stopl": stopl,
        "force_mode": force_mode,
        "end_force_mode": lambda: motion.end_force(),
        "force_mode_set_damping": force_mode_set_damping,
        "force_mode_set_gain_scaling": force_mode_set_gain_scaling,
        "freedrive_mode": freedrive_mode,
        "end_freedrive_mode": lambda: motion.end_freedrive(),
        "teach_mode": lambda: motion.freedrive(),
        "end_teach_mode": lambda: motion.end_freedrive(),
        "get_freedrive_status": get_freedrive_status,
        "tool_contact": tool_contact,
        "get_actual_joint_positions_history": get_actual_joint_positions_history,
        "is_steady": is_steady,
    }
    return {name: Builtin.of(function) for name, function in named.items()}


def _feature(motion: Motion, feature: Value) -> list[float]:
    """Return the pose of a feature that a script names or gives."""
    if feature == "base":
        return [0.0] * 6
    if feature == "tool":
        return motion.target_tcp_pose()
    pose(feature, "feature")
    return quantities(feature, 6, "feature")


def _list(value: Value, what: str) -> list[Value]:
    if is_list(value) and len(value) == 6:
        return value
    raise ScriptRuntimeError(f"Type error: {what} must be a list of 6, not {text_of_kind(value)}")


def _speeds(a: Value, v: Value, t: Value) -> tuple[float, float, float]:
    """Return acceleration, speed and time of a move; a given time overrides the other two."""
    time_s = _not_negative(t, "t")
    if time_s > 0.0:
        return _not_negative(a, "a"), _not_negative(v, "v"), time_s
    return _positive(a, "a"), _positive(v, "v"), time_s


def _positive(value: Value, what: str) -> float:
    result = number(value, what)
    if not 0.0 < result <= _MOST:
        raise ScriptRuntimeError(f"{what} must be larger than 0 and no more than {_MOST:.0f}, not {result}")
    return max(result, _LEAST)  # UR's client asks for accelerations of 1e-11, the rounding remainder of 0


def _not_negative(value: Value, what: str) -> float:
    result = number(value, what)
    if not 0.0 <= result <= _MOST:
        raise ScriptRuntimeError(f"{what} must lie in 0 … {_MOST:.0f}, not {result}")
    return result


def _between(value: Value, low: float, high: float, what: str) -> float:
    result = number(value, what)
    if not low <= result <= high:
        raise ScriptRuntimeError(f"{what} must be from {low} to {high}, not {result}")
    return result


def _share(value: Value, what: str) -> float:
    return max(_between(value, 0.0, 1.0, what), _LEAST_SHARE)
