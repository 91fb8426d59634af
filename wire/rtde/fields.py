"""The variables of RTDE: one table of a controller's outputs and inputs, used by both ends.

Names, types and versions are those of UR's RTDE guide for the e-Series. The table adds the few variables that the guide
leaves out and controllers nevertheless serve (`tcp_offset`, the tool's digital outputs). Units are SI and radians,
poses are `[x, y, z, rx, ry, rz]` in the base frame, unless a name says otherwise.
"""

from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType


class FieldType(Enum):
    """A type of RTDE: the member's name is the name on the wire, its value the `struct` letter and the
    element count.
    """

    BOOL = ("?", 1)
    UINT8 = ("B", 1)
    UINT32 = ("I", 1)
    UINT64 = ("Q", 1)
    INT32 = ("i", 1)
    DOUBLE = ("d", 1)
    VECTOR3D = ("d", 3)
    VECTOR6D = ("d", 6)
    VECTOR6INT32 = ("i", 6)
    VECTOR6UINT32 = ("I", 6)

    @property
    def letter(self) -> str:
        """Letter of one element for `struct`."""
        return self.value[0]

    @property
    def count(self) -> int:
        """Number of elements; 1 for a scalar."""
        return self.value[1]


INT_REGISTERS = 48
DOUBLE_REGISTERS = 48
BIT_REGISTERS = range(64, 128)
"""Bits that have a variable each; bits 0 to 63 come in two words."""
EXTERNAL_REGISTERS = range(24, 48)
"""Integer and double registers meant for external clients; a field bus may hold the lower ones."""


def _registers(direction: str) -> dict[str, FieldType]:
    return {
        f"{direction}_bit_registers0_to_31": FieldType.UINT32,
        f"{direction}_bit_registers32_to_63": FieldType.UINT32,
        **{f"{direction}_bit_register_{i}": FieldType.BOOL for i in BIT_REGISTERS},
        **{f"{direction}_int_register_{i}": FieldType.INT32 for i in range(INT_REGISTERS)},
        **{f"{direction}_double_register_{i}": FieldType.DOUBLE for i in range(DOUBLE_REGISTERS)},
    }


INPUTS: Mapping[str, FieldType] = MappingProxyType(
    {
        "speed_slider_mask": FieldType.UINT32,
        "speed_slider_fraction": FieldType.DOUBLE,
        "standard_digital_output_mask": FieldType.UINT8,
        "standard_digital_output": FieldType.UINT8,
        "configurable_digital_output_mask": FieldType.UINT8,
        "configurable_digital_output": FieldType.UINT8,
        "tool_digital_output_mask": FieldType.UINT8,
        "tool_digital_output": FieldType.UINT8,
        "standard_analog_output_mask": FieldType.UINT8,
        "standard_analog_output_type": FieldType.UINT8,
        "standard_analog_output_0": FieldType.DOUBLE,
        "standard_analog_output_1": FieldType.DOUBLE,
        "external_force_torque": FieldType.VECTOR6D,
        **_registers("input"),
    }
)
"""Variables that a client may write."""

