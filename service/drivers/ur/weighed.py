"""Remembers in the cell's state directory that the sensor of the configured arm was weighed and proven."""

import json
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


def remarks(cell: CellConfig) -> tuple[str, ...]:
    """Return what is missing: a line where a real arm was not weighed with this payload; blocks on the disk."""
    if cell.cell.driver != "ur" or cell.ur is None or cell.ur.simulated:
        return ()
    try:
        found = json.loads((cell.cell.state_dir / FILE_NAME).read_text())
    except (OSError, ValueError):
        found = None
    if found == _subject(cell.ur):
        return ()
    return (
        f"the force/torque sensor was not weighed with this payload: prove its signs and axes, `{PROGRAM} ur weigh`",
    )


def _subject(ur: UrSection) -> dict[str, Any]:
    """Return what another weighing is needed for if it changes."""
    return {"host": ur.host, "serial": ur.serial, "payload_kg": ur.payload_kg, "payload_com_m": list(ur.payload_com_m)}
