"""The control process of one cell: starts driver, cell and control plane, and ends them in the right order."""

import asyncio
import contextlib
import signal
import time
from collections.abc import AsyncGenerator, Callable, Generator, Sequence
from contextlib import ExitStack, asynccontextmanager, contextmanager
from functools import partial

import structlog

from service.cell.cell import Cell
from service.cell.control_plane import ControlPlane
from service.cell.states import WITH_RUN
from service.cell.watch import keep_linked, keep_watch
from service.config import CellConfig
from service.drivers.base import Driver
from service.drivers.watchdog import Watchdog
from service.messages import QUERY_STATUS, STATUS_ANSWER, CellState, EventKind
from service.notify import Notifier
from service.policy import compiled
from service.tasks import end_tasks
from wire.endpoints import EndpointInUseError
from wire.realtime import request_realtime, settle_interpreter
from wire.session import close_session, open_session, query
from wire.tls import Access, is_encrypted

TASKS_END_S = 0.5
"""Longest wait for a task of the cell that was cancelled, s."""
PARTS_S = 5.0
"""Longest time for which the cell waits for its policies and its watchdog before it serves, s."""
POLL_S = 0.01
CONNECT_S = 0.5
ANSWER_S = 1.0
"""Time in which the process that listens at this one's endpoint must be reached, and must say which cell it is, s."""
WATCHDOG_LOST = "the watchdog has ended: a loop that hangs is stopped by the arm alone; restart the control process"
WATCHDOG_DEAF = "the watchdog is not ready, or does not read: a loop that hangs is stopped by the arm alone"

_log = structlog.get_logger("service")


@asynccontextmanager
async def attended(cell: Cell, beats: Sequence[Callable[[], None]] = ()) -> AsyncGenerator[None]:
    """Keep a cell linked and watched while the context lasts; stop and close it at the end.

    Args:
        cell: not linked yet.
        beats: called in every turn of the watch.
    """
    link = asyncio.create_task(keep_linked(cell), name="link")
    watch = asyncio.create_task(keep_watch(cell, beats), name="watch")
    try:
        yield
    finally:
        link.cancel()
        await cell.close()
        for task in await end_tasks([link, watch], TASKS_END_S):
            _log.error("a task of the cell does not end", task=repr(task))
        for task in (link, watch):
            if task.done() and not task.cancelled() and task.exception() is not None:
                _log.error("task of the cell", error=repr(task.exception()))


@contextmanager
def guarded(
    cell: Cell, brake: Sequence[str]
) -> Generator[tuple[Notifier, list[Callable[[], None]], Callable[[], bool]]]:
    """Have the loop watched from outside while the context lasts: by systemd, and in real time by a watchdog.

    Args:
        cell: to guard.
        brake: arguments of the watchdog's brake; without them there is no watchdog.

    Yields:
        The notices to systemd, the beats that the loop owes to both, and whether the watchdog, if any, is ready.

    Raises:
        OSError: no process can be made.
    """
    with ExitStack() as stack:
        notifier = stack.enter_context(Notifier())
        if brake and cell.driver.mode == "real_time":
            watchdog = stack.enter_context(Watchdog(brake, cell.config.limits.sample_age_s))
            yield notifier, [notifier.beat, partial(_quiet, cell, watchdog)], lambda: watchdog.attends
        else:
            yield notifier, [notifier.beat], lambda: True


def _quiet(cell: Cell, watchdog: Watchdog) -> None:
    armed = cell.state in WITH_RUN or cell.state is CellState.STOPPING
    wrong = WATCHDOG_LOST if not watchdog.beat(armed=armed) else None if watchdog.attends else WATCHDOG_DEAF
    others = tuple(line for line in cell.degradations if line not in (WATCHDOG_LOST, WATCHDOG_DEAF))
    if wrong is not None and wrong not in cell.degradations:
        cell.journal.tell(EventKind.WARNING, cell.state, wrong)
    cell.degradations = others if wrong is None else (*others, wrong)


