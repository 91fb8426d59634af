"""The ledger of runs and events: one JSON object per line, appended and synced, never rewritten.

A run has two lines, one when it is accepted and one when it ends; the later line counts. A run without an end was cut
off with its process.
"""

import json
import os
from concurrent.futures import Future
from pathlib import Path
from typing import Any, cast

from pydantic import ValidationError

from service.cell.journal.storage import StorageThread
from service.faults import FaultCode
from service.messages import Event, EventKind, Run, RunState

FILE_NAME = "ledger.jsonl"
RUNS_IN_MEMORY = 10_000
LATCHING = frozenset({RunState.LATCHED, RunState.STOPPED, RunState.INTERRUPTED})
"""States of an ended run that leave the cell latched."""


class Ledger:
    """Runs by id, newest last; every change is written to the file.

    Opening blocks on the disk. Every later method hands its write to the storage thread and returns at once.

    Args:
        directory: the cell's state directory; made if it does not exist.
        storage: does the writes.
        now: time of day that stamps the end of runs found unfinished.

    Attributes:
        interrupted: runs found without an end.
        damaged_lines: number of unreadable lines found on opening; each is skipped.
        tail_is_damaged: whether the last line was unreadable.
        unacknowledged: code and run of the last latching fault without a reset after it.

    Raises:
        OSError: the directory or file cannot be used.
    """

    def __init__(self, directory: Path, storage: StorageThread, now: float) -> None:
        directory.mkdir(parents=True, exist_ok=True)
        self._storage = storage
        self._runs: dict[str, Run] = {}
        self._by_key: dict[str, str] = {}
        self.damaged_lines = 0
        self.tail_is_damaged = False
        self.unacknowledged: tuple[FaultCode, str | None] | None = None
        path = directory / FILE_NAME
        torn = self._load(path)
        self._file = path.open("a", encoding="utf-8")
        if torn:
            self._file.write("\n")
        self.interrupted = tuple(
            run.model_copy(
                update={
                    "state": RunState.INTERRUPTED,
                    "code": FaultCode.INTERRUPTED,
                    "text": "the control process ended before the run did; its force and duration are not recorded",
                    "ended_at": now,
                }
            )
            for run in self._runs.values()
            if run.state is RunState.ACTIVE
        )
        for run in self.interrupted:
            self.record(run)

    def record(self, run: Run) -> Future[None]:
        """Record a run, new or changed.

        Returns:
            Future that is done once the line is on the disk; it holds the OSError if the line could not be written.

        Raises:
            StorageFullError: the disk does not keep up; the run is in memory all the same.
        """
        self._runs[run.id] = run
        if run.idempotency_key is not None:
            self._by_key[run.idempotency_key] = run.id
        while len(self._runs) > RUNS_IN_MEMORY:
            oldest = self._runs.pop(next(iter(self._runs)))
            if oldest.idempotency_key is not None and self._by_key.get(oldest.idempotency_key) == oldest.id:
                del self._by_key[oldest.idempotency_key]
        return self._append({"run": run.model_dump(mode="json")})

    def forget(self, run_id: str) -> None:
        """Remove a run that was not accepted after all; do nothing where it is not known.

        Raises:
            StorageFullError: the disk does not keep up; the run is removed from memory all the same.
        """
        if self._forget(run_id):
            # Its line may have reached the disk, or may yet
            self._append({"forgotten": run_id})

    def note(self, event: Event) -> None:
        """Record an event.

        Raises:
            StorageFullError: the disk does not keep up; the event is not written.
        """
        self._append({"event": event.model_dump(mode="json")})

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

    def close(self) -> None:
        """Close the file, once the storage thread has ended."""
        self._file.close()

    def _append(self, document: dict[str, Any]) -> Future[None]:
        line = json.dumps(document, separators=(",", ":")) + "\n"

        def write() -> None:
            self._file.write(line)
            self._file.flush()
            os.fsync(self._file.fileno())

        return self._storage.submit(write)

    def _forget(self, run_id: str) -> bool:
        run = self._runs.pop(run_id, None)
        if run is not None and run.idempotency_key is not None:
            self._by_key.pop(run.idempotency_key, None)
        return run is not None

    def _take(self, document: dict[str, Any]) -> None:
        """Take in one line of the file."""
        if "run" in document:
            run = Run.model_validate(document["run"])
            self._runs[run.id] = run
            if run.idempotency_key is not None:
                self._by_key[run.idempotency_key] = run.id
            if run.state in LATCHING:
                self.unacknowledged = run.code or FaultCode.INTERNAL, run.id
        elif "forgotten" in document:
            self._forget(str(document["forgotten"]))
        elif "event" in document:
            event = Event.model_validate(document["event"])
            if event.kind is EventKind.FAULT:
                self.unacknowledged = event.code or FaultCode.INTERNAL, event.run_id
            elif event.kind is EventKind.RESET:
                self.unacknowledged = None

    def _load(self, path: Path) -> bool:
        """Read the file; return whether its last line was torn off by a crash."""
        try:
            raw = path.read_bytes()
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
