"""Script builtins for the robot's measurements, its configured tool and payload, and its messages to people."""

import math
from collections.abc import Callable, Generator, Sequence
from typing import Any

from sim_backend.ur_controller.builtins.strings import text_of
from sim_backend.ur_controller.controller import Controller
from sim_backend.ur_controller.events import Popup, Text
from sim_backend.ur_controller.safety import ASKED_BY_PROGRAM
from sim_backend.ur_controller.script import Builtin, Pose, ScriptRuntimeError, Struct
from sim_backend.ur_controller.script.budget import BUDGET
from sim_backend.ur_controller.script.values import (
    LARGEST_QUANTITY,
    Value,
    integer,
    number,
    pose,
    quantities,
    text,
    truth,
)
from wire.records import TICK_S

_KEPT: list[float] = []
"""Default of a vector; it keeps the present value."""
_CONFIGURING_COST = 150
"""Operations charged for a change of TCP or payload, in addition to those of any call."""


def state_builtins(controller: Controller) -> dict[str, Builtin]:
    """Return the builtins for the state and the configuration of `controller`."""
    plant = controller.plant

    def carry(kg: float, cog: Sequence[float], inertia: Sequence[float] | None = None) -> None:
        """Configure the payload, and zero the sensor: the manual says both of `set_payload`, `set_target_payload`."""
        BUDGET.take(_CONFIGURING_COST)
        plant.set_payload(kg, cog, inertia)
        plant.zero_ft()

    def get_actual_tcp_pose() -> Pose:
        return Pose(plant.tcp_pose())

    def get_actual_tcp_speed() -> list[float]:
        return plant.tcp_speed()

    def get_actual_tool_flange_pose() -> Pose:
        return Pose(plant.flange_pose_of(plant.q.tolist()))

    def get_actual_joint_positions() -> list[float]:
        return plant.q.tolist()

    def get_actual_joint_speeds() -> list[float]:
        return plant.qd.tolist()

    def get_joint_torques() -> list[float]:
        return plant.joint_torques().tolist()

    def get_tcp_force() -> list[float]:
        return plant.flange_wrench()

    def force() -> float:
        x, y, z = plant.wrench[:3].tolist()
        return math.sqrt(x * x + y * y + z * z)

    def get_tool_accelerometer_reading() -> list[float]:
        return plant.tool_acceleration()

    def get_joint_temp(j: Value) -> float:
        joint = integer(j, "j")
        if not 0 <= joint < 6:
            raise ScriptRuntimeError(f"joint must lie in 0 … 5, not {joint}")
        return controller.temperature_c

    def temperature() -> float:
        return controller.temperature_c

    def get_tool_current() -> float:
        return 0.0

    def get_steptime() -> float:
        return TICK_S

    def time() -> Struct:
        whole = int(controller.time_s)
        return Struct(sec=whole, nanosec=round((controller.time_s - whole) * 1e9))

    def set_tcp(pose_: Value) -> None:
        BUDGET.take(_CONFIGURING_COST)
        plant.set_tcp(quantities(pose(pose_, "pose"), 6, "pose"))

    def get_tcp_offset() -> Pose:
        return Pose(plant.tcp_offset)

    def set_payload(m: Value, cog: Value = _KEPT) -> None:
        carry(_mass(m), _vector(cog, plant.tcp_offset[:3], "cog"), (0.0,) * 6)

    def set_payload_mass(m: Value) -> None:
        carry(_mass(m), plant.payload_cog)

    def set_payload_cog(CoG: Value) -> None:  # noqa: N803 (the manual's name)
        carry(plant.payload_kg, _vector(CoG, plant.payload_cog, "CoG"))

    def set_target_payload(
        m: Value, cog: Value, inertia: Value = _KEPT, transition_time: Value = 0.0
    ) -> Generator[None, None, None]:
        mass, centre = _mass(m), _vector(cog, plant.payload_cog, "cog")
        matrix = _vector(inertia, (0.0,) * 6, "inertia")
        ticks = round(number(transition_time, "transition_time") / TICK_S)
        first_mass, first_centre = plant.payload_kg, plant.payload_cog
        for tick in range(1, ticks):
            share = tick / ticks
            carry(
                first_mass + share * (mass - first_mass),
                [a + share * (b - a) for a, b in zip(first_centre, centre, strict=True)],
            )
            yield
        carry(mass, centre, matrix)

    def get_target_payload() -> float:
        return plant.payload_kg

    def get_target_payload_cog() -> list[float]:
        return list(plant.payload_cog)

    def get_target_payload_inertia() -> list[float]:
        return list(plant.payload_inertia)

    def set_gravity(d: Value) -> None:
        x, y, z = quantities(d, 3, "d")
        controller.gravity = (x, y, z)

    def zero_ftsensor() -> None:
        plant.zero_ft()

    def ft_rtde_input_enable(
        enable: Value,
        sensor_mass: Value = 0.0,
        sensor_measuring_offset: Value = _KEPT,
        sensor_cog: Value = _KEPT,
    ) -> None:
        lever = _vector(sensor_measuring_offset, (0.0, 0.0, 0.0), "sensor_measuring_offset")
        _mass(sensor_mass)
        _vector(sensor_cog, (0.0, 0.0, 0.0), "sensor_cog")
        controller.use_external_sensor(lever if truth(enable, "enable") else None)

    def textmsg(s1: Value, s2: Value = "") -> None:
        controller.emit(Text(text_of(s1) + text_of(s2)))

    def popup(
        s: Value, title: Value = "Popup", warning: Value = False, error: Value = False, blocking: Value = False
    ) -> Generator[None, None, None]:
        waits = truth(blocking, "blocking")
        message = Popup(text_of(s), text(title, "title"), truth(warning, "warning"), truth(error, "error"), waits)
        controller.show(message)
        while waits and controller.popup is message:
            yield

    def protective_stop() -> Generator[None, None, None]:
        controller.protective_stop(ASKED_BY_PROGRAM)
        yield

    def powerdown() -> Generator[None, None, None]:
        controller.power_off()
        yield

    calls: tuple[Callable[..., Any], ...] = (
        get_actual_tcp_pose,
        get_actual_tcp_speed,
        get_actual_tool_flange_pose,
        get_actual_joint_positions,
        get_actual_joint_speeds,
        get_joint_torques,
        get_tcp_force,
        force,
        get_tool_accelerometer_reading,
        get_joint_temp,
        get_tool_current,
        get_steptime,
        time,
        set_tcp,
        get_tcp_offset,
        set_payload,
        set_payload_mass,
        set_payload_cog,
        set_target_payload,
        get_target_payload,
        get_target_payload_cog,
        get_target_payload_inertia,
        set_gravity,
        zero_ftsensor,
        ft_rtde_input_enable,
        textmsg,
        popup,
        protective_stop,
        powerdown,
    )
    table = {call.__name__: Builtin.of(call) for call in calls}
    return {
        **table,
        "get_joint_positions": table["get_actual_joint_positions"],
        "get_joint_speeds": table["get_actual_joint_speeds"],
        "enable_external_ft_sensor": table["ft_rtde_input_enable"],
        "get_controller_temp": Builtin.of(temperature),
        "get_tool_temp": Builtin.of(temperature),
    }


def _mass(value: Value) -> float:
    mass = number(value, "mass")
    if not 0.0 <= mass <= LARGEST_QUANTITY:
        raise ScriptRuntimeError(f"a mass must lie in 0 … {LARGEST_QUANTITY:.0f} kg, not {mass}")
    return mass


def _vector(value: Value, kept: Sequence[float], what: str) -> Sequence[float]:
    return quantities(value, len(kept), what) if value else kept
