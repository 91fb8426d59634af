"""Lateness of the control loop's judgement of samples in real time: idle and under a flood of HTTP requests, with and
without real-time scheduling.
"""

import asyncio
from dataclasses import dataclass

import numpy as np

from benchmarks.harness import operating
from benchmarks.harness.machine import may_use_fifo
from benchmarks.harness.processes import running
from benchmarks.harness.result import QUANTILES, Figure, Result, UnavailableError, quantile_figures, quantiles
from benchmarks.stands import flooded_api
from benchmarks.stands.shipped_cell import ShippedCell, shipped_cell
from service.client import CellClient
from service.program import MODULE


@dataclass(frozen=True, slots=True)
class _Observed:
    late_s: list[float]
    host_s: list[float]
    missed: int
    latches: str


def measure(scale: float) -> Result:
    """Measure; `scale` multiplies the 60 s per row."""
    seconds = max(3.0, 60.0 * scale)
    schedulings: dict[str, tuple[str, ...]] = {"ordinary": ("ordinary",)}
    if may_use_fifo():
        schedulings["real-time"] = ()
    rows: list[tuple[str, ...]] = []
    tails: dict[tuple[str, bool], float] = {}
    figures: list[Figure] = []
    for name, arguments in schedulings.items():
        for flooded in (False, True):
            http = "flood" if flooded else "idle"
            with shipped_cell(api__autostart="false", cell__realtime=str(not arguments)) as shipped:
                seen = _observe(shipped, arguments, seconds, flooded=flooded)
            tails[name, flooded] = float(np.quantile(seen.late_s, 0.999))
            counts = str(seen.missed), seen.latches
            rows.append((name, http, "samples", str(len(seen.late_s)), *quantiles(seen.late_s), *counts))
            rows.append((name, http, "host's timer", str(len(seen.host_s)), *quantiles(seen.host_s), "–", "–"))
            if name == "real-time":
                limits = {"p99": 500.0, "p99.9": 1000.0}
                figures += quantile_figures(f"lateness of a sample, {http}", seen.late_s, limits)
    growth = ", ".join(f"{tails[name, True] / tails[name, False]:.1f} ({name})" for name in schedulings)
    return Result(
        question="How late does the control loop judge a sample, and how late is the host itself?",
        columns=("scheduling", "HTTP", "of what", "count", *(f"{q} µs" for q in QUANTILES), "missed", "latches"),
        rows=tuple(rows),
        finding=f"The flood multiplies p99.9 by {growth}."
        + ("" if may_use_fifo() else " SCHED_FIFO is refused here, so there are no rows with it."),
        figures=tuple(figures),
        method=f"{seconds:.0f} s per row of insertions one after another. Samples: from the arrival in the transport's "
        "thread to the judgement and use in the loop. Host's timer: a process of the loop's own scheduling sleeps with "
        "`clock_nanosleep` until each beat of 2 ms, as cyclictest does, at the same time; it computes nothing. "
        "Simulated cell, control process and API run as three processes; a fourth sends GET requests on "
        f"{flooded_api.CONNECTIONS} connections.",
    )


def _observe(shipped: ShippedCell, arguments: tuple[str, ...], seconds: float, *, flooded: bool) -> _Observed:
    config, environment = shipped.config, shipped.environment
    watched, waker = config.cell.state_dir / "watched.npz", config.cell.state_dir / "waker.npy"
    realtime = ("--realtime",) if config.asks_realtime else ()
    world = ("sim", "serve", "--world", config.sim.world, "--listen", config.sim.endpoint, *realtime)
    service = ("benchmarks.stands.watched_service", str(watched))
    with (
        running(MODULE, *world),
        running(*service, ready="serving", environment=environment) as control,
        running("benchmarks.stands.waker", str(waker), *arguments) as sleeper,
        (flooded_api.flooded if flooded else flooded_api.serving_api)(shipped),
    ):
        missed, latches = asyncio.run(_operate(shipped, seconds))
        for process in (control, sleeper):
            process.terminate()
            process.wait(10)
        try:
            late_s, host_s = np.load(watched)["late"], np.load(waker)
        except OSError as error:
            raise UnavailableError(f"a process left no measurement: {error}") from error
    return _Observed(late_s.tolist(), host_s.tolist(), missed, latches or "none")


async def _operate(shipped: ShippedCell, seconds: float) -> tuple[int, str]:
    """Insert until the time is over; return the samples missed and the latched codes."""
    async with CellClient(shipped.config.cell.id, [shipped.config.cell.endpoint]) as client:
        latches = await operating.insert_repeatedly(client, shipped.recipe, seconds)
        status = client.last_status
    if status is None:
        raise UnavailableError("the control process was never heard")
    return status.counters.samples_missed, ", ".join(f"{count} {code}" for code, count in latches.items())
