"""Upload of a program to the controller's primary port, TCP 30001, until it runs or its failure is known.

A controller accepts any text there and does not answer. The result is read from the messages that the same port pushes:
started, failed at a line, or refused because the connection was made in local control.
"""

import asyncio
import contextlib
import re
from collections.abc import AsyncIterator
from enum import StrEnum

from wire.primary.errors import PrimaryError
from wire.primary.messages import (
    PROGRAM_STARTED,
    ErrorCode,
    Key,
    Message,
    ReportLevel,
    RuntimeException,
    decode_message,
)
from wire.primary.packages import PORT, PackageReader, PackageType
from wire.primary.state import RobotMode, decode_state
from wire.rtde import modes

__all__ = ["PORT", "UploadError", "UploadErrorReason", "upload"]

START_TIMEOUT_S = 5.0
_READ_BYTES = 16384
_GRAVE = (ReportLevel.VIOLATION, ReportLevel.FAULT, ReportLevel.CRITICAL_FAULT)
_DEFINITION = re.compile(r"\s*def\s+([A-Za-z_]\w*)\s*\(")


class UploadErrorReason(StrEnum):
    """Kinds of `UploadError`."""

    UNREACHABLE = "unreachable"
    """No connection."""
    LOST = "lost"
    """The connection ended, or the peer is not the primary interface."""
    TIMEOUT = "timeout"
    """No message reported in time that the program runs."""
    NOT_RUNNING = "not_running"
    """The arm has no power, its brakes are closed, or it is stopped for safety."""
    NOT_REMOTE = "not_remote"
    """The robot is in local control, or was when the connection was made."""
    SCRIPT = "script"
    """The program is wrong: it does not compile, or failed at its start."""
    CONTROLLER = "controller"
    """The controller reported an error."""


class UploadError(Exception):
    """A program does not run; `reason` gives the kind, the text says what to do.

    Attributes:
        reason: kind of the failure, for code to match on.
        line: line of the given text, from 1; 0 if the error has no place.
        column: column, from 1; 0 likewise.
    """

    def __init__(self, reason: UploadErrorReason, text: str, line: int = 0, column: int = 0) -> None:
        super().__init__(text)
        self.reason = reason
        self.line = line
        self.column = column


async def upload(host: str, port: int, text: str, *, timeout_s: float = START_TIMEOUT_S) -> None:
    """Run a program on a controller, replacing the running one.

    Args:
        host: address of the controller.
        port: its primary port.
        text: one `def name(): … end`; comments and blank lines may precede it.
        timeout_s: longest time from connecting until the program runs, s.

    Raises:
        UploadError: the program does not run.
        ValueError: the text does not begin with `def name(`; the result of a secondary program cannot be observed.
    """
    skipped, program = _begin(text)
    definition = _DEFINITION.match(program)
    if definition is None:
        raise ValueError("a program to upload begins with `def name():`")
    try:
        async with asyncio.timeout(timeout_s):
            await _run(host, port, program, definition[1], skipped)
    except TimeoutError as error:
        what = f"{host}:{port} did not report within {timeout_s:g} s that `{definition[1]}` runs"
        raise UploadError(UploadErrorReason.TIMEOUT, f"{what}; is the robot in remote control?") from error


def _begin(text: str) -> tuple[int, str]:
    """Cut off the lines before the program, which controllers may or may not count; return their number and the
    program.
    """
    lines = text.splitlines()
    skipped = 0
    while skipped < len(lines) and not lines[skipped].partition("#")[0].strip():
        skipped += 1
    return skipped, "\n".join(lines[skipped:]) + "\n"


async def _run(host: str, port: int, program: str, name: str, skipped: int) -> None:
    try:
        reader, writer = await asyncio.open_connection(host, port)
    except OSError as error:
        raise UploadError(
            UploadErrorReason.UNREACHABLE, f"cannot reach the primary port {host}:{port}: {error}"
        ) from error
    try:
        packages = _packages(reader)
        await _await_running(packages)
        if writer.is_closing():
            raise ConnectionError("closed by the controller")  # not every event loop reports this when writing
        writer.write(program.encode())
        await writer.drain()
        async for package in packages:
            if isinstance(package, Message):
                _raise_error(package, skipped)
                if isinstance(package, Key) and (package.title, package.text) == (PROGRAM_STARTED, name):
                    return
    except (OSError, PrimaryError) as error:
        raise UploadError(UploadErrorReason.LOST, f"the connection to {host}:{port} broke: {error}") from error
    finally:
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()


async def _packages(reader: asyncio.StreamReader) -> AsyncIterator[RobotMode | Message]:
    """Yield the port's messages that matter here, without end."""
    packages = PackageReader()
    while data := await reader.read(_READ_BYTES):
        for kind, content in packages.feed(data):
            if kind == PackageType.ROBOT_STATE:
                for part in decode_state(content):
                    if isinstance(part, RobotMode):
                        yield part
            elif kind == PackageType.ROBOT_MESSAGE:
                message = decode_message(content).message
                if message is not None:
                    yield message
    raise UploadError(UploadErrorReason.LOST, "the controller closed the connection")


async def _await_running(packages: AsyncIterator[RobotMode | Message]) -> None:
    """Read until the arm's mode is known; raise for an arm that cannot run a program."""
    async for package in packages:
        if not isinstance(package, RobotMode):
            continue
        if package.is_emergency_stopped:
            raise UploadError(
                UploadErrorReason.NOT_RUNNING, "the arm is emergency-stopped; release, power on, release the brakes"
            )
        if package.is_protective_stopped:
            raise UploadError(
                UploadErrorReason.NOT_RUNNING, "the arm is in a protective stop; inspect the cause, then unlock it"
            )
        if package.robot_mode != modes.RobotMode.RUNNING:
            text = f"the arm is in robot mode {package.robot_mode}, not RUNNING; power it on and release the brakes"
            raise UploadError(UploadErrorReason.NOT_RUNNING, text)
        return


def _raise_error(message: Message, skipped: int) -> None:
    if isinstance(message, RuntimeException):
        line = message.line + skipped if message.line > 0 else 0
        place = f"line {line}, column {message.column}: " if line else ""
        raise UploadError(UploadErrorReason.SCRIPT, f"{place}{message.text}", line, message.column)
    if isinstance(message, ErrorCode):
        if message.code == ErrorCode.READ_ONLY:
            text = "the controller takes no program over this connection: switch the robot to remote control, try again"
            raise UploadError(UploadErrorReason.NOT_REMOTE, text)
        if message.level in _GRAVE:
            text = f"the controller reports C{message.code}A{message.argument}: {message.text or 'no detail'}"
            raise UploadError(UploadErrorReason.CONTROLLER, text)
