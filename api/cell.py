"""The API's view of one cell: its last heartbeat, its events, and its runs on their way into the history."""

import asyncio
import time
from collections.abc import Callable

import structlog
from pydantic import ValidationError

from api.feed import EventFeed
from api.history import HistoryError, RunHistory
from api.receipt import Receipt
from service.client import SILENCE_S, CellClient, CellError, CellRefusedError
from service.faults import FaultCode
from service.marks import FirstMarks
from service.messages import CellState, Event, EventKind, Run, RunsRequest, RunState, Status

_log = structlog.get_logger("api.cell")

WATCH_S = 0.1
LEDGER_PAGE = 200
TURN_S = 0.02
FROZEN_S = 0.2
"""Lateness of the event loop at which requests may have waited unread, s."""
DOUBT_S = 0.2
"""Time after such a freeze in which they are read, s."""
UNKNOWN_TEXT = "the cell's ledger does not have this run any more: how it ended is not known"


class FollowedCell:
    """Follows the control process and keeps the history in step with its ledger.

    Args:
        client: client for everything but a stop.
        stopper: client for stops. It has a session of its own, so that a stop queues behind nothing.
        history: history that runs are recorded in.
        clock: monotonic clock, s.

    Attributes:
        feed: events of the cell.
        first_marks: marks of the starts that this server was asked for.
        failure: why events and history are not followed any more; None while they are.
        stops_asked: stops that this server was asked for, delivered or not.
    """

    def __init__(
        self,
        client: CellClient,
        stopper: CellClient,
        history: RunHistory,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.client = client
        self.stopper = stopper
        self.history = history
        self.feed = EventFeed()
        self.first_marks = FirstMarks()
        history.on_renewed = lambda: self._reconcile.set()
        self.failure: str | None = None
        self.stops_asked = 0
        self._clock = clock
        self._turned_at, self._turned_mark = clock(), client.mark
        self._doubted_until, self._doubted_mark = clock(), client.mark
        self._last_state = CellState.UNKNOWN
        self._reconcile = asyncio.Event()

    @property
    def is_silent(self) -> bool:
        return not self.client.is_alive

    @property
    def last_status(self) -> Status | None:
        return self.client.last_status

    async def follow(self) -> None:
        """Run until cancelled. An internal error ends it and is kept in `failure`; status and stop still work."""
        try:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._follow_statuses())
                tasks.create_task(self._follow_events(tasks))
                tasks.create_task(self._watch_state())
                tasks.create_task(self._watch_loop())
                tasks.create_task(self._reconcile_forever())
                tasks.create_task(self.history.write_forever())
        except ExceptionGroup as error:
            self.failure = f"events and history are no longer followed: {error.exceptions[0]!r}; restart this server"
            raise

    def receive(self) -> Receipt:
        """Return the place in the order of stops of a request that is read now.

        A request that is read after a freeze of this server may be as old as the freeze. It gets the place from before.
        """
        now = self._clock()
        if now - self._turned_at > FROZEN_S:
            mark = self._turned_mark
        elif now < self._doubted_until:
            mark = self._doubted_mark
        else:
            mark = self.client.mark
        return Receipt(mark, self.stops_asked)

    async def wait_alive(self, timeout_s: float) -> bool:
        """Wait up to `timeout_s` for a heartbeat; return whether one arrived."""
        deadline = self._clock() + timeout_s
        while self.is_silent and self._clock() < deadline:
            await asyncio.sleep(0.02)
        return not self.is_silent

    def current(self, run: Run) -> Run:
        """Return the newer of `run` and the same run in the last heartbeat."""
        status = self.last_status
        live = status.run if status is not None else None
        return live if live is not None and live.id == run.id and run.state is RunState.ACTIVE else run

    async def _follow_statuses(self) -> None:
        epoch: str | None = None
        known: tuple[str, RunState] | None = None
        async with self.client.statuses() as statuses:
            while True:
                status = await statuses.get()
                if status.service_epoch != epoch:
                    epoch = status.service_epoch
                    self._reconcile.set()
                run = status.run
                if run is not None and (run.id, run.state) != known:
                    known = run.id, run.state
                    self.history.put(run)
                self._note_state(status.state)

    async def _follow_events(self, tasks: asyncio.TaskGroup) -> None:
        last: Event | None = None
        async with self.client.events() as events:
            while True:
                event = await events.get()
                if last is not None and (event.service_epoch, event.seq) != (last.service_epoch, last.seq + 1):
                    self._reconcile.set()
                last = event
                self.feed.publish(event)
                if event.kind is EventKind.RUN and event.run_id is not None:
                    tasks.create_task(self._fetch(event.run_id))

    async def _fetch(self, run_id: str) -> None:
        try:
            self.history.put(await self.client.run(run_id))
        except (CellError, ValidationError):
            self._reconcile.set()

    async def _watch_state(self) -> None:
        silent = True
        while True:
            await asyncio.sleep(WATCH_S)
            if silent and not self.is_silent:
                self._reconcile.set()
            silent = self.is_silent
            self._note_state(self.client.state)

    async def _watch_loop(self) -> None:
        while True:
            self._turned_at, self._turned_mark = self._clock(), self.client.mark
            await asyncio.sleep(TURN_S)
            now = self._clock()
            if now - self._turned_at > FROZEN_S:
                self._doubted_until, self._doubted_mark = now + DOUBT_S, self._turned_mark

    def _note_state(self, state: CellState) -> None:
        if state is not self._last_state:
            _log.info("state", state=state.value, before=self._last_state.value)
            self._last_state = state
            self.feed.nudge()

    async def _reconcile_forever(self) -> None:
        """Read missed runs from the ledger: at the start, after a silence, after a lost event."""
        while True:
            await self._reconcile.wait()
            self._reconcile.clear()
            try:
                await self._read_ledger()
            except (CellError, HistoryError, ValidationError) as error:
                _log.warning("reconcile", error=str(error))
                await asyncio.sleep(SILENCE_S)
                self._reconcile.set()

    async def _read_ledger(self) -> None:
        await self._read_pages()
        for run in await self.history.active():
            await self.history.record([await self._as_it_ended(run)])

    async def _as_it_ended(self, run: Run) -> Run:
        """Return a run that the history takes for active as the ledger has it."""
        try:
            return await self.client.run(run.id)
        except CellRefusedError:
            changes = {"state": RunState.INTERRUPTED, "code": FaultCode.INTERRUPTED, "text": UNKNOWN_TEXT}
            return run.model_copy(update=changes)

    async def _read_pages(self) -> None:
        before: str | None = None
        seen: set[str] = set()
        while True:
            page = await self.client.runs(RunsRequest(limit=LEDGER_PAGE, before=before))
            fresh = [run for run in page if run.id not in seen]
            seen.update(run.id for run in page)
            changed = [run for run in fresh if await self.history.find(run.id) != run]
            if changed:
                await self.history.record(changed)
            if len(page) < LEDGER_PAGE or not changed:
                return
            before = page[-1].id
