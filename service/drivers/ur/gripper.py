"""Driver of a Robotiq 2F-85 through the server of its URCap on the controller, TCP 63352.

The gripper counts positions from 0, open, to 255, closed; its fingers end before both, at counts that differ slightly
between grippers. Requests are lines, `SET name value …` and `GET name`, with the manual's variables.
"""

import asyncio
import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from types import TracebackType
from typing import Self

PORT = 63352
STROKE_MM = 85.0
SPEED_MM_S = (20.0, 150.0)
FORCE_N = (20.0, 235.0)
"""Smallest and largest force of a 2F-85."""
POS_OPEN, POS_CLOSED = 3, 230
"""Counts of a 2F-85 with its own fingertips, 85 mm and 0 mm apart."""

REPLY_TIMEOUT_S = 2.0
ACTIVATION_TIMEOUT_S = 15.0
MOTION_TIMEOUT_S = 10.0
POLL_S = 0.02
_READ_BYTES = 256
_NAMES = ("STA", "PRE", "OBJ", "FLT", "POS")  # PRE before OBJ: an older OBJ would look like a finished motion
_ACK = b"ack"
_GRAVE_FAULT = 8  # lower numbers in the manual name the condition that the gripper waits for


class GripperErrorReason(StrEnum):
    """Kinds of `GripperError`."""

    UNREACHABLE = "unreachable"
    LOST = "lost"
    """The connection ended."""
    TIMEOUT = "timeout"
    """No answer in time, or no end of a motion in time."""
    REFUSED = "refused"
    """The server does not accept the request."""
    NOT_ACTIVE = "not_active"
    """The gripper must be activated first."""
    FAULT = "fault"
    """The gripper reports a fault."""


class GripperError(Exception):
    """A gripper's failure; `reason` gives the kind, the text says what to do."""

    def __init__(self, reason: GripperErrorReason, text: str) -> None:
        super().__init__(text)
        self.reason = reason


class Activation(IntEnum):
    """Values of STA, the state of the activation."""

    RESET = 0
    ACTIVATING = 1
    ACTIVE = 3


class Detection(IntEnum):
    """Values of OBJ: motion of the fingers, and the end of their last motion."""

    MOVING = 0
    OBJECT_OPENING = 1
    OBJECT_CLOSING = 2
    ARRIVED = 3


@dataclass(frozen=True, slots=True)
class GripperStatus:
    """State reported by the gripper.

    Attributes:
        activation: state of the activation.
        requested: position request as received by the gripper, counts.
        detection: state of the motion; MOVING until the fingers rest.
        fault: number in the manual; 0 without a fault.
        position: position of the fingers, counts.
    """

    activation: int
    requested: int
    detection: int
    fault: int
    position: int

    @property
    def opening_mm(self) -> float:
        """Distance between the fingertips, 0 … 85 mm."""
        return min(max(STROKE_MM * (POS_CLOSED - self.position) / (POS_CLOSED - POS_OPEN), 0.0), STROKE_MM)

    @property
    def is_active(self) -> bool:
        return self.activation == Activation.ACTIVE

    @property
    def is_moving(self) -> bool:
        return self.detection == Detection.MOVING

    @property
    def holds_object(self) -> bool:
        """The fingers rest against an object."""
        return self.detection in (Detection.OBJECT_OPENING, Detection.OBJECT_CLOSING)


