"""Logging on a safety path: whatever becomes of the log's target, nothing that logs blocks or raises. Row 76."""

import asyncio
import errno
import logging
import os
import signal
import statistics
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import structlog

from service.faults import FaultCode
from service.logs import CAPACITY, LINE_LIMIT, LogWriter, QueuedHandler, configure_logs
from service.messages import CellState, StartRequest, StopRequest
from service.stopping import confirm
from tests.service.cell.conftest import EASY
from tests.service.cell.test_process import configured, control_process, until
from tests.service.drivers.ur.emulated import emulated
from tests.service.drivers.ur.test_driver import engaged
from wire.rtde.modes import RobotMode

TARGETS = ("full", "closed", "slow")
HELD_S = 5e-3


def full_pipe() -> tuple[int, int]:
    """Return the ends of a pipe into which not one more byte goes."""
    read, write = os.pipe()
    os.set_blocking(write, False)
    while True:
        try:
            os.write(write, b"x" * 4096)
        except BlockingIOError:
            break
    os.set_blocking(write, True)
    return read, write


@contextmanager
def target(kind: str) -> Iterator[int]:
    """Yield a file descriptor that takes no line: of a full disk, closed, or of a pipe that nobody reads."""
    if kind == "slow":
        read, write = full_pipe()
        yield write
        os.close(read)
        os.close(write)
    else:
        handle = os.open("/dev/full", os.O_WRONLY)
        if kind == "closed":
            os.close(handle)
        yield handle
        if kind == "full":
            os.close(handle)


@pytest.fixture(params=TARGETS)
def no_log(request: pytest.FixtureRequest) -> Iterator[LogWriter]:
    """Log to a target that takes no line."""
    handlers = logging.getLogger().handlers
    with target(request.param) as handle:
        configure_logs(writer := LogWriter(handle))
        yield writer
    logging.getLogger().handlers = handlers


def fail_deeply(depth: int = 400) -> None:
    """Raise an error with a long traceback and a long text."""
    if depth:
        fail_deeply(depth - 1)
    raise RuntimeError("x" * 1000)


# --- escalation


async def test_76_the_power_is_cut_although_no_line_can_be_logged(no_log: LogWriter) -> None:
    async with emulated() as arm:
        await engaged(arm)
        arm.controller.stop_program = lambda: None  # type: ignore[method-assign]
        arm.driver.escalate()
        async with asyncio.timeout(30.0):
            while arm.controller.robot_mode is not RobotMode.POWER_OFF:
                await asyncio.sleep(0)


# --- the loop


async def test_76_an_exception_logged_on_the_loop_holds_it_less_than_5_ms(no_log: LogWriter) -> None:
    configure_logs(no_log)  # again: pytest has put a handler of its own there
    log, stdlib = structlog.get_logger("test"), logging.getLogger("test")

    def by_structlog() -> None:
        log.exception("sample", seq=3)

    def by_the_standard_library() -> None:
        stdlib.exception("sample %d", 3)

    def by_asyncio() -> None:
        asyncio.get_running_loop().call_exception_handler({"message": "sample", "exception": sys.exception()})

    for write in (by_structlog, by_the_standard_library, by_asyncio):
        spans: list[float] = []
        for _ in range(21):
            try:
                fail_deeply()
            except RuntimeError:
                begun = time.perf_counter()
                write()
                spans.append(time.perf_counter() - begun)
            await asyncio.sleep(0.001)
        assert statistics.median(spans) < HELD_S


# --- the control process


@pytest.mark.parametrize("kind", TARGETS)
async def test_76_a_control_process_without_a_log_stops_and_ends_as_ever(tmp_path: Path, kind: str) -> None:
    path, endpoint = configured(tmp_path)
    with target(kind) as handle:
        streams = {"preexec_fn": lambda: os.close(2)} if kind == "closed" else {"stderr": handle}
        async with control_process(path, endpoint, **streams) as (process, client):
            await client.start(StartRequest(recipe="triangle-2mm", seed=EASY))
            await until(lambda: client.state is CellState.RUNNING)
            stopped = await confirm(client, await client.stop(StopRequest()))
            assert stopped.confirmed
            status = stopped.status
            assert status.latch is not None
            assert status.latch.code is FaultCode.OPERATOR_STOP
            assert any(line.startswith("the log: ") for line in status.degradations), status.degradations
            process.send_signal(signal.SIGTERM)
            begun = time.monotonic()
            await asyncio.to_thread(process.wait, 20)
            assert time.monotonic() - begun <= 2.0
            assert process.returncode == 0


