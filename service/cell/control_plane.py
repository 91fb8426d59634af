"""The cell on Zenoh: commands, queries and publications. `service/messages.py` has the keys.

Zenoh's threads decode nothing and touch nothing of the cell: they hand each query to the event loop, with the cell's
mark in the order of stops at its arrival. A stop is carried out in the turn of the loop in which it arrives, even while
other queries wait, and every start that arrived before it is refused.
"""

import asyncio
import threading
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import TypeVar

import structlog
import zenoh

from service import messages
from service.cell.admission import refused
from service.cell.answers import Answers
from service.cell.cell import Cell
from service.cell.reception import NotACommandError, Reception, read
from service.cell.tick_record import TickRecord
from service.envelope import QUERY_TICKET, TicketRequest, TicketResult
from service.messages import (
    Event,
    Message,
    RefusalReason,
    Refused,
    ResetRequest,
    RunRequest,
    RunResult,
    RunsRequest,
    RunsResult,
    StartRequest,
    StatusResult,
    StopMark,
    Telemetry,
)
from wire.session import call_in_loop

MAX_REQUEST_BYTES = 16_384
KEPT_S = 0.05
"""Longest wait of a stop's answer for its cause to be written, s. The stop itself waits for nothing."""
MAX_OPEN_QUERIES = 64
"""Largest number of requests that wait for their answer; more are refused. A stop is not counted."""

MAX_BACKLOG = 256
"""Largest number of messages of one key that wait for the loop: more are refused before they reach it."""

RequestT = TypeVar("RequestT", bound=Message)
CommandT = TypeVar("CommandT", StartRequest, ResetRequest)


@dataclass(frozen=True, slots=True)
class Asked:
    """One query.

    Attributes:
        query: to reply to.
        key: under which it is served; the query itself may name a wildcard.
        payload: the request.
        arrived: the cell's mark in the order of stops when it arrived.
    """

    query: zenoh.Query
    key: str
    payload: bytes
    arrived: StopMark

    @property
    def named(self) -> str:
        """The key expression that the query names."""
        return str(self.query.key_expr)

    @property
    def may_command(self) -> bool:
        """True if it names its own key and is not empty."""
        return self.named == self.key and bool(self.payload)


Handler = Callable[[Asked], None]

_log = structlog.get_logger("service.control_plane")


