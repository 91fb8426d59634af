"""An asynchronous client of one cell's control process, over Zenoh.

Examples:
    Start a run and stop it. This one is not run as a test: it needs a running cell.

    >>> async with CellClient("cell-1", connect=["tcp/127.0.0.1:7447"]) as cell:  # doctest: +SKIP
    ...     run = await cell.start(StartRequest(recipe="triangle-2mm", seed=7))
    ...     await cell.stop(StopRequest(reason="enough"))
"""

import asyncio
import contextlib
import os
import socket
import time
from collections.abc import AsyncGenerator, Callable, Sequence
from contextlib import asynccontextmanager
from types import TracebackType
from typing import Self, TypeVar

import zenoh
from pydantic import TypeAdapter, ValidationError

from service import messages
from service.envelope import (
    ENVELOPE_VERSION,
    QUERY_TICKET,
    TICKET_ANSWER,
    TICKET_IDLE_S,
    Envelope,
    Presence,
    TicketRequest,
    TicketResult,
)
from service.messages import (
    CellState,
    Event,
    Message,
    Problem,
    RefusalReason,
    Refused,
    ResetRequest,
    Run,
    RunRequest,
    RunResult,
    RunsRequest,
    StartRequest,
    Status,
    StopMark,
    StopRequest,
    Telemetry,
)
from service.program import PROGRAM
from wire.session import call_in_loop, close_session, open_session, query
from wire.tls import Certificates

SILENCE_S = 0.5
"""Age of the last heartbeat at which a cell counts as silent: ten heartbeats."""
VALID_PART = 0.8
"""Part of a start's timeout for which it is valid; the rest is for the answer's way back."""
QUEUE_LENGTH = 256
"""Messages held for a slow subscriber; beyond it the oldest is dropped."""
TICKET_S = 1.0
"""Longest wait for a ticket, s."""


T = TypeVar("T")
MessageT = TypeVar("MessageT", bound=Message)


class CellError(Exception):
    """Root of this client's exceptions."""


class CellSilentError(CellError):
    """The control process gives no answer: it is not running, is frozen, or cannot be reached."""


