"""Log lines on standard error. Logging neither blocks nor raises: a thread of its own formats and writes the lines."""

import atexit
import contextvars
import io
import logging
import os
import queue
import select
import sys
import threading
import time
import traceback
from collections.abc import Callable
from functools import partial
from typing import Any, TextIO

import structlog

CAPACITY = 1000
"""Largest number of lines that wait to be written; further ones are lost, and counted."""
LINE_LIMIT = 16_384
"""Longest text written for one event, characters."""
FRAMES = 20
"""Innermost frames of a traceback that are written."""
STUCK_S = 1.0
"""Time of one write after which the log counts as not written."""
DRAIN_S = 0.5
"""Longest time for which the end of the process waits for the log, s."""

Line = str | Callable[[], str]


def hold_exception(_logger: Any, _name: str, event: structlog.typing.EventDict) -> structlog.typing.EventDict:
    """Put the exception under way in place of `exc_info=True`; the thread that formats it has none under way."""
    if event.get("exc_info") is True:
        event["exc_info"] = sys.exc_info()
    return event


def _write_traceback(out: TextIO, exc_info: structlog.typing.ExcInfo) -> None:
    # Plain: a rendered traceback with local variables takes half a second
    out.write("\n" + "".join(traceback.format_exception(*exc_info, limit=-FRAMES)))


_MARKS: tuple[structlog.typing.Processor, ...] = (
    structlog.contextvars.merge_contextvars,
    structlog.processors.add_log_level,
    structlog.dev.set_exc_info,
    hold_exception,
    structlog.processors.TimeStamper(fmt="%Y-%m-%d %H:%M:%S", utc=False),
)
_RENDERER = structlog.dev.ConsoleRenderer(colors=False, exception_formatter=_write_traceback)
PROCESSORS = (*_MARKS, _RENDERER)
"""The whole way of an event to its line."""


class LogWriter:
    """Writes lines in their order on a thread of its own.

    Args:
        handle: file descriptor of the target, which the caller keeps open.
        trouble: reason for which the target is no good from the start.
    """

    def __init__(self, handle: int, trouble: str = "") -> None:
        self._handle = handle
        self._trouble = trouble
        self._lines: queue.SimpleQueue[Line] = queue.SimpleQueue()
        self._lost = 0
        self._unwritten = 0
        self._writing_since: float | None = None
        threading.Thread(target=self._work, name="log", daemon=True).start()

    @property
    def fault(self) -> str | None:
        """Say what is missing from the log, and why; None while nothing is."""
        since = self._writing_since
        if since is not None and time.monotonic() - since > STUCK_S:
            return f"the log: {self._lost + self._lines.qsize() + 1} lines are not written: nobody reads standard error"
        lost = self._lost + self._unwritten
        if lost or self._trouble:
            return f"the log: {lost} lines are lost{f': {self._trouble}' if self._trouble else ''}"
        return None

    def put(self, line: Line) -> None:
        """Have a line written, or count it as lost; a function returns the line and is called on the thread."""
        if self._lines.qsize() >= CAPACITY:
            self._lost += 1
        else:
            self._lines.put(line)

    def drain(self, timeout_s: float = DRAIN_S) -> None:
        """Wait until everything is written, for a limited time."""
        done = threading.Event()

        def last() -> str:
            done.set()
            return ""

        self._lines.put(last)
        done.wait(timeout_s)

    def _work(self) -> None:
        while True:
            line = self._lines.get()
            try:
                text = line if isinstance(line, str) else line()
            except Exception as error:
                text = f"a line of the log could not be formatted: {type(error).__name__}\n"
            self._writing_since = time.monotonic()
            try:
                self._write(text[:LINE_LIMIT].encode(errors="backslashreplace"))
            except OSError as error:
                self._unwritten += 1
                self._trouble = error.strerror or type(error).__name__
            self._writing_since = None

    def _write(self, data: bytes) -> None:
        view = memoryview(data)
        while view:
            try:
                view = view[os.write(self._handle, view) :]
            except BlockingIOError:  # somebody has made the target non-blocking
                select.select([], [self._handle], [])


class QueuedHandler(logging.Handler):
    """Hands records of the standard library's loggers to a writer; they are formatted on its thread.

    Args:
        writer: of this process.
    """

    def __init__(self, writer: LogWriter) -> None:
        super().__init__()
        self._writer = writer

    def emit(self, record: logging.LogRecord) -> None:
        context = contextvars.copy_context()
        self._writer.put(lambda: context.run(self.format, record) + "\n")


class _EventLogger:
    """Takes structlog's events; formatting is left to the writer's thread."""

    def __init__(self, writer: LogWriter, *_: object) -> None:
        self._writer = writer

    def msg(self, **event: Any) -> None:
        self._writer.put(lambda: f"{_RENDERER(None, '', event)}\n")

    log = debug = info = warn = warning = err = error = exception = critical = fatal = failure = msg


class _StandardError(io.TextIOBase):
    """Takes the place of `sys.stderr`: whatever the interpreter or a library prints there goes through the writer."""

    encoding = "utf-8"
    errors = "backslashreplace"

    def __init__(self, writer: LogWriter, handle: int) -> None:
        self._writer = writer
        self._handle = handle

    def write(self, text: str, /) -> int:
        if not isinstance(text, str):  # pyright: ignore[reportUnnecessaryIsInstance]  # click asks by trying
            raise TypeError("standard error takes text")
        self._writer.put(text)
        return len(text)

    def writable(self) -> bool:
        return True

    def isatty(self) -> bool:
        return os.isatty(self._handle)

    def fileno(self) -> int:
        return self._handle


_writer: LogWriter | None = None


def log_writer() -> LogWriter:
    """Return this process's writer on standard error; the first call starts it, and the process's end waits for it."""
    global _writer
    if _writer is None:
        trouble = _open_standard_handles()
        _writer = LogWriter(os.dup(2), trouble)
        atexit.register(_writer.drain)
    return _writer


def log_fault() -> str | None:
    """Say what is missing from this process's log; None while nothing is, or where there is no log."""
    return None if _writer is None else _writer.fault


def configure_logs(writer: LogWriter | None = None) -> None:
    """Send structlog's events, and what the standard library's loggers report, to one target.

    Args:
        writer: of the target; None: standard error.
    """
    writer = writer or log_writer()
    structlog.configure(processors=_MARKS, logger_factory=partial(_EventLogger, writer))
    handler = QueuedHandler(writer)
    handler.setFormatter(logging.Formatter("%(asctime)s [%(levelname)s] %(message)s %(name)s"))
    logging.getLogger().handlers = [handler]


def take_over_stderr() -> None:
    """Send what is printed to `sys.stderr` through the log's writer, so that no print can hold this process up."""
    writer = log_writer()
    sys.stderr = _StandardError(writer, 2)


def _open_standard_handles() -> str:
    """Open the null device in place of closed standard handles, lest the next file opened become the log's target.

    Returns:
        Reason for which standard error is no good; empty where it is open.
    """
    trouble = ""
    for handle in range(3):
        try:
            os.fstat(handle)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
            trouble = "standard error is closed" if handle == 2 else ""
    return trouble
