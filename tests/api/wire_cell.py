"""A control process on the wire (real Zenoh, real messages) that does what a test tells it, and a server before it."""

import asyncio
import json
import socket
import threading
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import uvicorn
import zenoh

from api.application import create_app
from api.connections import Connection
from api.runtime import Runtime
from service import messages
from service.config import CellConfig, load
from service.envelope import QUERY_TICKET, TicketResult
from service.faults import FaultCode
from service.messages import (
    CellState,
    Event,
    EventKind,
    Latch,
    Measured,
    Message,
    Problem,
    RefusalReason,
    Refused,
    ResetRequest,
    Run,
    RunRequest,
    RunResult,
    RunsRequest,
    RunsResult,
    RunState,
    StartRequest,
    Status,
    StatusResult,
    StopMark,
    StopRequest,
    Telemetry,
)
from wire.session import close_session, open_session

CELL = "cell-test"
RECIPE = "tr-2mm"


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


CONFIG = """
[cell]
id = "{cell}"
endpoint = "tcp/127.0.0.1:{port}"
driver = "zenoh_sim"
state_dir = "var"

[limits]
force_ceiling_n = 30.0
workspace_m = [[0.1, -0.3, 0.0], [0.6, 0.3, 0.5]]

[api]
autostart = {autostart}

[recipes.{recipe}]
part = "tr"
clearance_m = 2.0e-3
policy = "tr.onnx"
start_position_m = [0.3, 0.0, 0.3]
start_yaw_rad = 0.0
nominal_hole_m = [0.4, 0.0, 0.1]
"""


def write_config(folder: Path, port: int, *, autostart: bool = False, cell: str = CELL) -> Path:
    path = folder / "cell.toml"
    path.write_text(CONFIG.format(cell=cell, port=port, recipe=RECIPE, autostart=str(autostart).lower()))
    return path


def standing(*, moving: bool = False) -> Measured:
    return Measured(
        sample_age_s=0.002,
        sample_seq=1,
        force_n=(0.1, 0.2, 0.3),
        torque_nm=(0.0, 0.0, 0.0),
        force_magnitude_n=0.374,
        tcp_position_m=(0.4, 0.0, 0.13),
        tcp_speed_m_s=0.05 if moving else 0.0,
        moving=moving,
        program="ENGAGED" if moving else "IDLE",
        robot_mode=7,
        safety_mode=1,
    )