class CellRefusedError(CellError):
    """The cell refused the request; `problem` has its reason."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem.detail)
        self.problem = problem


class CellClient:
    """Talks to one cell. Call every method on the event loop that entered the context.

    Args:
        cell: the cell's id.
        connect: endpoints of its control process.
        clock: monotonic seconds, for the heartbeat's age and the validity of a start.
        sender: name of this program in the cell's record; None: its process and host.
        certificates: of this program, for a `tls/` or `quic/` endpoint.
    """

    def __init__(
        self,
        cell: str,
        connect: Sequence[str],
        clock: Callable[[], float] = time.monotonic,
        sender: str | None = None,
        certificates: Certificates | None = None,
    ) -> None:
        self._cell = cell
        self._certificates = certificates
        self._sender = sender or f"process {os.getpid()} on {socket.gethostname()[:64]}"
        self._ticket: TicketResult | None = None
        self._number = 0
        self._connect = tuple(connect)
        self._clock = clock
        self._session: zenoh.Session | None = None
        self._presence: asyncio.Task[None] | None = None
        self._status: Status | None = None
        self._heard_at: float | None = None
        self._mark: StopMark | None = None
        self._status_queues: set[asyncio.Queue[Status]] = set()
        self._event_queues: set[asyncio.Queue[Event]] = set()
        self._telemetry_queues: set[asyncio.Queue[Telemetry]] = set()

    async def __aenter__(self) -> Self:
        await self.open()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def open(self) -> None:
        """Open the session and subscribe. The cell need not be running yet."""
        session = await asyncio.to_thread(open_session, (), self._connect, self._certificates)
        self._session = session
        self._presence = asyncio.create_task(self._say_present(session), name=f"client of {self._cell}")
        self._subscribe(session, messages.STATUS, Status, self._on_status)
        self._subscribe(session, messages.EVENT, Event, lambda event: _offer(self._event_queues, event))
        self._subscribe(session, messages.TELEMETRY, Telemetry, lambda point: _offer(self._telemetry_queues, point))

    async def close(self) -> None:
        """Close the session. The cell then does what its `client_loss` says."""
        if self._presence is not None:
            self._presence.cancel()
        session, self._session = self._session, None
        if session is not None:
            await asyncio.to_thread(close_session, session)

    # --- commands

    async def start(self, request: StartRequest, timeout_s: float = 10.0) -> RunResult:
        """Ask for one insertion.

        A stop that comes after this call refuses it, unless `after` names an earlier or later moment. The request is
        valid for a part of `timeout_s`, so that the arm does not move for a caller who has given up.

        Returns:
            The accepted run, or the one that the idempotency key found.

        Raises:
            CellRefusedError: with the cell's reason.
            CellSilentError: no answer in time. The run may have been accepted: ask again with the same idempotency
                key.
        """
        called_at = self._clock()
        if self._status is None or self._heard_at is None:
            self._on_status(await self.status(timeout_s))
        if request.after is None:
            request = request.model_copy(update={"after": self._mark})
        if request.valid_until is None:
            request = request.model_copy(update={"valid_until": self._cell_clock(called_at + VALID_PART * timeout_s)})
        return _unwrap(await self._command(messages.START, request, messages.RUN_ANSWER, timeout_s))

    async def stop(self, request: StopRequest, timeout_s: float = 1.0) -> Status:
        """Stop whatever moves; the answer comes once the stop command has left.

        Raises:
            CellSilentError: no answer in time.
        """
        deadline = time.monotonic() + timeout_s
        envelope = self._enveloped(request)  # without a ticket where there is none: a stop waits for nothing
        answered = await self._ask(messages.STOP, envelope, messages.STATUS_ANSWER, timeout_s)
        if isinstance(answered, Refused):  # somebody else has used its number: no ticket, no doubt
            bare = envelope.model_copy(update={"ticket": None})
            rest_s = max(0.1, deadline - time.monotonic())
            answered = await self._ask(messages.STOP, bare, messages.STATUS_ANSWER, rest_s)
        return self.heed(_unwrap(answered).status)

    async def reset(self, request: ResetRequest, timeout_s: float = 5.0) -> Status:
        """Acknowledge the latched fault; nothing moves.

        Raises:
            CellRefusedError: nothing is latched, another code is in force, force is above the limit, no fresh samples.
            CellSilentError: no answer in time.
        """
        return self.heed(
            _unwrap(await self._command(messages.RESET, request, messages.STATUS_ANSWER, timeout_s)).status
        )

    # --- queries

    async def status(self, timeout_s: float = 1.0) -> Status:
        """Ask for the status now. `last_status` needs no request and is at most a heartbeat old.

        Raises:
            CellSilentError: no answer in time.
        """
        return _unwrap(await self._ask(messages.QUERY_STATUS, None, messages.STATUS_ANSWER, timeout_s)).status

    async def runs(self, request: RunsRequest | None = None, timeout_s: float = 5.0) -> tuple[Run, ...]:
        """Return runs, newest first.

        Raises:
            CellSilentError: no answer in time.
        """
        request = request or RunsRequest()
        return _unwrap(await self._ask(messages.QUERY_RUNS, request, messages.RUNS_ANSWER, timeout_s)).runs

    async def run(self, run_id: str, timeout_s: float = 5.0) -> Run:
        """Return one run.

        Raises:
            CellRefusedError: `UNKNOWN_RUN`.
            CellSilentError: no answer in time.
        """
        request = RunRequest(run_id=run_id)
        return _unwrap(await self._ask(messages.QUERY_RUN, request, messages.RUN_ANSWER, timeout_s)).run

    # --- the order of stops

    @property
    def mark(self) -> StopMark | None:
        """The newest mark in the order of stops that is known here; None before the first."""
        return self._mark

    def heed(self, status: Status) -> Status:
        """Take note of the stops that a status tells of, wherever it was heard; return it."""
        mark = self._mark
        if mark is None or mark.service_epoch != status.service_epoch or mark.stops < status.stops:
            self._mark = status.mark
        return status

    # --- the heartbeat

    @property
    def last_status(self) -> Status | None:
        """The last heartbeat, whatever its age; None before the first."""
        return self._status

    @property
    def heartbeat_age_s(self) -> float:
        """Time since the last heartbeat; infinite before the first."""
        return float("inf") if self._heard_at is None else self._clock() - self._heard_at

    @property
    def is_alive(self) -> bool:
        return self.heartbeat_age_s <= SILENCE_S

    @property
    def state(self) -> CellState:
        """The cell's state at its last heartbeat; UNKNOWN while the cell is silent."""
        if self._status is None or not self.is_alive:
            return CellState.UNKNOWN
        return self._status.state

    # --- subscriptions

    @asynccontextmanager
    async def statuses(self) -> AsyncGenerator[asyncio.Queue[Status]]:
        """Subscribe to heartbeats while the context lasts."""
        async with _subscription(self._status_queues) as queue:
            yield queue

    @asynccontextmanager
    async def events(self) -> AsyncGenerator[asyncio.Queue[Event]]:
        """Subscribe to events. A reader `QUEUE_LENGTH` behind loses the oldest ones, and finds a gap in `seq`."""
        async with _subscription(self._event_queues) as queue:
            yield queue

    @asynccontextmanager
    async def telemetry(self) -> AsyncGenerator[asyncio.Queue[Telemetry]]:
        """Subscribe to telemetry points while the context lasts."""
        async with _subscription(self._telemetry_queues) as queue:
            yield queue

    # --- internals

    async def _say_present(self, session: zenoh.Session) -> None:
        publisher = session.declare_publisher(
            messages.CLIENT.format(cell=self._cell), congestion_control=zenoh.CongestionControl.DROP, express=True
        )
        said_at = self._clock()
        while True:
            if self._clock() - said_at > TICKET_IDLE_S:
                self._ticket = None  # this process was frozen, and the ticket may have been withdrawn
            if self._ticket is None:
                with contextlib.suppress(CellError):
                    await self._draw_ticket(TICKET_S)
            if self._ticket is not None:
                said_at = self._clock()
                publisher.put(self._enveloped(Presence()).model_dump_json().encode())
            await asyncio.sleep(messages.CLIENT_HEARTBEAT_S)

    def _cell_clock(self, time_s: float) -> float:
        """Return the control process's clock at a time of this client's clock, never later than it will show."""
        assert self._status is not None  # noqa: S101 - `start` has heard one
        assert self._heard_at is not None  # noqa: S101
        return self._status.clock_s + time_s - self._heard_at

    async def _draw_ticket(self, timeout_s: float) -> None:
        answer = await self._ask(QUERY_TICKET, TicketRequest(sender=self._sender), TICKET_ANSWER, timeout_s)
        self._ticket = _unwrap(answer)

    def _enveloped(self, request: Message) -> Envelope[Message]:
        self._number += 1
        ticket = None if self._ticket is None else self._ticket.ticket
        return Envelope(
            schema_version=ENVELOPE_VERSION, sender=self._sender, ticket=ticket, number=self._number, request=request
        )

    async def _command(
        self, key: str, request: Message, answer: TypeAdapter[T | Refused], timeout_s: float
    ) -> T | Refused:
        """Send a command under a ticket; a second time if the control process no longer knows the ticket."""
        deadline = time.monotonic() + timeout_s
        if self._ticket is None:
            await self._draw_ticket(timeout_s)
        answered = await self._ask(key, self._enveloped(request), answer, deadline - time.monotonic())
        if not isinstance(answered, Refused) or answered.problem.reason is not RefusalReason.UNKNOWN_SENDER:
            return answered
        await self._draw_ticket(deadline - time.monotonic())
        return await self._ask(key, self._enveloped(request), answer, deadline - time.monotonic())

    def _on_status(self, status: Status) -> None:
        if self._ticket is not None and self._ticket.service_epoch != status.service_epoch:
            self._ticket = None  # of an earlier process
        self._status, self._heard_at = self.heed(status), self._clock()
        _offer(self._status_queues, status)

    def _subscribe(
        self, session: zenoh.Session, key: str, model: type[MessageT], deliver: Callable[[MessageT], None]
    ) -> None:
        loop = asyncio.get_running_loop()
        own = key.format(cell=self._cell)

        def on_sample(sample: zenoh.Sample) -> None:
            if str(sample.key_expr) != own:
                return  # the cell names its keys; a wildcard is somebody else's
            try:
                message = model.model_validate_json(sample.payload.to_bytes())
            except ValidationError:
                return  # a message of another version is no heartbeat, so the cell becomes UNKNOWN
            call_in_loop(loop, deliver, message)

        session.declare_subscriber(own, on_sample)

    async def _ask(self, key: str, request: Message | None, answer: TypeAdapter[T], timeout_s: float) -> T:
        if self._session is None:
            raise RuntimeError("the client is not open: use it as `async with CellClient(...)`")
        request_payload = b"" if request is None else request.model_dump_json().encode()
        answers = await query(self._session, key.format(cell=self._cell), request_payload, timeout_s)
        if not answers:
            raise CellSilentError(
                f"no answer from cell {self._cell} at {', '.join(self._connect)} within {timeout_s} s: "
                f"is the control process up? ({PROGRAM} serve, or {PROGRAM} control)"
            )
        try:
            return answer.validate_json(answers[0])
        except ValidationError as error:
            raise CellError(f"the control process gave an answer that this client cannot read: {error}") from error


def _offer(queues: set[asyncio.Queue[T]], item: T) -> None:
    for queue in queues:
        if queue.full():
            queue.get_nowait()
        queue.put_nowait(item)


@asynccontextmanager
async def _subscription(queues: set[asyncio.Queue[T]]) -> AsyncGenerator[asyncio.Queue[T]]:
    queue: asyncio.Queue[T] = asyncio.Queue(QUEUE_LENGTH)
    queues.add(queue)
    try:
        yield queue
    finally:
        queues.discard(queue)


def _unwrap(answer: T | Refused) -> T:
    if isinstance(answer, Refused):
        raise CellRefusedError(answer.problem)
    return answer
