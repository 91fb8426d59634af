"""Puts the virtual clock, network and disk under the real code while a universe lasts: every seam stands here."""

import os
import random
import secrets
import sys
import threading
import time
import uuid
from collections.abc import Callable, Generator
from contextlib import contextmanager
from functools import lru_cache, partial
from types import FunctionType, SimpleNamespace
from typing import Any

import aiosqlite.core
import fastapi.dependencies.utils
import fastapi.routing
import structlog

import api.application
import api.control_process
import service.cell.answers
import service.cell.cell
import service.cell.journal.storage
import service.cell.process
import service.client
import service.drivers.zenoh_sim
import service.logs
import sim_backend.zenoh_cell.server
from service.cell.inference import InlineInference
from sim_backend.metronome import Metronome
from tests.simulation import clock, threads
from tests.simulation.disk import Disk
from tests.simulation.held_policy import Held
from tests.simulation.logs import LogTarget
from tests.simulation.network import Network, close_session

Change = tuple[Any, str, Any]
WALL_S = 1.79e9


class Host:
    """The host of all processes: its clocks and its chance.

    Attributes:
        wall_step_s: by how much the wall clock was set.
        inference_hangs_until: no policy answers before.
        loading_until: a policy that is opened before then is not loaded before then.
        log: target of every process's log.
    """

    def __init__(
        self, loop: clock.VirtualLoop, network: Network, disk: Disk, chance: random.Random, log: LogTarget
    ) -> None:
        self.loop, self.network, self.disk, self.chance, self.log = loop, network, disk, chance, log
        self.wall_step_s = 0.0
        self.database_busy_until = 0.0
        self.database_latency_s = (1e-4, 2e-3)
        self.inference_latency_s = (1e-3, 8e-3)
        self.inference_hangs_until = self.loading_until = 0.0
        self.admission_latency_s = (1e-4, 5e-3)
        self.databases: list[aiosqlite.core.Connection] = []

    def monotonic(self) -> float:
        return self.loop.time()

    def time_of_day(self) -> float:
        return WALL_S + self.loop.time() + self.wall_step_s

    def between(self, bounds: tuple[float, float]) -> float:
        return bounds[0] + (bounds[1] - bounds[0]) * self.chance.random()


def _database_queue(host: Host) -> type[threads.SimpleQueue]:
    class DatabaseQueue(threads.SimpleQueue):
        def get(self, block: bool = True, timeout: float | None = None) -> Any:
            job = super().get(block, timeout)
            clock.sleep(max(host.between(host.database_latency_s), host.database_busy_until - host.loop.time()))
            return job

    return DatabaseQueue


def _database_connection(host: Host) -> type[aiosqlite.core.Connection]:
    class DatabaseConnection(aiosqlite.core.Connection):
        def __init__(self, *args: Any, **kwargs: Any) -> None:
            super().__init__(*args, **kwargs)
            host.databases.append(self)

        def __del__(self) -> None: ...

    return DatabaseConnection


