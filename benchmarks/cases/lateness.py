"""Lateness of the control loop's judgement of samples in real time: idle and under a flood of HTTP requests, with and
without real-time scheduling.
"""

import asyncio
import contextlib
import re
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.harness import operating
from benchmarks.harness.machine import may_use_fifo
from benchmarks.harness.processes import running
from benchmarks.harness.result import QUANTILES, Result, UnavailableError, quantiles
from benchmarks.stands.shipped_cell import ShippedCell, shipped_cell
from service.client import CellClient
from service.messages import CellState
from service.program import MODULE

CONNECTIONS = 16


@dataclass(frozen=True, slots=True)
class _Observed:
    late_s: list[float]
    missed: int
    latches: str
    requests_per_s: str


def measure(scale: float) -> Result:
    """Measure; `scale` multiplies the 20 s per row."""
    seconds = max(3.0, 20.0 * scale)
    schedulings = {"ordinary": False}
    if may_use_fifo():
        schedulings["real-time"] = True
    rows: list[tuple[str, ...]] = []
    tails: dict[tuple[str, bool], float] = {}
    for name, realtime in schedulings.items():
        for flooded in (False, True):
            with shipped_cell(api__autostart="false", cell__realtime=str(realtime)) as shipped:
                seen = _observe(shipped, seconds, flooded=flooded)
            tails[name, flooded] = float(np.quantile(seen.late_s, 0.999))
            rows.append(
                (
                    name,
                    "flood" if flooded else "idle",
                    str(len(seen.late_s)),
                    *quantiles(seen.late_s),
                    str(seen.missed),
                    seen.latches,
                    seen.requests_per_s,
                )
            )
    growth = ", ".join(f"{tails[name, True] / tails[name, False]:.1f} ({name})" for name in schedulings)
    return Result(
        question="How late does the control loop judge a sample?",
        columns=("scheduling", "HTTP", "samples", *(f"{q} µs" for q in QUANTILES), "missed", "latches", "requests/s"),
        rows=tuple(rows),
        finding=f"The flood multiplies p99.9 by {growth}."
        + ("" if may_use_fifo() else " SCHED_FIFO is refused here, so there are no rows with it."),
        method=f"{seconds:.0f} s per row of insertions one after another. From the sample's arrival in the transport's "
        "thread to its judgement and use in the loop. Simulated cell, control process and API run as three processes; "
        f"a fourth sends GET requests on {CONNECTIONS} connections.",
    )


def _observe(shipped: ShippedCell, seconds: float, *, flooded: bool) -> _Observed:
    config, environment = shipped.config, shipped.environment
    output = config.cell.state_dir / "lateness.npy"
    port = str(config.api.port)
    realtime = ("--realtime",) if config.asks_realtime else ()
    world = ("sim", "serve", "--world", config.sim.world, "--listen", config.sim.endpoint, *realtime)
    lines: list[str] = []
    with running(MODULE, *world), contextlib.ExitStack() as others:
        service = others.enter_context(
            running("benchmarks.stands.watched_service", str(output), ready="serving", environment=environment)
        )
        others.enter_context(
            running("uvicorn", "api.app:app", "--port", port, ready="Uvicorn running", environment=environment)
        )
        if flooded:
            flood = ("benchmarks.stands.flood", port, str(seconds), str(CONNECTIONS))
            others.enter_context(running(*flood, lines=lines))
        missed, latches = asyncio.run(_operate(shipped, seconds))
        if flooded:
            time.sleep(1.0)  # the flood reports its number of answers
        service.terminate()
        service.wait(10)
        late_s = _load(output)
    rate = re.search(r"(\d+) a second", "".join(lines))
    return _Observed(late_s, missed, latches or "none", rate[1] if rate else ("?" if flooded else "0"))


def _load(path: Path) -> list[float]:
    try:
        late_s: list[float] = np.load(path).tolist()
    except OSError as error:
        raise UnavailableError(f"the control process left no measurement: {error}") from error
    return late_s


async def _operate(shipped: ShippedCell, seconds: float) -> tuple[int, str]:
    """Insert until the time is over; return the samples missed and the latched codes."""
    until_s = time.monotonic() + seconds
    latches: Counter[str] = Counter()
    async with CellClient(shipped.config.cell.id, [shipped.config.cell.endpoint]) as client:
        seed = 0
        while time.monotonic() < until_s:
            status = client.last_status
            if client.state is CellState.LATCHED and status is not None and status.latch is not None:
                latches[status.latch.code] += 1
                await operating.reset(client)
            elif client.state is CellState.READY:
                with contextlib.suppress(operating.LatchedError):
                    await operating.start(client, shipped.recipe, seed)
                seed += 1
            await asyncio.sleep(0.05)
        status = client.last_status
    if status is None:
        raise UnavailableError("the control process was never heard")
    return status.counters.samples_missed, ", ".join(f"{count} {code}" for code, count in latches.items())
