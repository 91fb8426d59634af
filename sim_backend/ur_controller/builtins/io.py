"""Script builtins for digital and analog terminals of the control box and the tool."""

from collections.abc import Callable
from typing import Any

from sim_backend.ur_controller.script import Builtin, ScriptRuntimeError
from sim_backend.ur_controller.script.values import Value, integer, number, truth
from sim_backend.ur_controller.terminals import (
    CONFIGURABLE,
    RANGES,
    STANDARD,
    TOOL,
    TOOL_VOLTAGES,
    Terminals,
)

_ALL = range(TOOL.stop)
_BOX_ANALOG, _TOOL_ANALOG = range(2), range(2, 4)


def io_builtins(terminals: Terminals) -> dict[str, Builtin]:
    """Return the builtins for `terminals`."""

    def bit(bits: int, group: range, n: Value) -> bool:
        return bool(bits >> _terminal(group, n) & 1)

    def share(values: list[float], domains: list[int], group: range, n: Value) -> float:
        index = _terminal(group, n)
        first, last = RANGES[domains[index]]
        return max(0.0, (values[index] - first) / (last - first))

    def digital_in(group: range) -> Callable[[Value], bool]:
        def read(n: Value) -> bool:
            return bit(terminals.digital_inputs, group, n)

        return read

    def digital_out(group: range) -> Callable[[Value], bool]:
        def read(n: Value) -> bool:
            return bit(terminals.digital_outputs, group, n)

        return read

    def set_digital_out(group: range) -> Callable[[Value, Value], None]:
        def write(n: Value, b: Value) -> None:
            terminals.set_digital_output(_terminal(group, n), truth(b, "b"))

        return write

    def get_standard_analog_in(n: Value) -> float:
        return share(terminals.analog_inputs, terminals.analog_input_domains, _BOX_ANALOG, n)

    def get_tool_analog_in(n: Value) -> float:
        return share(terminals.analog_inputs, terminals.analog_input_domains, _TOOL_ANALOG, n)

    def get_standard_analog_out(n: Value) -> float:
        return share(terminals.analog_outputs, terminals.analog_output_domains, _BOX_ANALOG, n)

    def set_standard_analog_out(n: Value, f: Value) -> None:
        terminals.write_analog(_terminal(_BOX_ANALOG, n), number(f, "f"))

    def set_analog_outputdomain(port: Value, domain: Value) -> None:
        terminals.analog_output_domains[_terminal(_BOX_ANALOG, port)] = _domain(domain)

    def set_standard_analog_input_domain(port: Value, domain: Value) -> None:
        terminals.analog_input_domains[_terminal(_BOX_ANALOG, port)] = _domain(domain)

    def set_tool_analog_input_domain(port: Value, domain: Value) -> None:
        terminals.analog_input_domains[_terminal(_TOOL_ANALOG, port)] = _domain(domain)

    def set_tool_voltage(voltage: Value) -> None:
        chosen = integer(voltage, "voltage")
        if chosen not in TOOL_VOLTAGES:
            raise ScriptRuntimeError(f"tool voltage must be 0, 12 or 24, not {chosen}")
        terminals.tool_voltage = chosen

    calls: dict[str, Callable[..., Any]] = {
        "get_digital_in": digital_in(_ALL),
        "get_standard_digital_in": digital_in(STANDARD),
        "get_configurable_digital_in": digital_in(CONFIGURABLE),
        "get_tool_digital_in": digital_in(TOOL),
        "get_digital_out": digital_out(_ALL),
        "get_standard_digital_out": digital_out(STANDARD),
        "get_configurable_digital_out": digital_out(CONFIGURABLE),
        "get_tool_digital_out": digital_out(TOOL),
        "set_digital_out": set_digital_out(_ALL),
        "set_standard_digital_out": set_digital_out(STANDARD),
        "set_configurable_digital_out": set_digital_out(CONFIGURABLE),
        "set_tool_digital_out": set_digital_out(TOOL),
        "get_analog_in": get_standard_analog_in,
        "get_standard_analog_in": get_standard_analog_in,
        "get_tool_analog_in": get_tool_analog_in,
        "get_analog_out": get_standard_analog_out,
        "get_standard_analog_out": get_standard_analog_out,
        "set_analog_out": set_standard_analog_out,
        "set_standard_analog_out": set_standard_analog_out,
        "set_analog_outputdomain": set_analog_outputdomain,
        "set_standard_analog_input_domain": set_standard_analog_input_domain,
        "set_tool_analog_input_domain": set_tool_analog_input_domain,
        "set_tool_voltage": set_tool_voltage,
    }
    return {name: Builtin.of(call) for name, call in calls.items()}


def _terminal(group: range, value: Value) -> int:
    index = integer(value, "n")
    if 0 <= index < len(group):
        return group[index]
    raise ScriptRuntimeError(f"terminal number must lie in 0 … {len(group) - 1}, not {index}")


def _domain(value: Value) -> int:
    domain = integer(value, "domain")
    if domain in (0, 1):
        return domain
    raise ScriptRuntimeError(f"domain must be 0 (current) or 1 (voltage), not {domain}")
