"""A whole installation in one process on a virtual clock: world, control process, API and the people who use it."""

import asyncio
import contextlib
import gc
import json
import logging
import random
import sys
import warnings
from collections.abc import Callable, Coroutine, Generator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import api.control_process
from api.application import create_app
from service.cell import process as control_process
from service.cell.cell import Cell
from service.cell.journal.ledger import Ledger
from service.config import CellConfig
from service.drivers.zenoh_sim import ZenohSimDriver
from sim_backend.zenoh_cell.server import Pace, Server
from tests.simulation.child import started_by
from tests.simulation.clock import Process, Thread, VirtualLoop
from tests.simulation.disk import Disk
from tests.simulation.logs import LogTarget
from tests.simulation.network import Network
from tests.simulation.plant import START, LightCell
from tests.simulation.stranger import Stranger
from tests.simulation.substitutes import Host, changes, substituted
from wire.limits import WORKSPACE_M
from wire.records import Program

CELL = "cell-1"
WORLD = "world-1"
CELL_ENDPOINT = "tcp/127.0.0.1:7447"
WORLD_ENDPOINT = "tcp/127.0.0.1:7448"
RECIPE = "triangle"
DOZED_TICKS = 7
NOMINAL_HOLE = (0.300, -0.110, 0.080)


def configuration(state_dir: Path, policy: Path, *, autostart: bool = False, **recipe: Any) -> CellConfig:
    """The configuration of the cell under test: one recipe with a short way.

    Args:
        state_dir: of the cell.
        policy: ONNX file.
        autostart: the API starts the control process.
        recipe: fields of the recipe that differ.
    """
    fields = {
        "part": "tr",
        "clearance_m": 2.0e-3,
        "policy": policy,
        "start_position_m": START,
        "start_yaw_rad": 0.0,
        "nominal_hole_m": NOMINAL_HOLE,
        "hover_m": 0.01,
    }
    return CellConfig.model_validate(
        {
            "cell": {"id": CELL, "endpoint": CELL_ENDPOINT, "state_dir": state_dir},
            "limits": {"force_ceiling_n": 30.0, "workspace_m": WORKSPACE_M},
            "preflight": {"window_samples": 40},
            "sim": {"world": WORLD, "endpoint": WORLD_ENDPOINT},
            "api": {"autostart": autostart},
            "recipes": {RECIPE: fields | recipe},
        }
    )


@dataclass
class Answer:
    """One request over HTTP and what came back.

    Attributes:
        status: None where the client gave up or the connection broke.
        gave_up: the client had waited for as long as it would.
    """

    kind: str
    name: str
    body: dict[str, Any] | None
    sent_s: float
    received_s: float | None = None
    status: int | None = None
    document: Any = None
    gave_up: bool = False