class ControlPlane:
    """Serves one cell. Made and used on the cell's event loop.

    Args:
        cell: the cell to serve; this becomes one of its observers.
        session: open. The caller closes it, which ends the service.
    """

    def __init__(self, cell: Cell, session: zenoh.Session) -> None:
        self._cell = cell
        self._id = cell.config.cell.id
        self._loop = asyncio.get_running_loop()
        self._tasks: set[asyncio.Task[None]] = set()
        self._answers = Answers()
        self._stop_key = messages.STOP.format(cell=self._id)
        self._reception = Reception(cell.on_notice)
        self._status = self._publisher(session, messages.STATUS, zenoh.Priority.INTERACTIVE_HIGH)
        self._event = self._publisher(session, messages.EVENT, zenoh.Priority.DATA)
        self._telemetry = self._publisher(session, messages.TELEMETRY, zenoh.Priority.DATA_LOW)
        self._serve(session, messages.STOP, self._on_stop)
        self._serve(session, messages.START, self._commanded(StartRequest, self._start))
        self._serve(session, messages.RESET, self._commanded(ResetRequest, self._reset))
        self._serve(session, QUERY_TICKET, self._answering(TicketRequest, self._ticket))
        self._serve(session, messages.QUERY_STATUS, self._on_status)
        self._serve(session, messages.QUERY_RUNS, self._answering(RunsRequest, self._runs))
        self._serve(session, messages.QUERY_RUN, self._answering(RunRequest, self._run))
        self._hear(session, messages.CLIENT)
        cell.journal.observers.append(self)

    async def publish_status(self) -> None:
        """Publish the heartbeat until cancelled."""
        while True:
            try:
                self._put(self._status, self._cell.status())
            except Exception:
                _log.exception("status")  # go on: without a heartbeat, clients take the cell for dead
            await asyncio.sleep(messages.HEARTBEAT_S)

    # --- as the cell's observer

    def on_event(self, event: Event) -> None:
        """Publish an event, and the status with it: a change is seen before the next heartbeat."""
        self._put(self._event, event)
        self._put(self._status, self._cell.status())

    def on_telemetry(self, point: Telemetry) -> None:
        """Publish one point."""
        self._put(self._telemetry, point)

    def on_tick(self, record: TickRecord) -> None:
        """Publish nothing: telemetry carries what is shown of a step."""

    # --- requests

    def _on_stop(self, asked: Asked) -> None:
        try:
            request = self._reception.stop(asked.named, asked.key, asked.payload)
        except NotACommandError as error:
            self._reply(asked, self._refused(error.reason, str(error), error.field))
            return
        answer = self._cell.stop(request)
        self._put(self._status, answer.status)  # its mark reaches every client before the next heartbeat
        self._reply_once_kept(asked, answer)

    def _reply_once_kept(self, asked: Asked, answer: StatusResult) -> None:
        """Answer a stop once its cause survives the end of this process, and after `KEPT_S` in any case.

        The thread that wrote the cause answers, so that the answer does not wait for its turn in the loop.
        """
        token = threading.Lock()

        def reply(*_: object) -> None:
            if token.acquire(blocking=False):
                self._reply(asked, answer)

        if (kept := self._cell.journal.latch_kept) is None:
            reply()
        else:
            kept.add_done_callback(reply)
            self._loop.call_later(KEPT_S, reply)

    def _on_status(self, asked: Asked) -> None:
        self._reply(asked, StatusResult(status=self._cell.status()))

    async def _ticket(self, request: TicketRequest) -> Message:
        ticket = self._reception.draw_ticket(request)
        return TicketResult(ticket=ticket, service_epoch=self._cell.journal.epoch)

    async def _start(self, request: StartRequest) -> Message:
        return await self._cell.start(request)

    async def _reset(self, request: ResetRequest) -> Message:
        return await self._cell.reset(request)

    async def _runs(self, request: RunsRequest) -> Message:
        return RunsResult(runs=self._cell.journal.newest(request.limit, request.before))

    async def _run(self, request: RunRequest) -> Message:
        run = self._cell.runs.find(request.run_id)
        if run is None:
            return self._refused(RefusalReason.UNKNOWN_RUN, f"no run {request.run_id!r}", "run_id")
        return RunResult(run=run, created=False)

    def _commanded(self, model: type[CommandT], answer: Callable[[CommandT], Awaitable[Message]]) -> Handler:
        return self._reading(
            lambda asked: self._reception.command(asked.named, asked.key, asked.payload, model), answer
        )

    def _answering(self, model: type[RequestT], answer: Callable[[RequestT], Awaitable[Message]]) -> Handler:
        return self._reading(lambda asked: read(asked.payload or b"{}", model), answer)

    def _reading(
        self, read_request: Callable[[Asked], RequestT], answer: Callable[[RequestT], Awaitable[Message]]
    ) -> Handler:
        def handle(asked: Asked) -> None:
            if len(self._tasks) >= MAX_OPEN_QUERIES:
                self._refuse_for_load(asked)
                return
            try:
                request = read_request(asked)
            except NotACommandError as error:
                self._reply(asked, self._refused(error.reason, str(error), error.field))
                return
            if isinstance(request, StartRequest) and request.after is None:
                request = request.model_copy(update={"after": asked.arrived})
            task = self._loop.create_task(self._carry_out(asked, answer(request)))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

        return handle

    async def _carry_out(self, asked: Asked, answer: Awaitable[Message]) -> None:
        try:
            message = await answer
        except NotACommandError as error:
            message = self._refused(error.reason, str(error), error.field)
        except Exception as error:
            _log.exception("request", key=asked.key)
            message = self._refused(RefusalReason.INTERNAL, f"{type(error).__name__}: {error}")
        self._reply(asked, message)

    # --- the wire

    def _serve(self, session: zenoh.Session, key: str, handle: Handler) -> None:
        own = key.format(cell=self._id)
        room = threading.Semaphore(MAX_BACKLOG)

        def in_loop(asked: Asked) -> None:
            room.release()
            handle(asked)

        def on_query(query: zenoh.Query) -> None:
            payload = b"" if query.payload is None else query.payload.to_bytes()
            payload = payload if len(payload) <= MAX_REQUEST_BYTES else b"too long"
            asked = Asked(query, own, payload, self._cell.mark)
            if room.acquire(blocking=False):
                call_in_loop(self._loop, in_loop, asked)
            elif key == messages.STOP and asked.may_command:  # a flood of others keeps no stop out
                call_in_loop(self._loop, handle, asked)
            else:
                self._refuse_for_load(asked)

        session.declare_queryable(own, on_query, complete=True)

    def _hear(self, session: zenoh.Session, key: str) -> None:
        own = key.format(cell=self._id)
        room = threading.Semaphore(MAX_BACKLOG)

        def in_loop(heard: str, payload: bytes) -> None:
            room.release()
            if self._reception.presence(heard, own, payload):
                self._cell.hear_client()

        def on_sample(sample: zenoh.Sample) -> None:
            payload = sample.payload.to_bytes()
            if len(payload) <= MAX_REQUEST_BYTES and room.acquire(blocking=False):
                call_in_loop(self._loop, in_loop, str(sample.key_expr), payload)

        session.declare_subscriber(own, on_sample)

    def _publisher(self, session: zenoh.Session, key: str, priority: zenoh.Priority) -> zenoh.Publisher:
        return session.declare_publisher(
            key.format(cell=self._id),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=priority,
            express=True,
        )

    def _put(self, publisher: zenoh.Publisher, message: Message) -> None:
        try:
            publisher.put(message.model_dump_json().encode())
        except zenoh.ZError:
            self._cell.telemetry_dropped += 1

    def _reply(self, asked: Asked, message: Message) -> None:
        self._answers.send(asked.query, asked.key, message, always=asked.key == self._stop_key)

    def _refuse_for_load(self, asked: Asked) -> None:
        self._reply(asked, self._refused(RefusalReason.INTERNAL, "too many requests are waiting: try again"))

    def _refused(self, reason: RefusalReason, detail: str, field: str | None = None) -> Refused:
        return refused(self._cell.state, reason, detail, field)
