"""Timing of the emulated controller's 2 ms tick and its cost, by the number of clients and programs."""

import asyncio
import importlib.util
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.harness.cpu import cpu_s
from benchmarks.harness.machine import may_use_fifo
from benchmarks.harness.processes import running
from benchmarks.harness.result import QUANTILES, Figure, Result, UnavailableError, quantiles
from benchmarks.stands.shipped_cell import ShippedCell
from benchmarks.stands.ur_cell import HOST, shipped_ur_cell
from service.drivers.ur import recovery
from service.drivers.ur.samples import OUTPUTS
from wire.arrays import FloatArray
from wire.records import TICK_S

SETTLE_S = 0.5


class _Load(NamedTuple):
    """Load on a controller: programs that run there, and clients that take packages at 500 Hz."""

    programs: str
    clients: int


class _Window(NamedTuple):
    """Duration of a load: begin and end, s of the monotonic clock, and CPU seconds per second."""

    begin_s: float
    end_s: float
    share: float


class _Seen(NamedTuple):
    """Lateness of the beats and duration of the ticks, s, and CPU seconds per second."""

    late_s: FloatArray
    spent_s: FloatArray
    share: float


_IDLE, _BUSY = _Load("none", 0), _Load("both", 3)


def measure(scale: float) -> Result:
    """Measure; `scale` multiplies the 15 s per row."""
    if importlib.util.find_spec("rtde_control") is None:
        raise UnavailableError("ur_rtde is not installed; it comes with the development dependencies")
    seconds = max(2.0, 15.0 * scale)
    schedulings: dict[str, tuple[str, ...]] = {"ordinary": ()}
    if may_use_fifo():
        schedulings["real-time"] = ("--realtime",)
    rows: list[tuple[str, ...]] = []
    seen: dict[_Load, _Seen] = {}
    for name, flags in schedulings.items():
        with shipped_ur_cell() as shipped:
            seen = _observe(shipped, flags, seconds)
        for load, taken in seen.items():
            missed = int((taken.late_s > TICK_S).sum())
            spent = [f"{value * 1e6:.0f}" for value in np.quantile(taken.spent_s, (0.5, 0.99))]
            late = quantiles(taken.late_s.tolist())
            counts = str(load.clients), str(len(taken.late_s))
            rows.append((name, load.programs, *counts, *late, str(missed), *spent, f"{taken.share:.0%}"))
    busy, idle_s = seen[_BUSY], float(np.median(seen[_IDLE].spent_s))
    busy_s = float(np.median(busy.spent_s))
    return Result(
        question="Does the emulated controller keep 500 Hz?",
        columns=(
            *("scheduling", "programs", "clients", "ticks", *(f"late {q} µs" for q in QUANTILES)),
            *("late by a tick", "tick p50 µs", "tick p99 µs", "CPU"),
        ),
        rows=tuple(rows),
        finding=f"With {[*schedulings][-1]} scheduling, both programs and {_BUSY.clients} clients a tick takes "
        f"{busy_s * 1e6:.0f} µs of its 2000 (median), {busy_s / idle_s:.1f} times that of an idle controller; "
        f"{(busy.late_s > TICK_S).mean():.1%} of the beats come more than a tick late."
        + ("" if may_use_fifo() else " SCHED_FIFO is refused here, so there are no rows with it."),
        figures=(Figure("beats late by more than a tick, busy", 100.0 * (busy.late_s > TICK_S).mean(), "%", 0.1),),
        method=f"{seconds:.0f} s per row of `dsl-assembly sim ur-controller` in real time, recorded inside it: "
        "how late each beat of 2 ms begins, and how long its tick takes, clients' input and output included; CPU time "
        "of the whole process. Each client takes packages at 500 Hz; clients that only read take the driver's "
        f"{len(OUTPUTS)} variables. The senders of programs are clients too: ur_rtde's control interface, and this "
        "driver with a target every 100 ms. A controller has one main program; if both run, ur_rtde's is a secondary "
        "one.",
    )


def _observe(shipped: ShippedCell, flags: tuple[str, ...], seconds: float) -> dict[_Load, _Seen]:
    """Put every load on one controller, one after another."""
    output = Path(shipped.config.cell.state_dir) / "ticks.npy"
    windows: dict[_Load, _Window] = {}
    ur = shipped.config.ur
    assert ur is not None  # noqa: S101  # the cell has one
    with running("benchmarks.stands.watched_controller", str(output), "--host", HOST, *flags) as controller:

        def watch(load: _Load) -> None:
            time.sleep(SETTLE_S)
            begin_s, begin_cpu_s = time.monotonic(), cpu_s(controller.pid)
            time.sleep(seconds)
            end_s, end_cpu_s = time.monotonic(), cpu_s(controller.pid)
            windows[load] = _Window(begin_s, end_s, (end_cpu_s - begin_cpu_s) / (end_s - begin_s))

        watch(_IDLE)
        for count in (1, 3):
            with _client(shipped, "readers", HOST, str(count)):
                watch(_Load("none", count))
        with _client(shipped, "driver"):
            watch(_Load("control program, engaged", 1))
        with _client(shipped, "ur_rtde", HOST):
            watch(_Load("ur_rtde's, idle", 1))
            asyncio.run(recovery.stop_program(ur))  # the driver takes no arm from another program
            with _client(shipped, "driver"):
                watch(_Load("both", 2))
                with _client(shipped, "readers", HOST, "1"):
                    watch(_BUSY)
        controller.terminate()
        controller.wait(10)
        begins, late_s, spent_s = np.load(output).T
    seen: dict[_Load, _Seen] = {}
    for load, (begin_s, end_s, share) in windows.items():
        within = (begins >= begin_s) & (begins < end_s)
        seen[load] = _Seen(late_s[within], spent_s[within], share)
    return seen


@contextmanager
def _client(shipped: ShippedCell, *arguments: str) -> Generator[None]:
    """Run a client of the controller while the block lasts.

    Raises:
        UnavailableError: the client did not begin, or gave up.
    """
    lines: list[str] = []
    with running("benchmarks.stands.ur_clients", *arguments, environment=shipped.environment, lines=lines) as client:
        yield
        if client.poll() is not None:
            raise UnavailableError(f"the client {arguments[0]} gave up: {''.join(lines[-1:]).strip()}")