# --- the writer


@pytest.fixture
def pipe() -> Iterator[tuple[int, LogWriter]]:
    read, write = os.pipe()
    yield read, LogWriter(write)
    os.close(read)


def read_lines(read: int, count: int) -> list[str]:
    with os.fdopen(os.dup(read), "rb") as lines:
        return [lines.readline().decode() for _ in range(count)]


def test_lines_come_in_their_order_whoever_logs(pipe: tuple[int, LogWriter]) -> None:
    read, writer = pipe
    handlers = logging.getLogger().handlers
    configure_logs(writer)
    structlog.get_logger("a").warning("first", cause="one")
    logging.getLogger("b").warning("second %s", "two")
    writer.put("third\n")
    first, second, third = read_lines(read, 3)
    logging.getLogger().handlers = handlers
    assert "first" in first
    assert "cause=one" in first
    assert "second two" in second
    assert third == "third\n"
    assert writer.fault is None


def test_a_traceback_is_that_of_the_thread_that_logged_and_bounded(pipe: tuple[int, LogWriter]) -> None:
    read, writer = pipe
    handlers = logging.getLogger().handlers
    configure_logs(writer)
    try:
        fail_deeply(3)
    except RuntimeError:
        structlog.get_logger("a").exception("broken")
    writer.put("end\n")
    lines: list[str] = []
    with os.fdopen(os.dup(read), "rb") as pipe_end:
        while (line := pipe_end.readline().decode()) != "end\n":
            lines.append(line)
    logging.getLogger().handlers = handlers
    text = "".join(lines)
    assert "broken" in text
    assert "in fail_deeply" in text
    assert "RuntimeError: xxx" in text
    assert len(text) <= LINE_LIMIT


def test_a_line_that_cannot_be_formatted_costs_that_line_only(pipe: tuple[int, LogWriter]) -> None:
    read, writer = pipe

    def broken() -> str:
        raise ZeroDivisionError

    writer.put(broken)
    writer.put("next\n")
    assert read_lines(read, 2) == ["a line of the log could not be formatted: ZeroDivisionError\n", "next\n"]


def test_what_is_lost_is_counted_and_the_log_goes_on_afterwards() -> None:
    read, write = full_pipe()
    writer = LogWriter(write)
    for number in range(CAPACITY + 12):
        writer.put(f"{number}\n")
    deadline = time.monotonic() + 10.0
    while writer.fault is None or "nobody reads" not in writer.fault:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    os.set_blocking(read, False)
    while time.monotonic() < deadline:
        try:
            data = os.read(read, 65_536)
        except BlockingIOError:
            data = b""
            time.sleep(0.01)
        if data.endswith(f"{CAPACITY}\n".encode()) or data.endswith(f"{CAPACITY - 1}\n".encode()):
            break
    writer.drain(5.0)
    assert writer.fault is not None
    assert "lines are lost" in writer.fault
    os.close(read)
    os.close(write)


def test_a_full_disk_is_named() -> None:
    with target("full") as handle:
        writer = LogWriter(handle)
        writer.put("lost\n")
        writer.drain(5.0)
        assert writer.fault == f"the log: 1 lines are lost: {os.strerror(errno.ENOSPC)}"


def test_records_keep_the_context_of_the_thread_that_logged(pipe: tuple[int, LogWriter]) -> None:
    read, writer = pipe
    handler = QueuedHandler(writer)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=[structlog.contextvars.merge_contextvars],
            processors=[
                structlog.stdlib.ProcessorFormatter.remove_processors_meta,
                structlog.processors.JSONRenderer(sort_keys=True),
            ],
        )
    )
    with structlog.contextvars.bound_contextvars(request_id="r-1"):
        handler.emit(logging.LogRecord("a", logging.INFO, "", 0, "text", None, None))
    assert read_lines(read, 1) == ['{"event": "text", "request_id": "r-1"}\n']
