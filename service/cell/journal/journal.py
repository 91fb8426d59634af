"""The journal of one cell: latch and ledger on disk, events to the observers. Only its opening and `close` block."""

import secrets
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Protocol, TypeVar

import structlog

from service.cell.journal.latch_file import LatchFile
from service.cell.journal.ledger import Ledger
from service.cell.journal.storage import StorageFullError, StorageThread
from service.cell.tick_record import TickRecord
from service.faults import FaultCode
from service.messages import CellState, Event, EventKind, Latch, Run, Telemetry

T = TypeVar("T")

_log = structlog.get_logger("service.cell")


class Observer(Protocol):
    """Is told of what the cell did, afterwards, on the event loop's thread."""

    def on_event(self, event: Event) -> None: ...

    def on_telemetry(self, point: Telemetry) -> None: ...

    def on_tick(self, record: TickRecord) -> None: ...


class Journal:
    """Latch, runs and events of one cell.

    Args:
        directory: the cell's state directory.
        time_of_day: seconds since the Unix epoch, for stamps only.

    Attributes:
        observers: called in this order.
        latch: in force. It is set at once, and is on the disk a moment later.
        epoch: drawn when the process starts.

    Raises:
        OSError: the directory cannot be used.
    """

    def __init__(self, directory: Path, time_of_day: Callable[[], float]) -> None:
        self.epoch = secrets.token_hex(8)
        self.observers: list[Observer] = []
        self.time_of_day = time_of_day
        self._seq = 0
        self._latch_file = LatchFile(directory)
        self.latch: Latch | None = self._latch_file.read(time_of_day())
        self._storage = StorageThread()
        self._ledger = Ledger(directory, self._storage, time_of_day())
        if self.latch is None:
            self._latch_by_ledger()

    @property
    def fault(self) -> str | None:
        """The reason why the disk cannot be relied on; None while it can."""
        return self._storage.fault

    # --- the latch

    def set_latch(self, code: FaultCode, text: str, run_id: str | None, peak_force_n: float | None) -> Latch:
        """Latch. The latch is in force on return, whatever the disk does."""
        latch = Latch(code=code, text=text, latched_at=self.time_of_day(), run_id=run_id, peak_force_n=peak_force_n)
        self.latch = latch
        self._storage.submit(lambda: self._latch_file.write(latch), owed=True)
        return latch

    def clear_latch_on_disk(self) -> Future[None]:
        """Clear the file. The latch stays in force until `drop_latch`.

        Raises:
            StorageFullError: the disk does not keep up.
        """

        def clear() -> None:
            # A latch that is still to be written would come back after it
            if (owed := self._storage.owed_fault) is not None:
                raise OSError(f"the latch itself is not on the disk yet ({owed})")
            self._latch_file.write(None)

        return self._storage.submit(clear)

    def drop_latch(self) -> None:
        """End the latch in this process, once its file is clear."""
        self.latch = None

    # --- runs

    def record(self, run: Run) -> Future[None] | None:
        """Record a run, new or changed; return None where the disk does not keep up."""
        return self._try(lambda: self._ledger.record(run))

    def forget(self, run_id: str) -> None:
        """Remove a run that was not accepted after all."""
        self._try(lambda: self._ledger.forget(run_id))

    def find(self, run_id: str) -> Run | None:
        """Return a run as it was last recorded."""
        return self._ledger.find(run_id)

    def find_key(self, idempotency_key: str) -> Run | None:
        """Return the run that a start with this key began."""
        return self._ledger.find_key(idempotency_key)

    def newest(self, limit: int, before: str | None = None) -> tuple[Run, ...]:
        """Return up to `limit` runs, newest first; only those older than `before` where it is given and known."""
        return self._ledger.newest(limit, before)

    # --- events

    def tell(
        self, kind: EventKind, state: CellState, text: str, code: FaultCode | None = None, run_id: str | None = None
    ) -> None:
        """Write an event and tell the observers."""
        self._seq += 1
        event = Event(
            service_epoch=self.epoch, seq=self._seq, time=self.time_of_day(), kind=kind, state=state,
            run_id=run_id, code=code, text=text,
        )  # fmt: skip
        self._try(lambda: self._ledger.note(event))
        self.inform(lambda observer: observer.on_event(event))

    def inform(self, call: Callable[[Observer], None]) -> None:
        """Call every observer. One that fails is logged; neither the cell nor another observer suffers."""
        for observer in self.observers:
            try:
                call(observer)
            except Exception:
                _log.exception("observer", kind=type(observer).__name__)

    def close(self, timeout_s: float) -> bool:
        """Write what is pending; return whether all of it was written in time."""
        written = self._storage.close(timeout_s)
        if written:
            self._ledger.close()
        return written

    def _latch_by_ledger(self) -> None:
        """Latch where the ledger contradicts the latch's file, which says that nothing is latched."""
        ledger, then = self._ledger, "inspect the cell, then reset"
        if ledger.interrupted:
            run = ledger.interrupted[-1]
            text = f"run {run.id} was under way when the control process ended: {then}"
            self.set_latch(FaultCode.INTERRUPTED, text, run.id, None)  # what was measured died with the process
        elif ledger.unacknowledged is not None:
            code, run_id = ledger.unacknowledged
            text = f"the ledger has a stop by {code} without a reset after it, the latch's file has none: {then}"
            self.set_latch(code, text, run_id, None)
        elif ledger.tail_is_damaged:
            text = f"the ledger's last line cannot be read; it may have been a run or a fault: {then}"
            self.set_latch(FaultCode.INTERRUPTED, text, None, None)

    def _try(self, write: Callable[[], T]) -> T | None:
        try:
            return write()
        except StorageFullError:
            return None  # `fault` says so, and no run starts meanwhile