async def run(
    config: CellConfig,
    driver: Driver,
    brake: Sequence[str] = (),
    world_listens: Callable[[], bool] = lambda: True,
    degradations: Sequence[str] = (),
) -> None:
    """Run until SIGTERM, SIGINT or the end of the terminal; stop the arm before returning.

    The caller holds the lock of `alone`.
    Policies and the watchdog load, and clients connect, while a simulator starts. Nothing is served before they are
    there.

    Args:
        config: of the cell.
        driver: of its arm.
        brake: arguments of the watchdog's brake, which stops the arm in real time where the loop does not turn; without
            them there is no watchdog.
        world_listens: whether the driver may connect; raises `OSError` where a simulator will never listen.
        degradations: what this cell lacks, for its status.

    Raises:
        OSError: the endpoint or the state directory cannot be used, or `world_listens` raises it.
    """
    loop = asyncio.get_running_loop()
    ended = asyncio.Event()
    numbers = [signal.SIGTERM, signal.SIGINT]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # as under nohup
        numbers.append(signal.SIGHUP)
    for number in numbers:
        loop.add_signal_handler(number, ended.set)
    cell = Cell(config, driver, time_of_day=time.time)
    cell.degradations = degradations if compiled.step is not None else (*degradations, compiled.describe())
    if driver.mode == "real_time":
        settle_interpreter()  # collecting takes tens of milliseconds, which must not pass at real-time priority
        if config.asks_realtime:
            # Before Zenoh starts its threads: the loop would have to wait for a thread of ordinary priority
            cell.degradations = (*cell.degradations, *request_realtime())
    for line in cell.degradations:
        _log.warning("degraded", what=line)
    try:
        session = await asyncio.to_thread(
            open_session, [config.cell.endpoint], (), config.certificates, _access(config)
        )
    except EndpointInUseError as error:
        await cell.close()
        raise EndpointInUseError(f"{error}{await _who_serves(config)}") from error
    except BaseException:
        await cell.close()
        raise
    try:
        with guarded(cell, brake) as (notifier, beats, is_watched):
            try:
                while not (ended.is_set() or world_listens()):
                    await asyncio.sleep(POLL_S)
                await _await_parts(lambda: ended.is_set() or (cell.policies_settled and is_watched()))
                plane = ControlPlane(cell, session)
            except BaseException:
                await cell.close()
                raise
            if ended.is_set():  # told to end while it started: nothing more is started
                await cell.close()
                return
            async with attended(cell, beats):
                status = asyncio.create_task(plane.publish_status(), name="status")
                _log.info("serving", cell=config.cell.id, endpoint=config.cell.endpoint, state=cell.state.value)
                notifier.send("READY=1")
                await ended.wait()
                _log.info("ending", state=cell.state.value)
                notifier.send("STOPPING=1")
            await end_tasks([status], TASKS_END_S)
    finally:
        await asyncio.to_thread(close_session, session)


async def _await_parts(are_there: Callable[[], bool]) -> None:
    """Wait for what a start needs; for a limited time, because a model may hang."""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(PARTS_S):
            while not are_there():
                await asyncio.sleep(POLL_S)


async def _who_serves(config: CellConfig) -> str:
    """Return the name of the cell whose control process listens at this one's endpoint; empty if none answers."""
    session = await asyncio.to_thread(open_session, (), [config.cell.endpoint], config.certificates)
    try:
        await asyncio.sleep(CONNECT_S)
        answers = await query(session, QUERY_STATUS.format(cell="*"), b"", ANSWER_S)
    finally:
        await asyncio.to_thread(close_session, session)
    if not answers:
        return ""
    status = STATUS_ANSWER.validate_json(answers[0])
    return f": the control process of cell {status.status.cell}" if status.kind == "status" else ""


def _access(config: CellConfig) -> Access | None:
    """Return the rights of the cell's clients; None where the link tells no names."""
    tls = config.tls
    if tls is None or not is_encrypted(config.cell.endpoint):
        return None
    return Access(f"cell/{config.cell.id}", ("query/*",), tls.commanders, tls.readers)
