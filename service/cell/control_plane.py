"""The cell on Zenoh: commands, queries and publications. `service/messages.py` has the keys.

Zenoh's threads decode nothing and touch nothing of the cell: they hand each query to the event loop, with the cell's
mark in the order of stops at its arrival. A stop is carried out in the turn of the loop in which it arrives, even while
other queries wait, and every start that arrived before it is refused.
"""

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any, TypeVar

import structlog
import zenoh
from pydantic import ValidationError

from service import messages
from service.cell.admission import refused
from service.cell.cell import Cell
from service.cell.tick_record import TickRecord
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
    StopRequest,
    Telemetry,
)
from wire.session import call_in_loop

MAX_REQUEST_BYTES = 16_384
KEPT_S = 0.05
"""Longest wait of a stop's answer for its cause to be written, s. The stop itself waits for nothing."""
MAX_OPEN_QUERIES = 64
"""Largest number of requests that wait for their answer; more are refused. A stop is not counted."""

RequestT = TypeVar("RequestT", bound=Message)
Handler = Callable[[zenoh.Query, bytes, StopMark], None]
"""Takes a query, its payload and the cell's mark when it arrived."""

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
        self._stops: set[asyncio.Task[None]] = set()
        self._status = self._publisher(session, messages.STATUS, zenoh.Priority.INTERACTIVE_HIGH)
        self._event = self._publisher(session, messages.EVENT, zenoh.Priority.DATA)
        self._telemetry = self._publisher(session, messages.TELEMETRY, zenoh.Priority.DATA_LOW)
        self._serve(session, messages.STOP, self._on_stop)
        self._serve(session, messages.START, self._answering(StartRequest, self._start))
        self._serve(session, messages.RESET, self._answering(ResetRequest, self._reset))
        self._serve(session, messages.QUERY_STATUS, self._on_status)
        self._serve(session, messages.QUERY_RUNS, self._answering(RunsRequest, self._runs))
        self._serve(session, messages.QUERY_RUN, self._answering(RunRequest, self._run))
        session.declare_subscriber(
            messages.CLIENT.format(cell=self._id), lambda _sample: call_in_loop(self._loop, cell.hear_client)
        )
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

    def _on_stop(self, query: zenoh.Query, payload: bytes, arrived: StopMark) -> None:
        # A request that cannot be read stops, too.
        try:
            request = StopRequest.model_validate_json(payload or b"{}")
        except ValidationError:
            request = StopRequest(reason="the request could not be read")
        answer = self._cell.stop(request)
        self._put(self._status, answer.status)  # its mark reaches every client before the next heartbeat
        self._spawn(self._stops, self._answer_once_kept(query, answer))

    async def _answer_once_kept(self, query: zenoh.Query, answer: StatusResult) -> None:
        """Answer a stop once its cause survives the end of this process, and after `KEPT_S` in any case."""
        await self._cell.journal.latch_is_kept(KEPT_S)
        self._reply(query, answer)

    def _on_status(self, query: zenoh.Query, payload: bytes, arrived: StopMark) -> None:
        self._reply(query, StatusResult(status=self._cell.status()))

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

    def _answering(self, model: type[RequestT], answer: Callable[[RequestT], Awaitable[Message]]) -> Handler:
        def handle(query: zenoh.Query, payload: bytes, arrived: StopMark) -> None:
            if len(self._tasks) >= MAX_OPEN_QUERIES:
                self._reply(query, self._refused(RefusalReason.INTERNAL, "too many requests are waiting: try again"))
                return
            try:
                request = model.model_validate_json(payload or b"{}")
            except ValidationError as error:
                first = error.errors()[0]
                field = ".".join(str(part) for part in first["loc"])
                self._reply(query, self._refused(RefusalReason.INVALID_REQUEST, f"{field}: {first['msg']}", field))
                return
            if isinstance(request, StartRequest) and request.after is None:
                request = request.model_copy(update={"after": arrived})
            self._spawn(self._tasks, self._carry_out(query, answer(request)))

        return handle

    def _spawn(self, tasks: set[asyncio.Task[None]], work: Coroutine[Any, Any, None]) -> None:
        task = self._loop.create_task(work)
        tasks.add(task)
        task.add_done_callback(tasks.discard)

    async def _carry_out(self, query: zenoh.Query, answer: Awaitable[Message]) -> None:
        try:
            message = await answer
        except Exception as error:
            _log.exception("request", key=str(query.key_expr))
            message = self._refused(RefusalReason.INTERNAL, f"{type(error).__name__}: {error}")
        self._reply(query, message)

    # --- the wire

    def _serve(self, session: zenoh.Session, key: str, handle: Handler) -> None:
        def on_query(query: zenoh.Query) -> None:
            payload = b"" if query.payload is None else query.payload.to_bytes()
            payload = payload if len(payload) <= MAX_REQUEST_BYTES else b"too long"
            call_in_loop(self._loop, handle, query, payload, self._cell.mark)

        session.declare_queryable(key.format(cell=self._id), on_query, complete=True)

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

    def _reply(self, query: zenoh.Query, message: Message) -> None:
        with query:
            try:
                query.reply(query.key_expr, message.model_dump_json().encode(), express=True)
            except zenoh.ZError as error:
                _log.warning("reply", key=str(query.key_expr), error=str(error))

    def _refused(self, reason: RefusalReason, detail: str, field: str | None = None) -> Refused:
        return refused(self._cell.state, reason, detail, field)
