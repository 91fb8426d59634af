"""The registers through which driver and control program talk: one table, from which the script's names are rendered.

General-purpose registers 24 to 47 are the ones that a UR controller leaves to external clients; 0 to 23 may belong to a
field bus (RTDE guide, "General purpose registers"). Inputs go to the controller in one package, so that a command and
its arguments arrive together. Nothing else in this project names a register number.
"""

from collections.abc import Sequence
from enum import IntEnum


class Command(IntEnum):
    """What `input_int_register` 25 asks for."""

    NONE = 0
    ENGAGE = 1
    """Arguments: stiffness (6), damping (6), inertia (6), max_speed (2), max_step (2), force ceiling, target age."""
    TARGET = 2
    """Arguments: TCP pose (6), base frame, m and rad."""
    STOP = 3
    """A level, not an edge: it holds for as long as it stands in the register, whatever its sequence number."""
    ZERO_FT = 4


ARGUMENTS = 24
"""Input doubles of a command, from `INPUT_ARGUMENT` on."""
INPUT_SEQUENCE = 24
"""Number of the order, a signed 32-bit integer: at ten orders a second it lasts for six years."""
INPUT_COMMAND = 25
INPUT_ARGUMENT = 24

OUTPUT_ACCEPTED = 24
"""Last sequence number that was carried out."""
OUTPUT_PROGRAM = 25
"""`wire.Program`."""
OUTPUT_REASON = 26
"""`wire.StopReason`."""
OUTPUT_CRC = 27
"""Identity of the rendered program."""
OUTPUT_COUNTER = 28
"""Steps of the program's loop; one that stands is a program that does not run."""
OUTPUT_HANDLED = 29
"""Last sequence number that was looked at, whether carried out or refused."""
OUTPUT_PEAK = 24
"""Largest resultant force since ENGAGE, N."""
OUTPUT_TARGET = 25
"""Pose of the target in force, 6 doubles."""

INPUT_NAMES: tuple[str, ...] = (
    f"input_int_register_{INPUT_SEQUENCE}",
    f"input_int_register_{INPUT_COMMAND}",
    *(f"input_double_register_{INPUT_ARGUMENT + i}" for i in range(ARGUMENTS)),
)
"""The driver's one input recipe, in order."""

OUTPUT_NAMES: tuple[str, ...] = (
    f"output_int_register_{OUTPUT_ACCEPTED}",
    f"output_int_register_{OUTPUT_PROGRAM}",
    f"output_int_register_{OUTPUT_REASON}",
    f"output_int_register_{OUTPUT_CRC}",
    f"output_int_register_{OUTPUT_COUNTER}",
    f"output_int_register_{OUTPUT_HANDLED}",
    f"output_double_register_{OUTPUT_PEAK}",
)
"""What the driver reads back, in order."""


def input_values(sequence: int, command: Command, arguments: Sequence[float]) -> tuple[int | float, ...]:
    """Values of the input recipe.

    Args:
        sequence: of the command, from 1.
        command: what is asked.
        arguments: at most `ARGUMENTS` numbers; the rest is zero.
    """
    return (sequence, int(command), *arguments, *([0.0] * (ARGUMENTS - len(arguments))))


def script_names() -> dict[str, int]:
    """Names of registers and commands as the control program's template uses them."""
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