async def _at_once(function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
    return function(*args, **kwargs)


def _metronome(host: Host, dozed_ticks: Callable[[], int]) -> Callable[..., Metronome]:
    class Beat(Metronome):
        def wait(self, beats: int = 1) -> None:
            dozed_s = dozed_ticks() * self._period_s
            if dozed_s:
                self._due_s += dozed_s
            super().wait(beats)

    return partial(Beat, clock=host.monotonic, sleep=clock.sleep)


def _signal(number: int, handler: Any) -> None:
    clock.here().process.signal_handlers[number] = handler


SIGNALS = SimpleNamespace(
    SIGINT=2,
    SIGTERM=15,
    Signals=int,
    getsignal=lambda number: clock.here().process.signal_handlers.get(number),
    signal=_signal,
)
"""Stands in for `signal` in the API."""


def _here_only(virtual: Callable[..., Any], real: Callable[..., Any]) -> Callable[..., Any]:
    """The virtual clock for the universe, which is one thread of the system; the real one for any other thread."""
    universe = threading.get_ident()
    return lambda *args: (virtual if threading.get_ident() == universe else real)(*args)


def changes(host: Host, dozed_ticks: Callable[[], int]) -> list[Change]:
    """Everything that is put under the real code, as (owner, name, substitute).

    Args:
        host: of all processes.
        dozed_ticks: ticks that the world leaves out at this moment.
    """
    network, chance = host.network, host.chance
    policies = SimpleNamespace(opener=lambda _kind: partial(Held, host))
    server = sim_backend.zenoh_cell.server
    process = service.cell.process
    return [
        *_defaults(host),
        *host.log.changes(),
        (time, "time", _here_only(host.time_of_day, time.time)),
        (time, "monotonic", _here_only(host.monotonic, time.monotonic)),
        (time, "sleep", _here_only(clock.sleep, time.sleep)),
        (os, "fsync", host.disk.fsync),
        (secrets, "token_hex", lambda size=16: f"{chance.getrandbits(8 * size):0{2 * size}x}"),
        (secrets, "randbelow", chance.randrange),
        (secrets, "randbits", chance.getrandbits),
        (uuid, "uuid4", lambda: uuid.UUID(int=chance.getrandbits(128))),
        (fastapi.dependencies.utils, "run_in_threadpool", _at_once),
        (fastapi.routing, "run_in_threadpool", _at_once),
        (aiosqlite.core, "Connection", _database_connection(host)),
        (aiosqlite.core, "Thread", clock.Thread),
        (aiosqlite.core, "SimpleQueue", _database_queue(host)),
        (service.cell.answers, "threading", threads.THREADING),
        (service.cell.answers, "queue", threads.QUEUE),
        (service.cell.journal.storage, "threading", threads.THREADING),
        (service.cell.journal.storage, "queue", threads.QUEUE),
        (service.client, "open_session", network.open),
        (service.client, "close_session", close_session),
        (service.drivers.zenoh_sim, "open_session", network.open),
        (service.drivers.zenoh_sim, "close_session", close_session),
        (process, "open_session", network.open),
        (process, "close_session", close_session),
        (process, "Cell", partial(service.cell.cell.Cell, inference=InlineInference)),
        (service.cell.cell, "InProcessPolicy", policies),
        (process, "request_realtime", tuple),
        (process, "settle_interpreter", lambda: None),
        (api.application, "signal", SIGNALS),
        (api.control_process, "has_listener", network.has_listener),
        (service.logs, "threading", threads.THREADING),
        (service.logs, "queue", threads.QUEUE),
        (service.cell.cell, "log_fault", host.log.fault),
        (server, "Metronome", _metronome(host, dozed_ticks)),
        (server, "settle_interpreter", lambda: None),
    ]


OURS = ("service", "api", "sim_backend", "wire")


def _defaults(host: Host) -> list[Change]:
    """Clocks that stand as defaults in the signatures of our functions."""
    clocks: dict[Any, Any] = {
        time.monotonic: host.monotonic, time.time: host.time_of_day, time.sleep: clock.sleep,
        time.perf_counter: host.monotonic,
    }  # fmt: skip
    found: list[Change] = []
    for function in _functions_with_clocks():
        defaults = tuple(
            clocks.get(value, value) if callable(value) else value for value in function.__defaults__ or ()
        )
        named = {
            name: clocks.get(value, value) if callable(value) else value
            for name, value in (function.__kwdefaults__ or {}).items()
        }
        found += [(function, "__defaults__", defaults or None), (function, "__kwdefaults__", named or None)]
    return found


@lru_cache(maxsize=1)
def _functions_with_clocks() -> list[FunctionType]:
    known = {time.monotonic, time.time, time.sleep, time.perf_counter}
    functions: dict[int, FunctionType] = {}
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] in OURS:
            for value in vars(module).values():
                function = value.__dict__.get("__init__") if isinstance(value, type) else value
                if isinstance(function, FunctionType):
                    given = [*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()]
                    if any(callable(one) and one in known for one in given):
                        functions[id(function)] = function
    return list(functions.values())


@contextmanager
def substituted(found: list[Change]) -> Generator[None]:
    """Put the substitutes in, and the originals back at the end."""
    originals = [(owner, name, getattr(owner, name)) for owner, name, _ in found]
    logging = structlog.get_config()
    try:
        for owner, name, substitute in found:
            setattr(owner, name, substitute)
        yield
    finally:
        for owner, name, original in reversed(originals):
            setattr(owner, name, original)
        structlog.configure(**logging)