@dataclass
class Universe:
    """Everything of one seed.

    Attributes:
        judge: called after each tick of the world.
        answers: every request, in the order of sending.
        set_aside: the ledger's lines that somebody took away.
        starts: what started a control process, and when.
        told_to_end: processes that got SIGTERM, and when.
        trace: what happened when; the same seed gives the same trace.
    """

    seed: int
    config: CellConfig
    plant: LightCell
    judge: Callable[[], None] = lambda: None
    answers: list[Answer] = field(default_factory=list)
    trace: list[tuple[float, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        chance = random.Random(self.seed * 7919 + 1)
        self.loop = VirtualLoop(random.Random(self.seed * 7919 + 2))
        self.network = Network(self.loop, random.Random(self.seed * 7919 + 3))
        self.state_dir = self.config.cell.state_dir
        self.disk = Disk(self.state_dir, random.Random(self.seed * 7919 + 4))
        self.host = Host(self.loop, self.network, self.disk, chance, LogTarget(self.loop, self.note))
        self.processes: dict[str, Process] = {}
        self.operator = Process(self.loop, "operator")
        self.cell: Cell | None = None
        self.set_aside = b""
        self.starts: list[tuple[Process, float]] = []
        self.told_to_end: dict[Process, float] = {}
        self._stranger: Stranger | None = None
        self._ledgers: list[Ledger] = []
        self._app: Any = None
        self._connections: set[Connection] = set()

    @property
    def dozed_ticks(self) -> int:
        """Ticks that the world leaves out of what it tells: while nothing drives the arm, seven of eight."""
        undisturbed = self.plant.program is Program.IDLE and (self.cell is None or self.cell.runs.active is None)
        return DOZED_TICKS if undisturbed else 0

    def note(self, text: str) -> None:
        """Add a line to the trace."""
        self.trace.append((round(self.loop.time(), 6), text))

    # --- life

    @contextlib.contextmanager
    def alive(self) -> Generator[None]:
        """Let everything start, and take it apart at the end of the context."""
        children = [(api.control_process, "Child", started_by(self))]
        with substituted([*changes(self.host, lambda: self.dozed_ticks), *children]):
            self.host.log.configure()
            self.loop.set_exception_handler(self._on_loop_error)
            try:
                self.start_world()
                if self.config.api.autostart:
                    self.processes["control"] = Process(self.loop, "nobody")
                    self.processes["control"].alive = False
                else:
                    self.start_control()
                self.start_api()
                yield
            finally:
                with _unheard():
                    self._end()

    def live(self, work: Coroutine[Any, Any, Any]) -> None:
        """Let time pass until this has been done outside."""
        self.loop.run_until_complete(self.operator.spawn(work, "script"))

    def start_world(self) -> None:
        process = self.processes["world"] = Process(self.loop, "world")
        cell = Watched(self.plant, self)

        def serve() -> None:
            session = self.network.open(listen=[WORLD_ENDPOINT])
            Server(cell, session, WORLD, Pace.REAL_TIME).run()  # type: ignore[arg-type]

        process.main.context.copy().run(lambda: self._in_loop(Thread(target=serve, name="server").start))

    def start_control(self) -> None:
        process = self.processes["control"] = Process(self.loop, "control")

        async def serve() -> None:
            driver = ZenohSimDriver(WORLD, [WORLD_ENDPOINT], "real_time", clock=self.host.monotonic)
            kept = control_process.Cell

            def make(*args: Any, **kwargs: Any) -> Cell:
                self.cell = cell = kept(*args, **kwargs)
                self._ledgers.append(cell.journal._ledger)
                return cell

            control_process.Cell = make  # type: ignore[misc,assignment]
            try:
                running = asyncio.ensure_future(control_process.run(self.config, driver))
                await asyncio.sleep(0)
            finally:
                control_process.Cell = kept  # type: ignore[misc]
            await running

        process.spawn(self._ended(process, serve()), "run")

    def start_api(self) -> None:
        process = self.processes["api"] = Process(self.loop, "api")
        process.spawn(self._ended(process, self._serve_api(process)), "serve")

    def kill(self, name: str) -> None:
        self.note(f"kill {name}")
        process = self.processes[name]
        process.kill()
        if name == "control":
            self.cell = None
        if name == "api":
            self._break_off()

    def terminate(self, name: str) -> None:
        """Send SIGTERM to a process; the world's program, which would obey, is left out."""
        process = self.processes[name]
        if 15 in process.signal_handlers:
            self.told_to_end.setdefault(process, self.loop.time())
        process.signal(15)

    @property
    def stranger(self) -> Stranger:
        """Somebody who reaches cell and world without any business there."""
        if self._stranger is None:
            self._stranger = Stranger(self.network, CELL, WORLD, frozenset((CELL_ENDPOINT, WORLD_ENDPOINT)))
        return self._stranger

    # --- HTTP

    async def request(
        self, method: str, path: str, body: dict[str, Any] | None = None, *, kind: str = "", name: str = "",
        headers: dict[str, str] | None = None, timeout_s: float = 5.0,
    ) -> Answer:  # fmt: skip
        """Send one request as a client outside does, and wait for its answer."""
        answer = Answer(kind or path, name, body, self.loop.time())
        self.answers.append(answer)
        connection = Connection(self, method, path, body, headers or {})
        self._connections.add(connection)
        try:
            async with asyncio.timeout(timeout_s):
                status, content = await connection.send()
            answer.status = status
            answer.document = json.loads(content) if content else None
            answer.received_s = self.loop.time()
        except (TimeoutError, ConnectionError) as error:
            connection.left = True
            answer.gave_up = isinstance(error, TimeoutError)
        finally:
            self._connections.discard(connection)
        said = "nothing" if answer.status is None else f"{answer.status} {_told(answer.document)}"
        self.note(f"{method} {path} {name}: sent {answer.sent_s:.6f}, {said}")
        return answer

    # --- small parts

    def _in_loop(self, call: Callable[[], None]) -> None:
        running = asyncio._get_running_loop()
        asyncio._set_running_loop(self.loop)
        try:
            call()
        finally:
            asyncio._set_running_loop(running)

    async def _ended(self, process: Process, work: Any) -> None:
        name = process.name
        try:
            await work
        except Exception as error:
            self.note(f"{name} ended: {type(error).__name__}: {error}")
        else:
            self.note(f"{name} ended")
        await process.await_executor()
        process.alive = False

    async def _serve_api(self, process: Process) -> None:
        app = create_app(self.config, Path("cell.toml"))
        inbox: asyncio.Queue[dict[str, str]] = asyncio.Queue()
        started = asyncio.Event()

        async def send(message: Any) -> None:
            if message["type"] == "lifespan.startup.complete":
                started.set()

        process.signal_handlers[15] = lambda *_: inbox.put_nowait({"type": "lifespan.shutdown"})
        inbox.put_nowait({"type": "lifespan.startup"})
        life = asyncio.ensure_future(app({"type": "lifespan", "asgi": {"version": "3.0"}}, inbox.get, send))
        await started.wait()
        self._app = app
        self.note("api serves")
        await life
        self._break_off()

    def _break_off(self) -> None:
        """Close the connections of an API that has ended, as the host does."""
        self._app = None
        for connection in list(self._connections):
            connection.break_off()

    def _on_loop_error(self, _loop: Any, context: dict[str, Any]) -> None:
        self.note(f"loop error: {context.get('message')} {context.get('exception')!r}")

    def _end(self) -> None:
        """Take everything apart without running it on."""
        for thread in list(self.loop.threads):
            with contextlib.suppress(Exception):
                thread.end()
        self.loop.threads.clear()
        for process in (*self.processes.values(), self.operator):
            process.alive = False
        for file in (file for ledger in self._ledgers for file in ledger._outlived):
            file.close()  # a process that hangs may hold it for ever
        self._ledgers.clear()
        for database in self.host.databases:
            if database._connection is not None:
                database._connection.close()
        for task in asyncio.all_tasks(self.loop):
            _give_up(task)
        task = None  # it would keep the universe alive
        self.loop.forget()
        self.network.sessions.clear()
        self.processes.clear()
        self.told_to_end.clear()
        self.starts.clear()
        self._stranger = None
        self.host.log.forget()
        self.operator = Process(self.loop, "nobody")
        self.cell = self._app = None
        gc.collect()


@contextlib.contextmanager
def _unheard() -> Generator[None]:
    """Let nobody hear of what a killed process left open."""
    hook, sys.unraisablehook = sys.unraisablehook, lambda _: None
    disabled = logging.root.manager.disable
    logging.disable()  # a logged traceback would keep a universe alive
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(disabled)
        sys.unraisablehook = hook


def _give_up(task: Any) -> None:
    task._log_destroy_pending = False
    with contextlib.suppress(BaseException):
        task.get_coro().close()


class Watched:
    """The plant as the world's server drives it; after each tick the judge looks at it."""

    def __init__(self, plant: LightCell, universe: Universe) -> None:
        self._plant, self._universe = plant, universe

    def __getattr__(self, name: str) -> Any:
        return getattr(self._plant, name)

    def tick(self, ticks: int = 1) -> Any:
        for _ in range(self._universe.dozed_ticks):
            self._plant.pass_tick()
        record = self._plant.tick(ticks)
        self._universe.judge()
        return record


class Connection:
    """One connection from a client to the API, with one request."""

    def __init__(self, universe: Universe, method: str, path: str, body: Any, headers: dict[str, str]) -> None:
        self._universe = universe
        self._scope_parts = (method, *path.partition("?")[::2])
        self._body = b"" if body is None else json.dumps(body).encode()
        self._headers = {"host": "127.0.0.1:8000", "content-type": "application/json"} | headers
        self.left = False
        self._result: asyncio.Future[tuple[int, bytes]] = asyncio.get_running_loop().create_future()

    def send(self) -> "asyncio.Future[tuple[int, bytes]]":
        universe = self._universe
        api = universe.processes["api"]
        if not api.alive or universe._app is None:
            self.break_off()
        else:
            universe.network.carry(universe.operator, api.main, False, self._serve)
        return self._result

    def break_off(self) -> None:
        if not self._result.done():
            self._result.set_exception(ConnectionResetError())

    def _serve(self) -> None:
        if self._universe._app is None:
            self._answer_with(None)
            return
        self._universe.processes["api"].spawn(self._call(self._universe._app), "request")

    async def _call(self, app: Any) -> None:
        method, path, query = self._scope_parts
        scope = {
            "type": "http", "asgi": {"version": "3.0", "spec_version": "2.3"}, "http_version": "1.1", "method": method,
            "scheme": "http", "path": path, "raw_path": path.encode(), "query_string": query.encode(), "root_path": "",
            "headers": [(name.encode(), value.encode()) for name, value in self._headers.items()],
            "client": ("127.0.0.1", 40000), "server": ("127.0.0.1", 8000), "state": {},
        }  # fmt: skip
        sent, status, content = False, 0, b""

        async def receive() -> dict[str, Any]:
            nonlocal sent
            if sent:
                while not self.left:
                    await asyncio.sleep(0.1)
                return {"type": "http.disconnect"}
            sent = True
            return {"type": "http.request", "body": self._body, "more_body": False}

        async def send(message: Any) -> None:
            nonlocal status, content
            if message["type"] == "http.response.start":
                status = message["status"]
            elif message["type"] == "http.response.body":
                content += message.get("body", b"")
                if not message.get("more_body"):
                    self._answer_with((status, content))

        try:
            await app(scope, receive, send)
        except Exception as error:
            self._universe.note(f"api raised {type(error).__name__}: {error}")
            self._answer_with((500, b""))

    def _answer_with(self, result: tuple[int, bytes] | None) -> None:
        universe = self._universe
        source = universe.processes["api"]
        universe.network.carry(source, universe.operator.main, False, self._arrive, result)

    def _arrive(self, result: tuple[int, bytes] | None) -> None:
        if self._result.done():
            return
        if result is None:
            self.break_off()
        else:
            self._result.set_result(result)


def _told(document: Any) -> str:
    if not isinstance(document, dict):
        return ""
    parts = (document.get(key) for key in ("id", "state", "confirmed", "reason", "code"))
    return " ".join(str(part) for part in parts if part is not None)
