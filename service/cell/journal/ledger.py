"""The ledger of runs and events: one JSON object per line, appended and synced, never rewritten.

A run has two lines, one before it is accepted and one when it ends; the later line counts. A start that is refused
after the first line has a line that takes it back. A run without an end was cut off with its process.
"""

import json
import os
from io import FileIO
from pathlib import Path
from typing import Any, cast

from pydantic import ValidationError

from service.cell.journal.storage import ALTERED, Storage, Write
from service.faults import FaultCode
from service.messages import Event, EventKind, Latch, Run, RunState

FILE_NAME = "ledger.jsonl"
RUNS_IN_MEMORY = 10_000
LATCHING = frozenset({RunState.LATCHED, RunState.STOPPED, RunState.INTERRUPTED})
"""States of an ended run that leave the cell latched."""
CUT_OFF = "the control process ended before the run did; its force and duration are not recorded"


class Ledger:
    """Runs by id, in the order of their acceptance; every change is written to the file.

    Opening blocks on the disk. Every later method hands its write to threads of this file and returns at once.

    Args:
        directory: the cell's state directory; made if it does not exist.
        now: time of day that stamps the end of runs found unfinished.
        latch: in force; it tells how the run that it names has ended.

    Attributes:
        interrupted: runs found without an end, of which the latch tells nothing.
        damaged_lines: number of unreadable lines found on opening; each is skipped.
        tail_is_damaged: whether the last line was unreadable.
        unacknowledged: code and run of the last latching fault without a reset after it.
        lost: says that the file was altered by somebody else since it was opened, and written anew.

    Raises:
        OSError: the directory or file cannot be used.
    """

    def __init__(self, directory: Path, now: float, latch: Latch | None = None) -> None:
        directory.mkdir(parents=True, exist_ok=True)
        self._path = directory / FILE_NAME
        self._runs: dict[str, Run] = {}
        self._by_key: dict[str, str] = {}
        # A ledger that was lost is followed by one whose numbers are above its own
        self._seq = 0 if self._path.exists() else int(now)
        self.damaged_lines = 0
        self.tail_is_damaged = False
        self.unacknowledged: tuple[FaultCode, str | None] | None = None
        self.lost: str | None = None
        self._torn = self._load()
        self._outlived: list[FileIO] = []
        self._file = self._open()
        self._storage = Storage(FILE_NAME, self._sync, self._attend)
        unfinished = [run for run in self._runs.values() if run.state is RunState.ACTIVE]
        for run in unfinished:
            self.record(_cut_off(run, now, latch))
        self.interrupted = tuple(self._runs[run.id] for run in unfinished if latch is None or run.id != latch.run_id)

    @property
    def fault(self) -> str | None:
        """Why the file cannot be relied on; None while it can."""
        return self._storage.fault or self.lost

    def next_seq(self) -> int:
        """Return the next number in the order of runs."""
        self._seq += 1
        return self._seq

    def propose(self, run: Run) -> Write:
        """Write a run that is about to be accepted. It is found from `admit` on, or by the next process.

        Raises:
            StorageFullError: the disk does not keep up.
        """
        return self._append({"run": run.model_dump(mode="json")})

    def admit(self, run: Run) -> None:
        """Have a proposed run found."""
        self._keep(run)
        while len(self._runs) > RUNS_IN_MEMORY:
            oldest = self._runs.pop(next(iter(self._runs)))
            if oldest.idempotency_key is not None and self._by_key.get(oldest.idempotency_key) == oldest.id:
                del self._by_key[oldest.idempotency_key]

    def withdraw(self, run_id: str) -> Write:
        """Take back a proposed run that was not accepted.

        Raises:
            StorageFullError: the disk does not keep up.
        """
        return self._append({"forgotten": run_id})

    def record(self, run: Run) -> Write:
        """Record a run, new or changed.

        Raises:
            StorageFullError: the disk does not keep up; the run is in memory all the same.
        """
        self.admit(run)
        return self.propose(run)

    def note(self, event: Event) -> Write:
        """Record an event.

        Raises:
            StorageFullError: the disk does not keep up; the event is not written.
        """
        return self._append({"event": event.model_dump(mode="json")})

    def find(self, run_id: str) -> Run | None:
        return self._runs.get(run_id)

    def find_key(self, idempotency_key: str) -> Run | None:
        run_id = self._by_key.get(idempotency_key)
        return None if run_id is None else self._runs[run_id]

    def newest(self, limit: int, before: str | None = None) -> tuple[Run, ...]:
        """Return up to `limit` runs, newest first; only those older than `before` where it is given and known."""
        runs = list(self._runs.values())
        if before in self._runs:
            runs = runs[: list(self._runs).index(before)]
        return tuple(reversed(runs[-limit:]))

    def close(self, timeout_s: float) -> bool:
        """Write what is pending; return whether all of it was written in time."""
        written = self._storage.close(timeout_s)
        if written:
            for file in self._outlived:
                file.close()
        return written

    def _append(self, document: dict[str, Any]) -> Write:
        line = _line(document)

        def write() -> None:
            self._attend(failed=False)
            self._put(line)

        return self._storage.submit(write)

    def _keep(self, run: Run) -> None:
        self._runs[run.id] = run
        if run.idempotency_key is not None:
            self._by_key[run.idempotency_key] = run.id

    # --- on opening

    def _load(self) -> bool:
        """Read the file; return whether its last line was torn off by a crash."""
        try:
            raw = self._path.read_bytes()
        except FileNotFoundError:
            return False
        for line in raw.splitlines():
            try:
                document: object = json.loads(line)
                if isinstance(document, dict):
                    self._take(cast("dict[str, Any]", document))
            except (ValueError, ValidationError):
                self.damaged_lines += bool(line)
                self.tail_is_damaged |= bool(line)
            else:
                self.tail_is_damaged = False
        return bool(raw) and not raw.endswith(b"\n")

    def _take(self, document: dict[str, Any]) -> None:
        """Take in one line of the file."""
        if "run" in document:
            self._take_run(Run.model_validate(document["run"]))
        elif "forgotten" in document:
            run = self._runs.pop(str(document["forgotten"]), None)
            if run is not None and run.idempotency_key is not None:
                self._by_key.pop(run.idempotency_key, None)
        elif "event" in document:
            event = Event.model_validate(document["event"])
            if event.kind is EventKind.FAULT:
                self.unacknowledged = event.code or FaultCode.INTERNAL, event.run_id
            elif event.kind is EventKind.RESET:
                self.unacknowledged = None

    def _take_run(self, run: Run) -> None:
        if run.seq == 0:  # of a version that gave no numbers: the order of the lines has always been that of the runs
            known = self._runs.get(run.id)
            run = run.model_copy(update={"seq": self.next_seq() if known is None else known.seq})
        self._seq = max(self._seq, run.seq)
        self._keep(run)
        if run.state in LATCHING:
            self.unacknowledged = run.code or FaultCode.INTERNAL, run.id

    # --- on the threads of the storage

    def _put(self, lines: bytes) -> None:
        if self._torn:
            lines = b"\n" + lines
        written = self._file.write(lines)
        self._length += written
        self._torn = written < len(lines)
        if self._torn:
            raise OSError(f"{written} of {len(lines)} bytes were written")

    def _sync(self) -> None:
        os.fsync(self._file.fileno())

    def _attend(self, failed: bool) -> bool:
        """Write every known run anew where the file at the path is not the one that is being written.

        Args:
            failed: try the file by an empty line if it is.
        """
        if self._is_ours():
            if failed:
                self._put(b"\n")
            return failed
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self._open()
            self._torn = self._length > 0
            self._put(b"".join(_line({"run": run.model_dump(mode="json")}) for run in list(self._runs.values())))
        finally:
            self.lost = ALTERED.format(path=self._path)
        return True

    def _open(self) -> FileIO:
        """Open the file at the path to append to it. Earlier ones stay open: one may be about to be synced."""
        file = FileIO(self._path, "ab")
        self._outlived.append(file)
        found = os.fstat(file.fileno())
        self._identity, self._length = (found.st_dev, found.st_ino), found.st_size
        return file

    def _is_ours(self) -> bool:
        try:
            found = self._path.stat()
        except OSError:
            return False
        return (found.st_dev, found.st_ino) == self._identity and found.st_size == self._length


def _line(document: dict[str, Any]) -> bytes:
    return json.dumps(document, separators=(",", ":")).encode() + b"\n"


def _cut_off(run: Run, now: float, latch: Latch | None) -> Run:
    """Return a run that has no end as it ended: as the latch tells, else interrupted."""
    changes: dict[str, Any] = {
        "state": RunState.INTERRUPTED, "code": FaultCode.INTERRUPTED, "text": CUT_OFF, "ended_at": now,
    }  # fmt: skip
    if latch is not None and latch.run_id == run.id:
        changes = {
            "state": RunState.ended_by(latch.code),
            "code": latch.code,
            "text": latch.text,
            "ended_at": latch.latched_at,
            "peak_force_n": latch.peak_force_n or run.peak_force_n,
        }
    changes["ended_at"] = max(changes["ended_at"], run.requested_at)
    return run.model_copy(update=changes)
