"""Answers of a simulated cell to each query: bytes in, bytes out, no transport and no thread."""

import json
from typing import Any

import numpy.typing as npt

from sim_backend.holding import SIGNATURE, SIGNED, Holding
from sim_backend.requests import RequestError, read_parameters, read_task
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


def apply(cell: SimulatedCell, holding: Holding, command: npt.NDArray[Any]) -> None:
    """Carry out a command if it is the holder's.

    The cell is told the holder's number in place of its word, because states are published.
    """
    if holding.admits(command):
        numbered = command.copy()
        numbered["client"] = holding.number
        cell.apply(numbered)


def advance(cell: SimulatedCell, holding: Holding, parameters: str, payload: bytes) -> bytes:
    """Apply commands in order, then advance simulated time.

    Args:
        cell: the world to advance.
        holding: of the world; the request must be the holder's.
        parameters: `ticks=N`, N from 1 to `MAX_TICKS`, with `client` and `seq` of the holder.
        payload: zero or more `records.COMMAND` records.

    Returns:
        N records of `records.STATE`, one per tick.

    Raises:
        RequestError: the request cannot be read, or is not the holder's.
    """
    read = read_parameters(parameters, f"ticks=N with N from 1 to {MAX_TICKS}, and {SIGNATURE}", "ticks", *SIGNED)
    ticks = _read_ticks(read.get("ticks", ""))
    try:
        commands = read_commands(payload) if payload else []
    except records.WireError as error:
        raise RequestError(f"advance: {error}") from error
    holding.check(read, "advance")
    for command in commands:
        apply(cell, holding, command)
    return b"".join([cell.tick().tobytes() for _ in range(ticks)])


def reset(cell: SimulatedCell, holding: Holding, parameters: str, payload: bytes) -> bytes:
    """Lay the world out anew.

    Args:
        cell: the world to lay out.
        holding: of the world; the request must be the holder's.
        parameters: `client` and `seq` of the holder.
        payload: JSON object of a `Task`.

    Returns:
        One record of `records.STATE`.

    Raises:
        RequestError: as `read_task`, the task cannot be laid out, or the request is not the holder's.
    """
    task = read_task(payload)
    holding.check(read_parameters(parameters, SIGNATURE, *SIGNED), "reset")
    try:
        return cell.reset(task).tobytes()
    except ValueError as error:
        raise RequestError(f"reset: {error}") from error


def truth(cell: SimulatedCell) -> bytes:
    """Return the world's true state as JSON."""
    return json.dumps(cell.truth()).encode()


def _read_ticks(value: str) -> int:
    if value.isascii() and value.isdigit() and len(value) <= 9 and 1 <= int(value) <= MAX_TICKS:
        return int(value)
    raise RequestError(f"advance: parameters must have ticks=N with N from 1 to {MAX_TICKS}, not {value[:80]!r}")
