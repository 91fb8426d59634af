"""The journal of one cell: latch and ledger on disk, events to the observers. Only its opening and `close` block."""

import asyncio
import secrets
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Protocol

import structlog

from service.cell.journal.latch_file import LatchFile
from service.cell.journal.ledger import Ledger
from service.cell.journal.storage import StorageFullError, Write
from service.cell.tick_record import TickRecord
from service.faults import FaultCode
from service.messages import CellState, Event, EventKind, Latch, Run, Telemetry

RESET_S = 3.0
"""Longest wait of a reset for the disk to have what was recorded before, s."""

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
        clock: monotonic seconds.

    Attributes:
        observers: called in this order.
        latch: in force. It is set at once, and is on the disk a moment later.
        epoch: drawn when the process starts.

    Raises:
        OSError: the directory cannot be used.
    """

    def __init__(
        self, directory: Path, time_of_day: Callable[[], float], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.epoch = secrets.token_hex(8)
        self.observers: list[Observer] = []
        self.time_of_day = time_of_day
        self.clock = clock
        self._seq = 0
        self._written: Write | None = None
        self._latching: Write | None = None
        now = time_of_day()
        self._latch_file = LatchFile(directory, now)
        self.latch: Latch | None = self._latch_file.found
        self._ledger = Ledger(directory, now, self.latch)
        if self.latch is None:
            self._latch_by_ledger()

    @property
    def fault(self) -> str | None:
        """The reason why the disk cannot be relied on; None while it can."""
        faults = (self._latch_file.fault, self._ledger.fault)
        return "; ".join(fault for fault in faults if fault is not None) or None

    # --- the latch

    def set_latch(self, code: FaultCode, text: str, run_id: str | None, peak_force_n: float | None) -> Latch:
        """Latch. The latch is in force on return, whatever the disk does."""
        latch = Latch(code=code, text=text, latched_at=self.time_of_day(), run_id=run_id, peak_force_n=peak_force_n)
        self.latch = latch
        self._latching = self._latch_file.set(latch)
        return latch

    @property
    def latch_kept(self) -> Future[None] | None:
        """Done once the last latch survives the end of this process, or could not be written; None without one."""
        return None if self._latching is None else self._latching.kept

    async def clear_latch_on_disk(self) -> None:
        """Clear the file, after everything that was recorded before. The latch stays in force until `drop_latch`.

        Raises:
            OSError: the disk refuses; the latch stands.
        """
        if self._written is not None and not await _settled(self._written.synced, RESET_S):
            raise OSError("the record of the stop is not on the disk yet: try again")
        await asyncio.wrap_future(self._latch_file.clear().synced)

    def drop_latch(self) -> None:
        """End the latch in this process, once its file is clear."""
        self.latch = None

    # --- runs

    def next_seq(self) -> int:
        """Return the next number in the order of runs."""
        return self._ledger.next_seq()

    async def propose(self, run: Run) -> None:
        """Write a run to the disk before it is accepted by `admit` or taken back by `withdraw`.

        Raises:
            OSError: the disk refuses.
        """
        self._written = written = self._ledger.propose(run)
        await asyncio.wrap_future(written.synced)

    def admit(self, run: Run) -> None:
        """Have a proposed run found: it is accepted."""
        self._ledger.admit(run)

    def take_back(self, run_id: str) -> Write | None:
        """Take back a proposed run; return None where the disk does not keep up."""
        return self._try(lambda: self._ledger.withdraw(run_id))

    async def withdraw(self, run_id: str) -> None:
        """Take back a proposed run; return once that survives the end of this process, or could not be written."""
        if (written := self.take_back(run_id)) is not None:
            await _settled(written.kept)

    def record(self, run: Run) -> None:
        """Record a run that has changed."""
        self._try(lambda: self._ledger.record(run))

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

    def tell_state(self, state: CellState, run_id: str | None) -> None:
        """Tell that the cell has become `state`.

        Args:
            state: of the cell.
            run_id: of the run under way; None without one.
        """
        self.tell(EventKind.STATE, state, "", run_id=run_id)

    def tell_run(self, run: Run, state: CellState) -> None:
        """Tell how a run has ended.

        Args:
            run: as it ended.
            state: of the cell.
        """
        self.tell(EventKind.RUN, state, f"{run.state}: {run.text}" if run.text else run.state, run.code, run.id)

    def inform(self, call: Callable[[Observer], None]) -> None:
        """Call every observer. One that fails is logged; neither the cell nor another observer suffers."""
        for observer in self.observers:
            try:
                call(observer)
            except Exception:
                _log.exception("observer", kind=type(observer).__name__)

    def close(self, timeout_s: float) -> bool:
        """Write what is pending; return whether all of it was written in time."""
        deadline = time.monotonic() + timeout_s
        written = self._latch_file.close(timeout_s)
        return self._ledger.close(max(0.0, deadline - time.monotonic())) and written

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

    def _try(self, write: Callable[[], Write]) -> Write | None:
        try:
            self._written = write()
        except StorageFullError:
            return None  # `fault` says so, and no run starts meanwhile
        return self._written


async def _settled(future: Future[None], timeout_s: float | None = None) -> bool:
    """Wait until a write has succeeded or failed; return whether it has, in time."""
    waiting = asyncio.wrap_future(future)
    waiting.add_done_callback(lambda done: done.exception())  # seen: `fault` tells it
    done, _ = await asyncio.wait([waiting], timeout=timeout_s)
    return bool(done)
