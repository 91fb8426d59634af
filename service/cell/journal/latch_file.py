"""The latch on disk: set by a fault, cleared by an acknowledged reset, kept across restarts and power cycles.

The file holds one JSON object, `{"latch": null}` or `{"latch": {...}}`. Anything else reads as latched, so damage never
clears a latch. The file is missing only where the cell has never run.
"""

import json
import os
from pathlib import Path

from pydantic import ValidationError

from service.faults import FaultCode
from service.messages import Latch

FILE_NAME = "latch.json"


class LatchFile:
    """Reads and writes the latch. The methods block on the disk, so the cell calls them on its storage thread.

    Args:
        directory: the cell's state directory; made if it does not exist.

    Raises:
        OSError: the directory cannot be made.
    """

    def __init__(self, directory: Path) -> None:
        directory.mkdir(parents=True, exist_ok=True)
        self._path = directory / FILE_NAME

    def read(self, now: float) -> Latch | None:
        """Return the latch in force; an unreadable file is a latch of code INTERNAL, stamped `now`."""
        try:
            text = self._path.read_text("utf-8")
        except FileNotFoundError:
            return None
        except (OSError, UnicodeDecodeError) as error:
            return self._unreadable(now, error)
        try:
            latch = json.loads(text)["latch"]
            return None if latch is None else Latch.model_validate(latch)
        except (ValueError, TypeError, KeyError, ValidationError) as error:
            return self._unreadable(now, error)

    def write(self, latch: Latch | None) -> None:
        """Replace the file as a whole: a power cut leaves the old latch or the new one.

        Raises:
            OSError: the disk refuses; the old file stands.
        """
        document = {"latch": None if latch is None else latch.model_dump(mode="json")}
        temporary = self._path.with_suffix(".tmp")
        with temporary.open("w", encoding="utf-8") as file:
            json.dump(document, file)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(self._path)
        directory = os.open(self._path.parent, os.O_RDONLY)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)

    def _unreadable(self, now: float, error: Exception) -> Latch:
        text = f"the latch in {self._path} cannot be read ({type(error).__name__}): inspect the cell, then reset"
        return Latch(code=FaultCode.INTERNAL, text=text, latched_at=now)
