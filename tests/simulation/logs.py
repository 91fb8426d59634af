"""The logs' target on the virtual clock: the real writers, one per process, on a disk that is full or a pipe unread."""

import errno
import os
from collections.abc import Callable
from typing import Any

import structlog

import service.logs
from service.logs import LogWriter
from tests.simulation import clock

Change = tuple[Any, str, Any]


class LogTarget:
    """Takes every line of every process.

    Args:
        note: adds a warning or an error to the trace.

    Attributes:
        full_until: until then a line cannot be written.
        unread_until: until then a line is not taken; its writer waits.
    """

    def __init__(self, loop: clock.VirtualLoop, note: Callable[[str], None]) -> None:
        self._loop, self._note = loop, note
        self._writers: dict[clock.Process, LogWriter] = {}
        self.full_until = self.unread_until = 0.0

    def configure(self) -> None:
        """Send what the code logs to the writer of the process that logs it."""
        structlog.configure(processors=service.logs._MARKS, logger_factory=self._logger)

    def changes(self) -> list[Change]:
        """Return what is put under the real writers."""
        return [(service.logs, "_RENDERER", _rendered), (LogWriter, "_write", self._write)]

    def fault(self) -> str | None:
        """Stand in for `service.logs.log_fault`."""
        writer = self._writers.get(clock.here().process)
        return None if writer is None else writer.fault

    def forget(self) -> None:
        """Drop every writer."""
        self._writers.clear()

    def _logger(self, *_: Any) -> Any:
        process = clock.here().process
        if process not in self._writers:
            self._writers[process] = LogWriter(2)
        return service.logs._EventLogger(self._writers[process])

    def _write(self, data: bytes) -> None:
        now = self._loop.time()
        if now < self.unread_until:
            clock.sleep(self.unread_until - now)
        if now < self.full_until:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if line := data.decode().strip():
            self._note(line)


def _rendered(_logger: Any, _name: str, event: dict[str, Any]) -> str:
    """Render a warning or an error without what differs from one replay to the next."""
    level = event.get("level")
    if level in ("debug", "info"):
        return ""
    error = event.get("exc_info")
    error = error[1] if isinstance(error, tuple) else error
    return f"log {level}: {event.get('event')}{f' {error!r}' if error else ''}"
