"""The latch on disk: set by a fault, cleared by an acknowledged reset, kept across restarts and power cycles.

The file holds one JSON object, `{"latch": null}` or `{"latch": {...}}`. Anything else reads as latched, so damage never
clears a latch. The file is missing only where the cell has never run.
"""

import json
import os
from pathlib import Path

from pydantic import ValidationError

from service.cell.journal.storage import ALTERED, Storage, Write
from service.faults import FaultCode
from service.messages import Latch

FILE_NAME = "latch.json"


class LatchFile:
    """Reads and writes the latch.

    Opening blocks on the disk. `set` and `clear` hand their write to threads of this file and return at once.

    Args:
        directory: the cell's state directory; made if it does not exist.
        now: stamps a latch that cannot be read.

    Attributes:
        found: the latch in force on opening; an unreadable file is a latch of code INTERNAL.
        lost: says that the file was altered by somebody else since it was opened, and written anew.

    Raises:
        OSError: the directory or file cannot be made.
    """

    def __init__(self, directory: Path, now: float) -> None:
        directory.mkdir(parents=True, exist_ok=True)
        self._path = directory / FILE_NAME
        self.lost: str | None = None
        self.found = self._latch = self._read(now)
        if not self._path.exists():
            self._replace(None)
        self._mark = self._present_mark()
        self._storage = Storage(FILE_NAME, self._sync, self._attend)

    @property
    def fault(self) -> str | None:
        """Why the file cannot be relied on; None while it can."""
        return self._storage.fault or self.lost

    def set(self, latch: Latch) -> Write:
        """Write a latch. It survives the end of this process before it is synced."""

        def write() -> None:
            self._latch = latch
            self._replace(latch)

        return self._storage.submit(write, owed=True)

    def clear(self) -> Write:
        """Clear the latch. A write that fails leaves the latch that was there.

        Raises:
            StorageFullError: the disk does not keep up.
        """

        def write() -> None:
            # A latch that is still to be written would come back after it
            if (owed := self._storage.owed_fault) is not None:
                raise OSError(f"the latch itself is not on the disk yet ({owed})")
            self._replace(None)
            self._latch = None

        return self._storage.submit(write)

    def close(self, timeout_s: float) -> bool:
        """Write what is pending; return whether all of it was written in time."""
        return self._storage.close(timeout_s)

    def _read(self, now: float) -> Latch | None:
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

    def _unreadable(self, now: float, error: Exception) -> Latch:
        text = f"the latch in {self._path} cannot be read ({type(error).__name__}): inspect the cell, then reset"
        return Latch(code=FaultCode.INTERNAL, text=text, latched_at=now)

    # --- on the threads of the storage

    def _replace(self, latch: Latch | None) -> None:
        """Replace the file as a whole: a kill leaves the old content or the new one.

        A latch is in place before it is synced, since a disk may take long for that: a power cut leaves it, or damage,
        which reads as a latch. A clear file is in place only once it is on the disk.
        """
        document = {"latch": None if latch is None else latch.model_dump(mode="json")}
        self._path.parent.mkdir(parents=True, exist_ok=True)
        temporary = self._path.with_suffix(".tmp")
        with temporary.open("w", encoding="utf-8") as file:
            json.dump(document, file)
            file.flush()
            if latch is None:
                os.fsync(file.fileno())
        temporary.replace(self._path)
        self._mark = self._present_mark()

    def _sync(self) -> None:
        for path, flags in ((self._path, os.O_RDONLY), (self._path.parent, os.O_RDONLY | os.O_DIRECTORY)):
            number = os.open(path, flags)
            try:
                os.fsync(number)
            finally:
                os.close(number)

    def _attend(self, failed: bool) -> bool:
        """Write the latch anew where the file at the path is not the one that was written, or could not be."""
        altered = self._present_mark() != self._mark
        try:
            if altered or failed:
                self._replace(self._latch)
        finally:
            if altered:
                self.lost = ALTERED.format(path=self._path)
        return altered or failed

    def _present_mark(self) -> tuple[int, ...] | None:
        """Return what tells whether the file at the path is the one that was written; None where there is none."""
        try:
            found = self._path.stat()
        except OSError:
            return None
        return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns
