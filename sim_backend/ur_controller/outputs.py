"""Outputs of a controller for RTDE clients: one function per variable, evaluated only on request.

Meanings and units are those of UR's RTDE guide. A variable without a counterpart in the simulation has its value on a
healthy robot at rest: voltages, temperatures, currents of absent parts.
"""

import math
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from sim_backend.ur_controller.controller import Controller
from sim_backend.ur_controller.inputs import Registers
from sim_backend.ur_controller.terminals import CONFIGURABLE
from sim_backend.world.arm import PROTECTIVE_ERROR_RAD, PROTECTIVE_FORCE_N
from sim_backend.world.kinematics import UR3E
from wire.rtde.fields import BIT_REGISTERS, DOUBLE_REGISTERS, INT_REGISTERS
from wire.rtde.modes import RobotMode

Getter = Callable[[], Any]
T = TypeVar("T")

CURRENT_A_PER_NM = 0.1
"""Ratio of joint current to joint torque. An assumption: UR publishes none."""
SUPPLY_V = 48.0
IDLE_CURRENT_A = 0.5

_JOINT_RUNNING, _JOINT_IDLE, _JOINT_POWER_OFF, _JOINT_BOOTING = 253, 255, 239, 247
_JOINT_MODES = {
    RobotMode.RUNNING: _JOINT_RUNNING,
    RobotMode.BACKDRIVE: 238,
    RobotMode.IDLE: _JOINT_IDLE,
    RobotMode.POWER_ON: _JOINT_IDLE,
    RobotMode.BOOTING: _JOINT_BOOTING,
}
_CONFIGURABLE_MASK = ((1 << len(CONFIGURABLE)) - 1) << CONFIGURABLE.start
_TOOL_MODE_IDLE = 255


