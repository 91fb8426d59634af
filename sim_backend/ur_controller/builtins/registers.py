"""Script builtins for the general-purpose registers and the watchdog over RTDE's input packages."""

from collections.abc import Callable
from typing import Any

from sim_backend.ur_controller.controller import Controller
from sim_backend.ur_controller.inputs import Action
from sim_backend.ur_controller.script import Builtin, ScriptRuntimeError
from sim_backend.ur_controller.script.values import LARGEST_INT, LEAST_INT, Value, integer, number, text, truth
from wire.rtde.fields import INPUTS

_ACTIONS: dict[str, Action] = {"ignore": "ignore", "pause": "pause", "stop": "stop"}


def register_builtins(controller: Controller) -> dict[str, Builtin]:
    """Return the builtins for the registers and watchdogs of `controller`."""
    inputs, outputs = controller.inputs.registers, controller.output_registers
    input_ints, input_doubles, input_bits = inputs.ints, inputs.doubles, inputs.bits
    output_ints, output_doubles, output_bits = outputs.ints, outputs.doubles, outputs.bits

    def read_input_integer_register(address: Value) -> int:
        return input_ints[_address(address, 48)]

    def read_input_float_register(address: Value) -> float:
        return input_doubles[_address(address, 48)]

    def read_input_boolean_register(address: Value) -> bool:
        return input_bits[_address(address, 128)]

    def read_output_integer_register(address: Value) -> int:
        return output_ints[_address(address, 48)]

    def read_output_float_register(address: Value) -> float:
        return output_doubles[_address(address, 48)]

    def read_output_boolean_register(address: Value) -> bool:
        return output_bits[_address(address, 128)]

    def write_output_integer_register(address: Value, value: Value) -> None:
        whole = integer(value, "value")
        if not LEAST_INT <= whole <= LARGEST_INT:
            raise ScriptRuntimeError(f"an integer register holds 32 bits, {whole} does not fit")
        output_ints[_address(address, 48)] = whole

    def write_output_float_register(address: Value, value: Value) -> None:
        output_doubles[_address(address, 48)] = number(value, "value")

    def write_output_boolean_register(address: Value, value: Value) -> None:
        output_bits[_address(address, 128)] = truth(value, "value")

    def rtde_set_watchdog(variable_name: Value, min_frequency: Value, action: Value = "pause") -> None:
        name, what = text(variable_name, "variable_name"), text(action, "action").lower()
        if name not in INPUTS:
            raise ScriptRuntimeError(f"rtde_set_watchdog: {name!r} is not an input variable of RTDE")
        if what not in _ACTIONS:
            raise ScriptRuntimeError(f"rtde_set_watchdog: action must be ignore, pause or stop, not {what!r}")
        controller.inputs.watch(name, number(min_frequency, "min_frequency"), _ACTIONS[what])

    calls: tuple[Callable[..., Any], ...] = (
        read_input_integer_register,
        read_input_float_register,
        read_input_boolean_register,
        read_output_integer_register,
        read_output_float_register,
        read_output_boolean_register,
        write_output_integer_register,
        write_output_float_register,
        write_output_boolean_register,
        rtde_set_watchdog,
    )
    return {call.__name__: Builtin.of(call) for call in calls}


def _address(value: Value, count: int) -> int:
    if type(value) is not int:
        value = integer(value, "address")
    if 0 <= value < count:
        return value
    raise ScriptRuntimeError(f"register address must lie in 0 … {count - 1}, not {value}")