class Gripper:
    """One connection to a gripper's server; requests run one after another, in the order of their calls.

    After LOST or TIMEOUT it must be connected again; the gripper continues its last request.
    """

    def __init__(self, host: str, port: int = PORT) -> None:
        """Store the server's address; `connect` opens the connection."""
        self.host = host
        self.port = port
        self._turn = asyncio.Lock()
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def __aenter__(self) -> Self:
        await self.connect()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.disconnect()

    async def connect(self) -> None:
        """Connect; nothing moves.

        Raises:
            GripperError: UNREACHABLE.
        """
        await self.disconnect()
        try:
            async with asyncio.timeout(REPLY_TIMEOUT_S):
                self._streams = await asyncio.open_connection(self.host, self.port)
        except (OSError, TimeoutError) as error:
            where = f"{self.host}:{self.port}"
            text = f"cannot reach the gripper at {where}: {error or 'no answer'}; is its URCap installed?"
            raise GripperError(GripperErrorReason.UNREACHABLE, text) from error

    async def disconnect(self) -> None:
        """Close the connection; the gripper keeps its grip."""
        streams, self._streams = self._streams, None
        if streams is not None:
            streams[1].close()
            with contextlib.suppress(OSError):
                await streams[1].wait_closed()

    async def status(self) -> GripperStatus:
        """Query the state.

        Raises:
            GripperError: LOST or TIMEOUT.
        """
        values = [await self._get(name) for name in _NAMES]
        return GripperStatus(*values)

    async def activate(self) -> GripperStatus:
        """Activate unless active; the fingers then open and close once and would drop an object.

        Raises:
            GripperError: TIMEOUT, FAULT.
        """
        status = await self.status()
        if status.is_active and status.fault == 0:
            return status
        await self._set(ACT=0, ATR=0)
        await self._until(lambda seen: seen.activation == Activation.RESET, "to reset", REPLY_TIMEOUT_S, resets=True)
        await self._set(ACT=1)
        return await self._until(lambda seen: seen.is_active, "to activate", ACTIVATION_TIMEOUT_S)

    async def open(self, speed_mm_s: float = SPEED_MM_S[1], force_n: float = FORCE_N[0]) -> GripperStatus:
        """Open fully; arguments and errors as in `move`."""
        return await self.move(STROKE_MM, speed_mm_s, force_n)

    async def close(self, speed_mm_s: float = SPEED_MM_S[0], force_n: float = FORCE_N[0]) -> GripperStatus:
        """Close until the fingers hold an object or meet; the status tells which. Arguments and errors as in `move`."""
        return await self._go(255, speed_mm_s, force_n)

    async def move(
        self, opening_mm: float, speed_mm_s: float = SPEED_MM_S[1], force_n: float = FORCE_N[0]
    ) -> GripperStatus:
        """Move the fingers and return the status once they rest.

        Args:
            opening_mm: distance between the fingertips, 0 … 85 mm.
            speed_mm_s: speed, 20 … 150 mm/s.
            force_n: force on an object, 20 … 235 N.

        Raises:
            GripperError: NOT_ACTIVE, FAULT, TIMEOUT, LOST.
            ValueError: an argument is outside its range.
        """
        fraction = _fraction(opening_mm, (0.0, STROKE_MM), "opening_mm")
        return await self._go(round(POS_CLOSED - fraction * (POS_CLOSED - POS_OPEN)), speed_mm_s, force_n)

    async def _go(self, position: int, speed_mm_s: float, force_n: float) -> GripperStatus:
        speed = round(255 * _fraction(speed_mm_s, SPEED_MM_S, "speed_mm_s"))
        force = round(255 * _fraction(force_n, FORCE_N, "force_n"))
        if not (await self.status()).is_active:
            text = "the gripper is not activated; activate it, with nothing between its fingers"
            raise GripperError(GripperErrorReason.NOT_ACTIVE, text)
        await self._set(POS=position, SPE=speed, FOR=force, GTO=1)
        return await self._until(
            lambda seen: seen.requested == position and not seen.is_moving, "to come to rest", MOTION_TIMEOUT_S
        )

    async def _until(
        self, done: Callable[[GripperStatus], bool], what: str, timeout_s: float, *, resets: bool = False
    ) -> GripperStatus:
        clock = asyncio.get_running_loop().time
        deadline_s = clock() + timeout_s
        while True:
            status = await self.status()
            if status.fault >= _GRAVE_FAULT and not resets:
                text = f"the gripper reports fault {status.fault}; see its manual, then activate it again"
                raise GripperError(GripperErrorReason.FAULT, text)
            if done(status):
                return status
            if clock() > deadline_s:
                raise GripperError(
                    GripperErrorReason.TIMEOUT, f"the gripper took more than {timeout_s:g} s {what}: {status}"
                )
            await asyncio.sleep(POLL_S)

    async def _set(self, **values: int) -> None:
        request = "SET " + " ".join(f"{name} {value}" for name, value in values.items())
        reply = await self._ask(request, lambda reply: reply.startswith(_ACK) or reply.endswith(b"\n"))
        if not reply.startswith(_ACK):
            raise GripperError(GripperErrorReason.REFUSED, f"`{request}` was answered with {reply!r}")

    async def _get(self, name: str) -> int:
        reply = await self._ask(f"GET {name}", lambda reply: reply.endswith(b"\n"))
        match reply.split():
            case [first, value] if first == name.encode() and value.isdigit():
                return int(value)
            case _:
                raise GripperError(GripperErrorReason.REFUSED, f"`GET {name}` was answered with {reply!r}")

    async def _ask(self, request: str, complete: Callable[[bytes], bool]) -> bytes:
        """Send a line and read until its answer is complete; an acknowledgement has no end of line."""
        async with self._turn:
            if self._streams is None:
                raise GripperError(GripperErrorReason.LOST, f"`{request}`: not connected to the gripper; connect first")
            reader, writer = self._streams
            try:
                if writer.is_closing():
                    raise ConnectionError("closed by the controller")  # not every event loop reports this when writing
                async with asyncio.timeout(REPLY_TIMEOUT_S):
                    writer.write(request.encode() + b"\n")
                    reply = b""
                    while not complete(reply):
                        data = await reader.read(_READ_BYTES)
                        if not data:
                            raise ConnectionError("closed by the controller")
                        reply += data
                return reply
            except BaseException as error:
                self._streams = None  # a late answer would be taken for the answer to the next request
                writer.close()
                if isinstance(error, TimeoutError):
                    text = f"`{request}` was not answered within {REPLY_TIMEOUT_S:g} s"
                    raise GripperError(GripperErrorReason.TIMEOUT, text) from error
                if isinstance(error, OSError):
                    raise GripperError(
                        GripperErrorReason.LOST, f"the gripper's connection broke at `{request}`: {error}"
                    ) from error
                raise


def _fraction(value: float, limits: tuple[float, float], name: str) -> float:
    low, high = limits
    if not (math.isfinite(value) and low <= value <= high):
        raise ValueError(f"{name} is {value:g}; a 2F-85 takes {low:g} to {high:g}")
    return (value - low) / (high - low)
