"""One thread that does the cell's disk writes in order, so that a slow disk never blocks the control loop."""

import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

CAPACITY = 1024
"""Writes that may wait. A run makes about ten, so a full queue means a disk that has stopped answering."""


class StorageFullError(OSError):
    """The disk does not keep up; nothing was queued."""


class StorageThread:
    """Runs jobs one after another on a thread of its own.

    A job that fails is remembered in `fault` until one succeeds again: the cell refuses to start a run meanwhile.
    """

    def __init__(self) -> None:
        self._jobs: queue.Queue[tuple[Callable[[], Any], Future[Any]] | None] = queue.Queue(CAPACITY)
        self._fault: str | None = None
        self._thread = threading.Thread(target=self._work, name="storage", daemon=True)
        self._thread.start()

    @property
    def fault(self) -> str | None:
        """Why the last write failed, or that writes are piling up; None when the disk is well."""
        if self._jobs.qsize() > CAPACITY // 2:
            return f"{self._jobs.qsize()} writes wait for the disk"
        return self._fault

    def submit(self, job: Callable[[], Any]) -> Future[Any]:
        """Queue a job; never blocks. The future holds its result or the exception.

        Raises:
            StorageFullError: `CAPACITY` jobs wait already.
        """
        future: Future[Any] = Future()
        try:
            self._jobs.put_nowait((job, future))
        except queue.Full:
            self._fault = f"{CAPACITY} writes wait for the disk"
            raise StorageFullError(self._fault) from None
        return future

    def close(self, timeout_s: float) -> bool:
        """Finish what is queued, for at most `timeout_s`; return whether everything was written."""
        try:
            self._jobs.put(None, timeout=timeout_s)
        except queue.Full:
            return False
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _work(self) -> None:
        while (entry := self._jobs.get()) is not None:
            job, future = entry
            try:
                result = job()
            except Exception as error:
                self._fault = f"{type(error).__name__}: {error}"
                future.set_exception(error)
            else:
                self._fault = None
                future.set_result(result)
