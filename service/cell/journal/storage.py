"""The thread that writes the cell's files in order: a slow disk never blocks the control loop."""

import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

CAPACITY = 1024
"""Largest number of waiting writes. A run makes about ten, so a full queue means that the disk no longer answers."""
RETRY_S = 0.5
"""Time between two tries of an owed job."""


class StorageFullError(OSError):
    """The disk does not keep up; nothing was queued."""


class StorageThread:
    """Runs jobs one after another on its own thread.

    A job that fails sets `fault` until another job succeeds; the cell starts no run meanwhile. An *owed* job that fails
    is tried again until it succeeds, and is a fault until then, whatever else succeeds.
    """

    def __init__(self) -> None:
        self._jobs: queue.SimpleQueue[tuple[Callable[[], Any], Future[Any], bool] | None] = queue.SimpleQueue()
        self._fault: str | None = None
        self._owed: Callable[[], Any] | None = None
        self._owed_fault: str | None = None
        self._thread = threading.Thread(target=self._work, name="storage", daemon=True)
        self._thread.start()

    @property
    def fault(self) -> str | None:
        """The last write's error, or the number of waiting writes where they pile up; None while all is well."""
        if self._jobs.qsize() > CAPACITY // 2:
            return f"{self._jobs.qsize()} writes wait for the disk"
        return self._owed_fault or self._fault

    @property
    def owed_fault(self) -> str | None:
        """The error of the owed job's last try; None when nothing is owed. Exact on the storage thread only."""
        return self._owed_fault

    def submit(self, job: Callable[[], Any], *, owed: bool = False) -> Future[Any]:
        """Queue a job without blocking. The future holds the result of its first try, or the exception.

        Args:
            job: may block on the disk.
            owed: the job is never refused, and is tried again until it succeeds or a newer owed job takes its place.

        Raises:
            StorageFullError: `CAPACITY` jobs are waiting.
        """
        if not owed and self._jobs.qsize() >= CAPACITY:
            self._fault = f"{CAPACITY} writes wait for the disk"
            raise StorageFullError(self._fault)
        future: Future[Any] = Future()
        self._jobs.put((job, future, owed))
        return future

    def close(self, timeout_s: float) -> bool:
        """Finish what is queued, for at most `timeout_s`; return whether everything was written."""
        self._jobs.put(None)
        self._thread.join(timeout_s)
        return not self._thread.is_alive() and self._owed is None

    def _work(self) -> None:
        while True:
            try:
                entry = self._jobs.get(timeout=None if self._owed is None else RETRY_S)
            except queue.Empty:
                self._pay()
                continue
            if entry is None:
                self._pay()
                return
            job, future, owed = entry
            if owed:
                self._owed = None
            else:
                self._pay()
            try:
                result = job()
            except Exception as error:
                self._fault = f"{type(error).__name__}: {error}"
                if owed:
                    self._owed, self._owed_fault = job, self._fault
                future.set_exception(error)
            else:
                self._fault = None
                if owed:
                    self._owed_fault = None
                future.set_result(result)

    def _pay(self) -> None:
        if self._owed is None:
            return
        try:
            self._owed()
        except Exception as error:
            self._owed_fault = f"{type(error).__name__}: {error}"
        else:
            self._owed = self._owed_fault = None
