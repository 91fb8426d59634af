"""Digital and analog terminals of the control box, the configurable ones, and the tool's.

Numbering is that of RTDE's bit fields: standard 0–7, configurable 8–15, tool 16 and 17.
"""

from collections.abc import Callable

STANDARD, CONFIGURABLE, TOOL = range(8), range(8, 16), range(16, 18)
CURRENT, VOLTAGE = 0, 1
"""Domains of an analog terminal: 4–20 mA or 0–10 V."""
RANGES = ((0.004, 0.020), (0.0, 10.0))
"""First and last value of an analog terminal by domain, A and V."""
TOOL_VOLTAGES = (0, 12, 24)


class Terminals:
    """State of all terminals. Initially everything is low. Nothing is connected: inputs keep the values set here.

    Attributes:
        digital_inputs: bits 0–17.
        digital_outputs: bits 0–17.
        analog_inputs: control box 0 and 1, tool 0 and 1, in A or V by domain.
        analog_outputs: control box 0 and 1, A or V by domain.
        analog_input_domains: `CURRENT` or `VOLTAGE`, in the order of `analog_inputs`.
        analog_output_domains: `CURRENT` or `VOLTAGE`, in the order of `analog_outputs`.
        tool_voltage: 0, 12 or 24 V.
    """

    def __init__(self) -> None:
        self.digital_inputs = 0
        self.digital_outputs = 0
        self.analog_inputs = [0.0, 0.0, 0.0, 0.0]
        self.analog_outputs = [RANGES[CURRENT][0]] * 2
        self.analog_input_domains = [VOLTAGE, VOLTAGE, VOLTAGE, VOLTAGE]
        self.analog_output_domains = [CURRENT, CURRENT]
        self.tool_voltage = 0

    def write_digital(self, first: int, mask: int, values: int) -> None:
        """Set outputs, counted from `first`: where a bit of `mask` is 1, to the bit of `values`."""
        self.digital_outputs = self.digital_outputs & ~(mask << first) | (values & mask) << first

    def set_digital_output(self, number: int, high: bool) -> None:
        """Set one output; `number` 0–17."""
        self.write_digital(number, 1, int(high))

    def write_analog(self, number: int, share: float) -> None:
        """Set one analog output to a share of its full scale; values outside 0 … 1 are clamped."""
        share = min(max(share, 0.0), 1.0) if share == share else 0.0  # NaN can come over the network
        first, last = RANGES[self.analog_output_domains[number]]
        self.analog_outputs[number] = first + share * (last - first)

    @property
    def analog_types(self) -> int:
        """Value of `analog_io_types`: bits 0–1 inputs, 2–3 outputs, 1 for voltage."""
        domains = (*self.analog_input_domains[:2], *self.analog_output_domains)
        return sum(domain << bit for bit, domain in enumerate(domains))

    @property
    def tool_analog_types(self) -> int:
        """Value of `tool_analog_input_types`."""
        return self.analog_input_domains[2] | self.analog_input_domains[3] << 1


class TerminalInputs:
    """RTDE's masked writes of outputs: a value applies only if a mask in the same package selects it."""

    def __init__(self, terminals: Terminals, set_speed: Callable[[float], None]) -> None:
        self._terminals = terminals
        self._set_speed = set_speed
        self.values: dict[str, float] = {}

    def apply(self, names: tuple[str, ...]) -> None:
        """Apply the masks among `names`, the variables of the package just stored in `values`."""
        values, terminals = self.values, self._terminals
        for name in names:
            if not name.endswith("_mask"):
                continue
            mask = int(values[name])
            if name == "speed_slider_mask":
                if mask & 1:
                    self._set_speed(values.get("speed_slider_fraction", 0.0))
            elif name == "standard_analog_output_mask":
                types = int(values.get("standard_analog_output_type", 0))
                for number in (0, 1):
                    if mask >> number & 1:
                        terminals.analog_output_domains[number] = types >> number & 1
                        terminals.write_analog(number, values.get(f"standard_analog_output_{number}", 0.0))
            else:
                output = name.removesuffix("_mask")
                group = {"standard": STANDARD, "configurable": CONFIGURABLE, "tool": TOOL}[output.split("_")[0]]
                terminals.write_digital(group.start, mask & (1 << len(group)) - 1, int(values.get(output, 0)))
