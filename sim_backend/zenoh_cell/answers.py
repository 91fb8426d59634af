"""Answers of a simulated cell to each query: bytes in, bytes out, no transport and no thread."""

import json
from typing import Any

import numpy.typing as npt

from sim_backend.requests import RequestError, read_task
from sim_backend.zenoh_cell.cell import SimulatedCell
from wire import records

MAX_TICKS = 5000
"""Largest number of ticks in one `advance`: 10 s of simulated time, 3 MB of reply."""
MAX_COMMANDS = 1000
"""Largest number of commands in one message."""

_COMMAND_KINDS = tuple(int(kind) for kind in records.Kind if kind not in (records.Kind.STATE, records.Kind.CAMERA))


def read_commands(payload: bytes) -> list[npt.NDArray[Any]]:
    """Decode commands.

    Args:
        payload: one or more `records.COMMAND` records.

    Returns:
        n read-only records of `records.COMMAND`, shape (), each of a command kind. Values are not checked here.

    Raises:
        records.WireError: the payload is malformed, too long or contains a record that is not a command.
    """
    commands = records.decode(payload, records.COMMAND)
    if len(commands) > MAX_COMMANDS:
        raise records.WireError(f"{len(commands)} commands in one message, at most {MAX_COMMANDS}")
    for kind in commands["kind"]:
        if kind not in _COMMAND_KINDS:
            raise records.WireError(f"kind {int(kind)} is not a command, want one of {_COMMAND_KINDS}")
    return [commands[index, ...] for index in range(len(commands))]


def advance(cell: SimulatedCell, parameters: str, payload: bytes) -> bytes:
    """Apply commands in order, then advance simulated time.

    Args:
        cell: the world to advance.
        parameters: `ticks=N`, N from 1 to `MAX_TICKS`.
        payload: zero or more `records.COMMAND` records.

    Returns:
        N records of `records.STATE`, one per tick.

    Raises:
        RequestError: the request cannot be read.
    """
    ticks = _read_ticks(parameters)
    try:
        commands = read_commands(payload) if payload else []
    except records.WireError as error:
        raise RequestError(f"advance: {error}") from error
    for command in commands:
        cell.apply(command)
    return b"".join([cell.tick().tobytes() for _ in range(ticks)])


def reset(cell: SimulatedCell, payload: bytes) -> bytes:
    """Lay the world out anew.

    Args:
        cell: the world to lay out.
        payload: JSON object of a `Task`.

    Returns:
        One record of `records.STATE`.

    Raises:
        RequestError: as `read_task`, or the task cannot be laid out.
    """
    task = read_task(payload)
    try:
        return cell.reset(task).tobytes()
    except ValueError as error:
        raise RequestError(f"reset: {error}") from error


def truth(cell: SimulatedCell) -> bytes:
    """Return the world's true state as JSON."""
    return json.dumps(cell.truth()).encode()


def _read_ticks(parameters: str) -> int:
    name, _, value = parameters.partition("=")
    if name == "ticks" and value.isascii() and value.isdigit() and len(value) <= 9 and 1 <= int(value) <= MAX_TICKS:
        return int(value)
    raise RequestError(f"advance: parameters must be ticks=N with N from 1 to {MAX_TICKS}, not {parameters[:80]!r}")
