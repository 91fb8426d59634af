"""The threads that write one of the cell's files in order: a slow disk never blocks the control loop.

One thread hands each write to the kernel, the other syncs it. What the kernel has survives the end of this process, so
a record need not wait for the sync of an earlier one to be safe from a kill.
"""

import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field

CAPACITY = 1024
"""Largest number of waiting writes. A run makes about ten, so a full queue means that the disk no longer answers."""
RETRY_S = 0.5
"""Time between two tries of an owed write."""
ATTEND_S = 0.25
"""Time between two looks at the file while nothing is written."""
SLOW_S = 3.0
"""Time after which a write or sync under way is a fault."""

ALTERED = (
    "{path} was altered, moved or deleted by another program, and is written anew: end what does it, then restart the "
    "control process"
)
"""Text of a file that is not the one that was written."""


class StorageFullError(OSError):
    """The disk does not keep up; nothing was queued."""


@dataclass(eq=False, slots=True)
class Write:
    """One write.

    Attributes:
        kept: done once the kernel has it: it survives the end of this process.
        synced: done once it is on the disk: it survives a power cut.
        failed: why the last try failed.
    """

    write: Callable[[], None]
    owed: bool = False
    kept: Future[None] = field(default_factory=Future[None])
    synced: Future[None] = field(default_factory=Future[None])
    failed: str | None = None

    def __post_init__(self) -> None:
        for future in (self.kept, self.synced):
            future.set_running_or_notify_cancel()  # whoever gives up waiting does not take the write back

    def settle(self, error: Exception | None, *futures: Future[None]) -> None:
        """Note how a try went; the futures hold the first one."""
        self.failed = None if error is None else f"{type(error).__name__}: {error}"
        for future in futures:
            if future.done():
                continue
            if error is None:
                future.set_result(None)
            else:
                future.set_exception(error)


class Storage:
    """Writes one file on two threads of its own.

    A write that fails sets `fault` until another one succeeds; the cell starts no run meanwhile. An *owed* write that
    fails is tried again until it succeeds or a newer one takes its place, and is a fault until then.

    Args:
        name: of the file, for people.
        sync: brings to the disk what was written.
        attend: looks after the file while nothing is written; it is told whether the last write failed, so that it
            tries the file, and returns whether it has written. Both may block.
    """

    def __init__(
        self, name: str, sync: Callable[[], object], attend: Callable[[bool], bool] = lambda failed: False
    ) -> None:
        self._name = name
        self._sync = sync
        self._attend = attend
        self._unwritten: queue.SimpleQueue[Write | None] = queue.SimpleQueue()
        self._unsynced: queue.SimpleQueue[Write | None] = queue.SimpleQueue()
        self._owed: Write | None = None
        self._fault: str | None = None
        self._busy_since: dict[str, float] = {"writing": float("inf"), "syncing": float("inf")}
        self._threads = [
            threading.Thread(target=work, name=f"{name}: {what}", daemon=True)
            for what, work in (("writing", self._write_on), ("syncing", self._sync_on))
        ]
        for thread in self._threads:
            thread.start()

    @property
    def fault(self) -> str | None:
        """Why the file cannot be relied on; None while all is well."""
        waiting = self._waiting
        if waiting > CAPACITY // 2:
            return f"{self._name}: {waiting} writes wait for the disk"
        busy_s = time.monotonic() - min(self._busy_since["writing"], self._busy_since["syncing"])
        if busy_s > SLOW_S:
            return f"{self._name}: the disk has not answered for {busy_s:.0f} s"
        return self.owed_fault or self._fault

    @property
    def owed_fault(self) -> str | None:
        """The error of the owed write's last try; None while nothing is owed."""
        return None if self._owed is None else self._owed.failed

    def submit(self, write: Callable[[], None], *, owed: bool = False) -> Write:
        """Queue a write without blocking.

        Args:
            write: hands it to the kernel.
            owed: it is never refused, and is tried again until it succeeds.

        Raises:
            StorageFullError: `CAPACITY` writes are waiting.
        """
        if not owed and self._waiting >= CAPACITY:
            self._fault = f"{self._name}: {CAPACITY} writes wait for the disk"
            raise StorageFullError(self._fault)
        job = Write(write, owed)
        if owed:
            self._owed = job
        self._unwritten.put(job)
        return job

    def close(self, timeout_s: float) -> bool:
        """Finish what is queued, for at most `timeout_s`; return whether everything was written."""
        self._unwritten.put(None)
        deadline = time.monotonic() + timeout_s
        for thread in self._threads:
            thread.join(max(0.0, deadline - time.monotonic()))
        return not any(thread.is_alive() for thread in self._threads) and self.owed_fault is None

    @property
    def _waiting(self) -> int:
        return self._unwritten.qsize() + self._unsynced.qsize()

    def _write_on(self) -> None:
        while True:
            try:
                job = self._unwritten.get(timeout=ATTEND_S if self.owed_fault is None else RETRY_S)
            except queue.Empty:
                self._pay()
                self._look()
                continue
            if job is None:
                self._pay()
                self._unsynced.put(None)
                return
            self._write(job)

    def _pay(self) -> None:
        """Try the owed write again, if its last try failed."""
        if self._owed is not None and self._owed.failed is not None:
            self._write(self._owed)

    def _look(self) -> None:
        """Look after the file; whose file it is says what is wrong with it."""

        def attend() -> None:
            if self._attend(self._fault is not None):
                self._unsynced.put(Write(attend))

        self._timed("writing", attend)

    def _write(self, job: Write) -> None:
        if (error := self._timed("writing", job.write)) is None:
            job.settle(None, job.kept)
            self._unsynced.put(job)
        else:
            self._settle(job, error)

    def _sync_on(self) -> None:
        while (job := self._unsynced.get()) is not None:
            jobs = [job]
            while (more := self._next_unsynced()) is not None:
                jobs.append(more)
            error = self._timed("syncing", self._sync)
            for one in jobs:
                self._settle(one, error)

    def _next_unsynced(self) -> Write | None:
        """Return a further write that waits for its sync; None where none does, or the end is next."""
        if self._unsynced.empty():
            return None
        job = self._unsynced.get()
        if job is None:
            self._unsynced.put(None)
        return job

    def _settle(self, job: Write, error: Exception | None) -> None:
        job.settle(error, job.kept, job.synced)
        if error is None:
            self._fault = None
        elif not job.owed:
            self._fault = f"{self._name}: {job.failed}"

    def _timed(self, what: str, work: Callable[[], object]) -> Exception | None:
        self._busy_since[what] = time.monotonic()
        try:
            work()
        except Exception as error:
            return error
        finally:
            self._busy_since[what] = float("inf")
        return None