class Outputs:
    """The outputs of one controller.

    Attributes:
        getters: functions by variable name; each returns a number, or a list of the field's length.
    """

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._plant, self._motion = controller.plant, controller.motion
        self._memory: dict[str, tuple[float, Any]] = {}
        self.getters: dict[str, Getter] = {
            **self._of_motion(),
            **self._of_measurement(),
            **self._of_state(),
            **self._of_terminals(),
            **_registers("output", controller.output_registers),
            **_registers("input", controller.inputs.registers),
        }

    def _of_motion(self) -> dict[str, Getter]:
        motion = self._motion
        currents = self._once("currents", self._currents)
        return {
            "target_q": lambda: motion.q_target.tolist(),
            "target_qd": lambda: motion.qd_target.tolist(),
            "target_qdd": lambda: motion.qdd_target.tolist(),
            "target_TCP_pose": self._once("target pose", motion.target_tcp_pose),
            "target_TCP_speed": motion.target_tcp_speed,
            "target_TCP_acceleration": self._target_acceleration,
            "target_moment": self._torques,
            "target_current": currents,
            "actual_current": currents,
            "joint_control_output": currents,
            "speed_scaling": lambda: motion.speed_fraction,
            "joint_position_deviation_ratio": self._deviation,
        }

    def _of_measurement(self) -> dict[str, Getter]:
        plant = self._plant
        force = self._once("force", plant.flange_wrench)
        return {
            "actual_q": lambda: plant.q.tolist(),
            "actual_qd": lambda: plant.qd.tolist(),
            "actual_current_window": lambda: [joint.torque_nm * CURRENT_A_PER_NM for joint in UR3E],
            "actual_current_as_torque": self._torques,
            "actual_TCP_pose": plant.tcp_pose,
            "actual_TCP_speed": plant.tcp_speed,
            "actual_TCP_acceleration": plant.tcp_acceleration,
            "actual_TCP_force": force,
            "tcp_force_scalar": lambda: math.hypot(*force()[:3]),
            "ft_raw_wrench": lambda: plant.ft_raw.tolist(),
            "wrench_calc_from_currents": self._once("felt", plant.felt_wrench),
            "actual_tool_accelerometer": self._once("accelerometer", plant.tool_acceleration),
            "actual_momentum": self._once("momentum", plant.momentum),
            "collision_detection_ratio": lambda: plant.true_force / PROTECTIVE_FORCE_N,
            "elbow_position": lambda: plant.elbow()[0],
            "elbow_velocity": lambda: plant.elbow()[1],
            "tcp_offset": lambda: list(plant.tcp_offset),
            "payload": lambda: plant.payload_kg,
            "payload_cog": lambda: list(plant.payload_cog),
            "payload_inertia": lambda: list(plant.payload_inertia),
        }

    def _of_state(self) -> dict[str, Getter]:
        controller = self._controller
        return {
            "timestamp": lambda: controller.time_s,
            "robot_mode": lambda: int(controller.robot_mode),
            "joint_mode": lambda: [_JOINT_MODES.get(controller.robot_mode, _JOINT_POWER_OFF)] * 6,
            "safety_mode": lambda: int(controller.safety_mode),
            "safety_status": lambda: int(controller.safety_mode),
            "robot_status_bits": lambda: controller.robot_status_bits,
            "safety_status_bits": lambda: controller.safety_status_bits,
            "runtime_state": lambda: int(controller.runtime_state),
            "target_speed_fraction": lambda: controller.speed_slider,
            "control_step": lambda: controller.control_step,
            "target_gravity": lambda: list(controller.gravity),
            "target_base_acceleration": lambda: [0.0] * 6,
            "target_base_wrench": lambda: [0.0] * 6,
            "script_control_line": lambda: 0,
            "time_scale_source": lambda: 0,
            "actual_execution_time": lambda: 0.0,
            "target_execution_time": lambda: 0.0,
            "joint_temperatures": lambda: [controller.temperature_c] * 6,
            "actual_main_voltage": lambda: SUPPLY_V,
            "actual_robot_voltage": lambda: SUPPLY_V if controller.safety.is_powered else 0.0,
            "actual_joint_voltage": lambda: [SUPPLY_V if controller.safety.is_powered else 0.0] * 6,
            "actual_robot_current": lambda: IDLE_CURRENT_A + sum(map(abs, self._currents())),
            "actual_robot_energy_consumed": lambda: 0.0,
            "actual_robot_braking_energy_dissipated": lambda: 0.0,
        }

    def _of_terminals(self) -> dict[str, Getter]:
        terminals = self._controller.terminals
        return {
            "actual_digital_input_bits": lambda: terminals.digital_inputs,
            "actual_digital_output_bits": lambda: terminals.digital_outputs,
            "actual_configurable_digital_input_bits": lambda: terminals.digital_inputs & _CONFIGURABLE_MASK,
            "actual_configurable_digital_output_bits": lambda: terminals.digital_outputs & _CONFIGURABLE_MASK,
            "analog_io_types": lambda: terminals.analog_types,
            "standard_analog_input0": lambda: terminals.analog_inputs[0],
            "standard_analog_input1": lambda: terminals.analog_inputs[1],
            "standard_analog_output0": lambda: terminals.analog_outputs[0],
            "standard_analog_output1": lambda: terminals.analog_outputs[1],
            "tool_analog_input_types": lambda: terminals.tool_analog_types,
            "tool_analog_input0": lambda: terminals.analog_inputs[2],
            "tool_analog_input1": lambda: terminals.analog_inputs[3],
            "tool_output_voltage": lambda: terminals.tool_voltage,
            "tool_output_current": lambda: 0.0,
            "tool_temperature": lambda: self._controller.temperature_c,
            "tool_mode": lambda: _TOOL_MODE_IDLE,
            "tool_output_mode": lambda: 0,
            "tool_digital_output0_mode": lambda: 0,
            "tool_digital_output1_mode": lambda: 0,
            "io_current": lambda: 0.0,
            "encoder0_raw": lambda: 0,
            "encoder1_raw": lambda: 0,
            "euromap67_input_bits": lambda: 0,
            "euromap67_output_bits": lambda: 0,
            "euromap67_24V_voltage": lambda: 0.0,
            "euromap67_24V_current": lambda: 0.0,
        }

    def _once(self, key: str, compute: Callable[[], T]) -> Callable[[], T]:
        """Return a function that evaluates `compute` once per tick, however many clients ask."""
        memory, controller = self._memory, self._controller

        def get() -> T:
            time_s, value = memory.get(key, (-1.0, None))
            if time_s != controller.time_s:
                value = compute()
                memory[key] = controller.time_s, value
            return value

        return get

    def _torques(self) -> list[float]:
        return self._plant.joint_torques().tolist()

    def _currents(self) -> list[float]:
        return [CURRENT_A_PER_NM * torque for torque in self._torques()]

    def _target_acceleration(self) -> list[float]:
        """Return the acceleration without the part caused by the joint speeds."""
        motion = self._motion
        return (self._plant.jacobian_of(motion.q_target.tolist()) @ motion.qdd_target).tolist()

    def _deviation(self) -> float:
        return float(np.abs(self._plant.q - self._motion.q_target).max()) / PROTECTIVE_ERROR_RAD


def _registers(direction: str, registers: Registers) -> dict[str, Getter]:
    ints, doubles, bits = registers.ints, registers.doubles, registers.bits
    return {
        f"{direction}_bit_registers0_to_31": lambda: registers.word(0),
        f"{direction}_bit_registers32_to_63": lambda: registers.word(32),
        **{f"{direction}_bit_register_{i}": lambda i=i: bits[i] for i in BIT_REGISTERS},
        **{f"{direction}_int_register_{i}": lambda i=i: ints[i] for i in range(INT_REGISTERS)},
        **{f"{direction}_double_register_{i}": lambda i=i: doubles[i] for i in range(DOUBLE_REGISTERS)},
    }