@dataclass
class WireCell:
    """Answers the control plane of one cell; a test changes its attributes from its own thread.

    Attributes:
        stops: reasons of the stop commands received.
        stopped_by: who asked for them.
        arm_stops: whether a stop brings the arm to a measured standstill.
        moves_after_stop: the first sample after a stop shows the arm moving.
        samples_come: every status has newer samples.
        heartbeat: publish the status at all.
        deaf_to_starts: end start requests without an answer.
        deaf: end every request without an answer.
        hold_starts: leave start requests open.
    """

    endpoint: str
    state: CellState = CellState.READY
    latch: Latch | None = None
    run: Run | None = None
    measured: Measured | None = field(default_factory=standing)
    runs: list[Run] = field(default_factory=list)
    stops: list[str] = field(default_factory=list)
    stopped_by: list[str] = field(default_factory=list)
    resets: list[ResetRequest] = field(default_factory=list)
    refuse_start: Problem | None = None
    arm_stops: bool = True
    moves_after_stop: bool = False
    samples_come: bool = True
    heartbeat: bool = True
    deaf_to_starts: bool = False
    deaf: bool = False
    hold_starts: bool = False
    id: str = CELL
    held: list[zenoh.Query] = field(default_factory=list)
    epoch: str = "e1"
    seq: int = 0
    event_seq: int = 0
    sample_seq: int = 0

    def __enter__(self) -> "WireCell":
        self._lock = threading.RLock()
        self._session = open_session(listen=[self.endpoint])
        self._publishers = {
            name: self._session.declare_publisher(key.format(cell=self.id))
            for name, key in (("status", messages.STATUS), ("event", messages.EVENT), ("telemetry", messages.TELEMETRY))
        }
        answers: dict[str, Callable[[bytes], Message | None]] = {
            messages.STOP: self._stop,
            messages.RESET: self._reset,
            QUERY_TICKET: lambda _payload: TicketResult(ticket="0" * 32, service_epoch=self.epoch),
            messages.QUERY_STATUS: lambda _payload: StatusResult(status=self.status()),
            messages.QUERY_RUNS: self._list,
            messages.QUERY_RUN: self._find,
        }
        for key, answer in answers.items():
            self._session.declare_queryable(key.format(cell=self.id), self._answering(answer))
        self._session.declare_queryable(messages.START.format(cell=self.id), self._on_start)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._beat, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._ended.set()
        self._thread.join()
        self.release()
        close_session(self._session)

    def release(self) -> None:
        """End the start requests that are held, without an answer."""
        while self.held:
            self.held.pop().drop()

    def status(self) -> Status:
        with self._lock:
            self.seq += 1
            self.sample_seq += 25 if self.samples_come else 0
            return Status(
                cell=self.id,
                service_epoch=self.epoch,
                seq=self.seq,
                time=time.time(),
                clock_s=time.monotonic(),
                stops=len(self.stops),
                state=self.state,
                can_start=self.state is CellState.READY,
                why_not=None if self.state is CellState.READY else f"the cell is {self.state}",
                latch=self.latch,
                run=self.run,
                measured=self.measured and self.measured.model_copy(update={"sample_seq": self.sample_seq}),
                driver="zenoh_sim",
                mode="real_time",
                recipes=(RECIPE,),
                force_ceiling_n=30.0,
            )

    def tell(self, kind: EventKind, text: str = "", run_id: str | None = None) -> Event:
        self.event_seq += 1
        event = Event(
            service_epoch=self.epoch,
            seq=self.event_seq,
            time=time.time(),
            kind=kind,
            state=self.state,
            run_id=run_id,
            text=text,
        )
        self._publishers["event"].put(event.model_dump_json())
        return event

    def trace(self, t: float, force_n: float, peak_n: float | None = None) -> None:
        point = Telemetry(
            t=t,
            force_n=(0.0, 0.0, force_n),
            force_magnitude_n=abs(force_n),
            force_peak_n=abs(force_n) if peak_n is None else peak_n,
            tcp_z_m=0.1,
            z_lock_m=0.099,
            depth_m=0.003,
            phase="LOCKED",
            state=self.state,
        )
        self._publishers["telemetry"].put(point.model_dump_json())

    def fault(self, code: FaultCode, text: str = "31.2 N at 30 N") -> None:
        with self._lock:
            self.state, self.measured = CellState.LATCHED, standing()
            self.latch = Latch(code=code, text=text, latched_at=time.time())
            self._end_run(RunState.LATCHED, code)
        self.tell(EventKind.FAULT, text)

    def succeed(self) -> None:
        with self._lock:
            self.state, self.measured = CellState.READY, standing()
            self._end_run(RunState.SUCCEEDED, None)
        self.tell(EventKind.RUN, "ended", self.run.id if self.run else None)

    def _end_run(self, state: RunState, code: FaultCode | None) -> None:
        if self.run is not None and self.run.state is RunState.ACTIVE:
            self.run = self.run.model_copy(
                update={"state": state, "code": code, "ended_at": time.time(), "depth_m": 0.0102, "peak_force_n": 14.8}
            )
            self.runs[-1] = self.run

    def _start(self, payload: bytes) -> Message | None:
        request = StartRequest.model_validate(json.loads(payload)["request"])
        if self.deaf_to_starts:
            return None
        with self._lock:
            for run in self.runs:
                if request.idempotency_key and run.idempotency_key == request.idempotency_key:
                    return RunResult(run=run, created=False)
            if self.refuse_start is not None:
                return Refused(problem=self.refuse_start)
            if request.after is not None and request.after != StopMark(service_epoch=self.epoch, stops=len(self.stops)):
                return self._refused(RefusalReason.STOPPED, "a stop came after the start")
            if self.latch is not None:
                return self._refused(RefusalReason.LATCHED, "reset first", code=self.latch.code)
            if self.state is not CellState.READY:
                return self._refused(RefusalReason.WRONG_STATE, f"the cell is {self.state}")
            run = Run(
                id=f"run-{len(self.runs) + 1}",
                recipe=request.recipe,
                seed=request.seed,
                state=RunState.ACTIVE,
                requested_at=time.time(),
                requested_by=request.requested_by,
                idempotency_key=request.idempotency_key,
            )
            self.runs.append(run)
            self.run, self.state, self.measured = run, CellState.RUNNING, standing(moving=True)
        self.tell(EventKind.RUN, "accepted", run.id)
        return RunResult(run=run, created=True)

    def _stop(self, payload: bytes) -> Message:
        request = StopRequest.model_validate(json.loads(payload)["request"])
        return self.stop(request.reason, request.requested_by)

    def stop(self, reason: str, requested_by: str = "") -> Message:
        with self._lock:
            self.stops.append(reason)
            self.stopped_by.append(requested_by)
            if self.state is CellState.RUNNING:
                self.state = CellState.STOPPING
                if self.arm_stops:
                    self.fault(FaultCode.OPERATOR_STOP, "stopped")
            answer = StatusResult(status=self.status())
            if self.moves_after_stop:
                self.measured = standing(moving=True)
            return answer

    def _reset(self, payload: bytes) -> Message:
        request = ResetRequest.model_validate(json.loads(payload)["request"])
        with self._lock:
            self.resets.append(request)
            if self.latch is None:
                return self._refused(RefusalReason.NOT_LATCHED, "nothing is latched")
            if request.acknowledge not in {None, self.latch.code}:
                return self._refused(RefusalReason.WRONG_STATE, "another fault is in force", code=self.latch.code)
            self.latch, self.state = None, CellState.READY
            return StatusResult(status=self.status())

    def _list(self, payload: bytes) -> Message:
        request = RunsRequest.model_validate_json(payload)
        with self._lock:
            newest_first = list(reversed(self.runs))
            ids = [run.id for run in newest_first]
            first = ids.index(request.before) + 1 if request.before in ids else 0
            return RunsResult(runs=tuple(newest_first[first : first + request.limit]))

    def _find(self, payload: bytes) -> Message:
        request = RunRequest.model_validate_json(payload)
        for run in self.runs:
            if run.id == request.run_id:
                return RunResult(run=run, created=False)
        return self._refused(RefusalReason.UNKNOWN_RUN, f"no run {request.run_id}")

    def _refused(self, reason: RefusalReason, detail: str, code: FaultCode | None = None) -> Refused:
        return Refused(problem=Problem(reason=reason, detail=detail, code=code, state=self.state))

    def _on_start(self, query: zenoh.Query) -> None:
        if self.hold_starts:
            self.held.append(query)
        else:
            self._answering(self._start)(query)

    def _answering(self, answer: Callable[[bytes], Message | None]) -> Callable[[zenoh.Query], None]:
        def on_query(query: zenoh.Query) -> None:
            reply = None if self.deaf else answer(query.payload.to_bytes() if query.payload is not None else b"")
            if reply is not None:
                query.reply(query.key_expr, reply.model_dump_json())
            query.drop()

        return on_query

    def _beat(self) -> None:
        while not self._ended.wait(messages.HEARTBEAT_S):
            if self.heartbeat:
                self._publishers["status"].put(self.status().model_dump_json())


