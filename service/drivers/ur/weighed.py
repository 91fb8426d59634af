"""Remembers in the cell's state directory that the sensor of the configured arm was weighed and proven."""

import json
from collections.abc import Iterator
from typing import Any

from service.config import CellConfig, UrSection
from service.program import PROGRAM

FILE_NAME = "weighed.json"


def remember(cell: CellConfig) -> None:
    """Note that every axis of the sensor was proven with the configured payload on the configured robot.

    Raises:
        OSError: the state directory cannot be written.
    """
    if cell.ur is not None:
        cell.cell.state_dir.mkdir(parents=True, exist_ok=True)
        (cell.cell.state_dir / FILE_NAME).write_text(json.dumps(_subject(cell.ur)) + "\n")


def forget(cell: CellConfig) -> None:
    """Take the note back: the sensor is being weighed again, and may be found wrong.

    Raises:
        OSError: the note cannot be deleted.
    """
    (cell.cell.state_dir / FILE_NAME).unlink(missing_ok=True)


def remarks(cell: CellConfig) -> tuple[str, ...]:
    """Return what is missing: a line where a real arm was not weighed with this payload; blocks on the disk."""
    if cell.cell.driver != "ur" or cell.ur is None or cell.ur.simulated:
        return ()
    try:
        found = json.loads((cell.cell.state_dir / FILE_NAME).read_text())
    except (OSError, ValueError, RecursionError):
        found = None
    return tuple(_missing(cell.ur, found))


def _missing(ur: UrSection, found: object) -> Iterator[str]:
    if found != _subject(ur):
        yield (
            f"the force/torque sensor was not weighed with this payload: prove its signs and axes, `{PROGRAM} ur weigh`"
        )
    elif ur.serial is None:
        yield "ur.serial is not set: another robot at this address would pass for the one whose sensor was weighed"


def _subject(ur: UrSection) -> dict[str, Any]:
    """Return what another weighing is needed for if it changes: the robot, its sensor or its payload."""
    return {
        "host": ur.host,
        "simulated": ur.simulated,
        "serial": ur.serial,
        "force_range_n": ur.force_range_n,
        "torque_range_nm": ur.torque_range_nm,
        "payload_kg": ur.payload_kg,
        "payload_com_m": list(ur.payload_com_m),
    }