OUTPUTS: Mapping[str, FieldType] = MappingProxyType(
    {
        "timestamp": FieldType.DOUBLE,
        "target_q": FieldType.VECTOR6D,
        "target_qd": FieldType.VECTOR6D,
        "target_qdd": FieldType.VECTOR6D,
        "target_current": FieldType.VECTOR6D,
        "target_moment": FieldType.VECTOR6D,
        "actual_q": FieldType.VECTOR6D,
        "actual_qd": FieldType.VECTOR6D,
        "actual_current": FieldType.VECTOR6D,
        "actual_current_window": FieldType.VECTOR6D,
        "actual_current_as_torque": FieldType.VECTOR6D,
        "joint_control_output": FieldType.VECTOR6D,
        "actual_TCP_pose": FieldType.VECTOR6D,
        "actual_TCP_speed": FieldType.VECTOR6D,
        "actual_TCP_force": FieldType.VECTOR6D,
        "actual_TCP_acceleration": FieldType.VECTOR6D,
        "target_TCP_pose": FieldType.VECTOR6D,
        "target_TCP_speed": FieldType.VECTOR6D,
        "target_TCP_acceleration": FieldType.VECTOR6D,
        "tcp_offset": FieldType.VECTOR6D,
        "actual_digital_input_bits": FieldType.UINT64,
        "actual_configurable_digital_input_bits": FieldType.UINT64,
        "joint_temperatures": FieldType.VECTOR6D,
        "actual_execution_time": FieldType.DOUBLE,
        "target_execution_time": FieldType.DOUBLE,
        "robot_mode": FieldType.INT32,
        "joint_mode": FieldType.VECTOR6INT32,
        "safety_mode": FieldType.INT32,
        "safety_status": FieldType.INT32,
        "actual_tool_accelerometer": FieldType.VECTOR3D,
        "speed_scaling": FieldType.DOUBLE,
        "target_speed_fraction": FieldType.DOUBLE,
        "actual_momentum": FieldType.DOUBLE,
        "actual_main_voltage": FieldType.DOUBLE,
        "actual_robot_voltage": FieldType.DOUBLE,
        "actual_robot_current": FieldType.DOUBLE,
        "actual_joint_voltage": FieldType.VECTOR6D,
        "actual_robot_energy_consumed": FieldType.DOUBLE,
        "actual_robot_braking_energy_dissipated": FieldType.DOUBLE,
        "actual_digital_output_bits": FieldType.UINT64,
        "actual_configurable_digital_output_bits": FieldType.UINT64,
        "runtime_state": FieldType.UINT32,
        "elbow_position": FieldType.VECTOR3D,
        "elbow_velocity": FieldType.VECTOR3D,
        "robot_status_bits": FieldType.UINT32,
        "safety_status_bits": FieldType.UINT32,
        "analog_io_types": FieldType.UINT32,
        "standard_analog_input0": FieldType.DOUBLE,
        "standard_analog_input1": FieldType.DOUBLE,
        "standard_analog_output0": FieldType.DOUBLE,
        "standard_analog_output1": FieldType.DOUBLE,
        "io_current": FieldType.DOUBLE,
        "encoder0_raw": FieldType.INT32,
        "encoder1_raw": FieldType.INT32,
        "euromap67_input_bits": FieldType.UINT32,
        "euromap67_output_bits": FieldType.UINT32,
        "euromap67_24V_voltage": FieldType.DOUBLE,
        "euromap67_24V_current": FieldType.DOUBLE,
        "tool_mode": FieldType.UINT32,
        "tool_analog_input_types": FieldType.UINT32,
        "tool_analog_input0": FieldType.DOUBLE,
        "tool_analog_input1": FieldType.DOUBLE,
        "tool_output_voltage": FieldType.INT32,
        "tool_output_current": FieldType.DOUBLE,
        "tool_temperature": FieldType.DOUBLE,
        "tool_output_mode": FieldType.UINT8,
        "tool_digital_output0_mode": FieldType.UINT8,
        "tool_digital_output1_mode": FieldType.UINT8,
        "tcp_force_scalar": FieldType.DOUBLE,
        "ft_raw_wrench": FieldType.VECTOR6D,
        "wrench_calc_from_currents": FieldType.VECTOR6D,
        "joint_position_deviation_ratio": FieldType.DOUBLE,
        "collision_detection_ratio": FieldType.DOUBLE,
        "payload": FieldType.DOUBLE,
        "payload_cog": FieldType.VECTOR3D,
        "payload_inertia": FieldType.VECTOR6D,
        "script_control_line": FieldType.UINT32,
        "time_scale_source": FieldType.INT32,
        "target_gravity": FieldType.VECTOR3D,
        "target_base_acceleration": FieldType.VECTOR6D,
        "target_base_wrench": FieldType.VECTOR6D,
        "control_step": FieldType.UINT64,
        **_registers("output"),
        **_registers("input"),
    }
)
"""Variables that a client may read; the input registers can be read back."""


def _upper_registers() -> dict[str, tuple[int, int, int]]:
    names = [
        f"{way}_{kind}_register_{i}"
        for way in ("input", "output")
        for kind in ("int", "double")
        for i in EXTERNAL_REGISTERS
    ]
    names += [f"{way}_bit_register_{i}" for way in ("input", "output") for i in BIT_REGISTERS]
    return dict.fromkeys(names, (5, 3, 0))


SINCE: Mapping[str, tuple[int, int, int]] = MappingProxyType(
    {
        "tool_output_mode": (5, 2, 0),
        "tool_digital_output0_mode": (5, 2, 0),
        "tool_digital_output1_mode": (5, 2, 0),
        "safety_status": (5, 4, 0),
        "payload": (5, 5, 1),
        "payload_cog": (5, 5, 1),
        "tcp_offset": (5, 5, 1),
        "ft_raw_wrench": (5, 9, 0),
        "script_control_line": (5, 9, 0),
        "payload_inertia": (5, 11, 0),
        "actual_current_as_torque": (5, 23, 0),
        "target_gravity": (5, 26, 0),
        "target_base_wrench": (5, 26, 0),
        "control_step": (5, 26, 0),
        **_upper_registers(),
    }
)
"""First PolyScope 5 version with a variable, where UR documents one; older controllers answer NOT_FOUND."""
