"""Assembles the HTTP server: routes, errors, protection, and the tasks that live as long as the server."""

import asyncio
import contextlib
import signal
import threading
from collections.abc import AsyncGenerator, Callable, Generator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import structlog
from fastapi import FastAPI
from pydantic.json_schema import models_json_schema

from api import problems
from api.cell import FollowedCell
from api.control_process import JOIN_S, OTHER_S, ControlProcess
from api.history import RunHistory
from api.models import Frame
from api.protection import Protection, is_loopback
from api.receipt import Receipts
from api.routes import commands, page, runs, state, streams
from api.runtime import Runtime
from api.version import VERSION
from service.client import CellClient
from service.config import CellConfig
from service.messages import Event
from service.tasks import end_tasks

DESCRIPTION = """\
Commands and watches one assembly cell.

This is process protection. It is not the robot's emergency stop and replaces none of its certified safety functions.

Units are SI; frames and signs are those of `docs/reference/frames.md`. Every error is an RFC 9457 problem
(`application/problem+json`). There is no authorisation yet: the server accepts requests from this machine only.
"""
TAGS = [
    {"name": "commands", "description": "Start, stop, reset."},
    {"name": "state", "description": "Measured state of the cell; health of the server."},
    {"name": "runs", "description": "History of the runs."},
    {"name": "streams", "description": "Server-sent events."},
]

TASKS_END_S = 1.0
"""Longest wait for the tasks that follow the cell, s."""

_log = structlog.get_logger("api")


def build_routes(lifespan: Callable[[FastAPI], Any] | None = None) -> FastAPI:
    """Return the application without a cell. That suffices for its OpenAPI document."""
    app = FastAPI(
        title="dsl-assembly cell",
        summary="One robot cell that inserts pegs under a dynamic safety lock",
        description=DESCRIPTION,
        version=VERSION,
        openapi_tags=TAGS,
        docs_url=None,  # Swagger's page loads scripts from the internet, which a cell lacks
        redoc_url=None,
        lifespan=lifespan,
    )
    problems.install(app)
    app.add_middleware(Receipts)
    _complete_openapi(app)
    for module in (commands, state, runs, streams, page):
        app.include_router(module.router, responses=problems.described(403, 421))
    app.mount("/page", page.FILES, name="page")
    return app


def _complete_openapi(app: FastAPI) -> None:
    """Add the schemas that FastAPI does not find: those of errors and of the streams' messages."""
    bare = app.openapi

    def complete() -> dict[str, Any]:
        if app.openapi_schema is None:
            schemas = bare()["components"]["schemas"]
            for name in ("HTTPValidationError", "ValidationError"):
                schemas.pop(name, None)
            _, extra = models_json_schema(
                [(model, "serialization") for model in (problems.ProblemDetails, Event, Frame)],
                ref_template="#/components/schemas/{model}",
            )
            for name, schema in extra["$defs"].items():
                schemas.setdefault(name, schema)
        assert app.openapi_schema is not None  # noqa: S101 - FastAPI keeps what `bare` returned
        return app.openapi_schema

    app.openapi = complete


def create_app(config: CellConfig, path: Path) -> Protection:
    """Build the server of one cell.

    Args:
        config: configuration of the cell.
        path: path of the configuration file, passed to a control process that is started.

    Returns:
        The ASGI application.

    Raises:
        ValueError: `api.database` names a database that is not supported, or `api.host` is open to other machines
            without `api.allow_remote`.
    """
    if not (config.api.allow_remote or is_loopback(config.api.host)):
        raise ValueError(
            f"api.host is {config.api.host}: there is no authorisation yet, so listening there needs api.allow_remote"
        )
    database = config.api.database or f"sqlite+aiosqlite:///{config.cell.state_dir / 'runs.sqlite'}"
    RunHistory.check_url(database)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncGenerator[None]:
        cell_id, endpoint, certificates = config.cell.id, [config.cell.endpoint], config.certificates
        client = CellClient(cell_id, endpoint, certificates=certificates)
        stopper = CellClient(cell_id, endpoint, certificates=certificates)
        history = RunHistory(database)
        cell = FollowedCell(client, stopper, history)
        control_process = ControlProcess(config, path)
        closing = asyncio.Event()

        def close_streams() -> None:
            closing.set()
            cell.feed.close()

        tasks: list[asyncio.Task[None]] = []
        with _on_signal(control_process.end_soon, close_streams):
            try:
                may_be_joined = await control_process.may_be_joined()
                if not may_be_joined:
                    control_process.start()  # it starts while this server opens the rest
                await asyncio.gather(history.open(), client.open(), stopper.open())
                app.state.runtime = Runtime(config, cell, control_process, closing)
                tasks += [_spawn(cell.follow()), _spawn(_attend(cell, control_process, may_be_joined=may_be_joined))]
                yield
            finally:  # also where a server that is forced to end cancels this
                close_streams()
                control_process.end_soon()
                for task in await end_tasks(tasks, TASKS_END_S):
                    _log.error("a background task does not end", task=repr(task))
                await control_process.end()
                await asyncio.gather(client.close(), stopper.close())
                await history.close()

    return Protection(build_routes(lifespan), hosts=config.api.allowed_hosts, allow_remote=config.api.allow_remote)


async def _attend(cell: FollowedCell, control_process: ControlProcess, *, may_be_joined: bool) -> None:
    """Join the control process that may be there, or start one; watch the started one."""
    if may_be_joined:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(OTHER_S):
                while not await cell.wait_alive(JOIN_S) and await control_process.is_starting():
                    pass
        if not cell.is_silent:
            control_process.note = None
            _log.info("joined a control process that was there")
            return
        control_process.start()
    await control_process.watch()


def _spawn(work: Any) -> asyncio.Task[None]:
    task: asyncio.Task[None] = asyncio.create_task(work)
    task.add_done_callback(_report_crash)
    return task


def _report_crash(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and (error := task.exception()) is not None:
        _log.critical("a background task crashed", exc_info=error)


def _was_told_to_end(handler: Any) -> bool:
    """Return whether the server whose handler of signals this is had a signal before the application started."""
    return bool(getattr(getattr(handler, "__self__", None), "should_exit", False))


@contextmanager
def _on_signal(at_once: Callable[[], None], soon: Callable[[], None]) -> Generator[None]:
    """Call `at_once` in the handler of a signal that asks the server to end, and `soon` on the event loop.

    uvicorn waits for open responses before it tells the application to end, so an open event stream would block it
    forever. Existing signal handlers are called afterwards.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    loop = asyncio.get_running_loop()
    previous = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    if any(_was_told_to_end(handler) for handler in previous.values()):
        at_once()

    def on_signal(number: int, frame: FrameType | None) -> None:
        at_once()
        loop.call_soon_threadsafe(soon)
        handler = previous[signal.Signals(number)]
        if callable(handler):
            handler(number, frame)

    for number, handler in previous.items():
        if callable(handler):
            signal.signal(number, on_signal)
    try:
        yield
    finally:
        for number, handler in previous.items():
            if callable(handler):
                signal.signal(number, handler)
