"""Registers between driver and control program: one table, from which the script's names are rendered.

A UR controller leaves the general-purpose registers 24 to 47 to external clients; 0 to 23 may belong to a field bus
(RTDE guide, "General purpose registers"). Inputs go to the controller in one package, so a command and its arguments
arrive together. Nothing else in this project names a register number.
"""

from collections.abc import Sequence
from enum import IntEnum


class Command(IntEnum):
    """Values of `input_int_register` 25."""

    NONE = 0
    ENGAGE = 1
    """Arguments: stiffness (6), damping (6), inertia (6), max_speed (2), max_step (2), force ceiling, target age."""
    TARGET = 2
    """Arguments: TCP pose (6), base frame, m and rad."""
    STOP = 3
    """A level, not an edge: it holds while it stands in the register, whatever its sequence number. Argument: 1 for a
    stop that does not yield to the sensor, else 0.
    """
    ZERO_FT = 4


ARGUMENTS = 24
"""Number of input doubles of a command, from `INPUT_ARGUMENT` on."""
INPUT_SEQUENCE = 24
"""Number of the order, a signed 32-bit integer; at ten orders a second it lasts for six years."""
INPUT_COMMAND = 25
INPUT_ARGUMENT = 24

OUTPUT_ACCEPTED = 24
"""Last sequence number that was carried out."""
OUTPUT_PROGRAM = 25
"""`records.Program`."""
OUTPUT_REASON = 26
"""`records.StopReason`."""
OUTPUT_CRC = 27
"""Identity of the rendered program."""
OUTPUT_COUNTER = 28
"""Steps of the program's loop; a constant value means that the program does not run."""
OUTPUT_HANDLED = 29
"""Last sequence number that was handled, whether carried out or refused."""
OUTPUT_PEAK = 24
"""Largest resultant force since ENGAGE, N."""
OUTPUT_TARGET = 25
"""Pose of the target in force, 6 doubles."""

INPUT_NAMES: tuple[str, ...] = (
    f"input_int_register_{INPUT_SEQUENCE}",
    f"input_int_register_{INPUT_COMMAND}",
    *(f"input_double_register_{INPUT_ARGUMENT + i}" for i in range(ARGUMENTS)),
)
"""The driver's only input recipe, in order."""

OUTPUT_NAMES: tuple[str, ...] = (
    f"output_int_register_{OUTPUT_ACCEPTED}",
    f"output_int_register_{OUTPUT_PROGRAM}",
    f"output_int_register_{OUTPUT_REASON}",
    f"output_int_register_{OUTPUT_CRC}",
    f"output_int_register_{OUTPUT_COUNTER}",
    f"output_int_register_{OUTPUT_HANDLED}",
    f"output_double_register_{OUTPUT_PEAK}",
)
"""Registers that the driver reads back, in order."""


def input_values(sequence: int, command: Command, arguments: Sequence[float]) -> tuple[int | float, ...]:
    """Return the values of the input recipe.

    Args:
        sequence: number of the command, from 1.
        command: command.
        arguments: at most `ARGUMENTS` numbers; the rest is zero.
    """
    return (sequence, int(command), *arguments, *([0.0] * (ARGUMENTS - len(arguments))))


def script_names() -> dict[str, int]:
    """Return the names of registers and commands in the control program's template."""
    return {
        "IN_SEQUENCE": INPUT_SEQUENCE,
        "IN_COMMAND": INPUT_COMMAND,
        "IN_ARGUMENT": INPUT_ARGUMENT,
        "OUT_ACCEPTED": OUTPUT_ACCEPTED,
        "OUT_PROGRAM": OUTPUT_PROGRAM,
        "OUT_REASON": OUTPUT_REASON,
        "OUT_CRC": OUTPUT_CRC,
        "OUT_COUNTER": OUTPUT_COUNTER,
        "OUT_HANDLED": OUTPUT_HANDLED,
        "OUT_PEAK": OUTPUT_PEAK,
        "OUT_TARGET": OUTPUT_TARGET,
        **{f"COMMAND_{command.name}": int(command) for command in Command},
    }