async def until(condition: Callable[[], Any], what: str = "") -> None:
    """Wait for something that must come about; the test's own time limit ends a wait in vain."""
    async with asyncio.timeout(60):
        while not condition():
            await asyncio.sleep(0.01)


@dataclass
class Api:
    """A served API: `http` talks to it, `cell` is the control process behind it."""

    http: httpx.AsyncClient
    server: uvicorn.Server
    config: CellConfig
    port: int

    @property
    def runtime(self) -> Runtime:
        return self.application.state.runtime

    @property
    def application(self) -> Any:
        return self.server.config.app._app

    @property
    def held_events(self) -> list[Event]:
        return list(self.runtime.cell.feed._held)

    @property
    def subscribers(self) -> int:
        return len(self.runtime.cell.feed._subscriptions)

    def close_streams(self) -> None:
        self.runtime.closing.set()
        self.runtime.cell.feed.close()

    async def wait_for_state(self, state: CellState) -> dict[str, Any]:
        async with asyncio.timeout(60):
            while True:
                status = (await self.http.get("/status")).json()
                if status["state"] == state:
                    return status
                await asyncio.sleep(0.02)


@asynccontextmanager
async def serving(path: Path) -> AsyncIterator[Api]:
    """Serve the cell of a configuration file by uvicorn on a free port."""
    config = load(path)
    app = create_app(config, path)
    port = free_port()
    settings = uvicorn.Config(
        app,
        host="127.0.0.1",
        port=port,
        http=Connection,
        ws="none",
        log_config=None,
        lifespan="on",
        timeout_graceful_shutdown=5,
    )
    server = uvicorn.Server(settings)
    task = asyncio.create_task(server.serve())
    await until(lambda: server.started or task.done())
    assert not task.done(), "uvicorn did not start"
    async with httpx.AsyncClient(
        base_url=f"http://127.0.0.1:{port}", trust_env=False, timeout=15, limits=httpx.Limits()
    ) as http:
        try:
            yield Api(http, server, config, port)
        finally:
            server.should_exit = True
            await task
