"""Costs of a whole simulated cell, as `dsl-assembly demo` and `serve` run it: its start, its rest, its status."""

import asyncio
import json
import time
from pathlib import Path

from benchmarks.harness import operating
from benchmarks.harness.cpu import cpu_s
from benchmarks.harness.processes import running
from benchmarks.harness.result import QUANTILES, Figure, Result, median, quantile_figures, quantiles
from benchmarks.stands.shipped_cell import ShippedCell, shipped_cell
from benchmarks.stands.status_readers import CLIENTS, RATE_HZ
from service.client import CellClient
from service.messages import CellState
from service.program import MODULE

RESTING_S = 5.0
"""Time after which the world of a cell that is READY rests, s."""
ROLES = {"sim serve": "world", f"-m {MODULE} control": "control process", f"-m {MODULE} serve": "API"}
"""Processes by words of their command lines; policies and watchdog compute nothing at rest."""
READS = f"status, {CLIENTS} clients at {RATE_HZ:g} Hz"


def measure(scale: float) -> Result:
    """Measure; `scale` multiplies 10 starts, and 20 s of rest and of status."""
    seconds = max(3.0, 20.0 * scale)
    starts: list[float] = []
    for _ in range(max(2, int(10 * scale))):
        with shipped_cell(cell__realtime="false") as shipped:
            starts.append(_start(shipped))
    with (
        shipped_cell(cell__realtime="false") as shipped,
        running(MODULE, "serve", ready="page on", environment=shipped.environment) as server,
    ):
        asyncio.run(_ready(shipped))
        time.sleep(RESTING_S)
        shares = _shares(server.pid, seconds)
        reads = _reads(shipped, seconds)
    total = sum(shares.values())
    return Result(
        question="How long does a cell take to start, what does it cost at rest, and how fast does it tell its status?",
        columns=("what", "count", *QUANTILES),
        rows=(
            ("demo to start accepted, s", str(len(starts)), *quantiles(starts, 1.0)),
            (f"{READS}, ms", str(len(reads)), *quantiles(reads, 1e-3)),
            *(
                (f"{role} at rest, % of a core", "–", f"{100 * share:.1f}", "–", "–", "–")
                for role, share in shares.items()
            ),
        ),
        finding=f"A start takes {median(starts):.1f} s, a cell at rest {100 * total:.0f} % of a core.",
        figures=(
            Figure("demo to start accepted, p50", median(starts), "s", 3.0),
            Figure("world, control process and API at rest", 100 * total, "% of a core", 10.0),
            *quantile_figures(READS, reads, {"p99": 3.0}, 1e-3, "ms"),
        ),
        method="Processes as a person starts them, without real-time scheduling. Start: from the command to the answer "
        "of `POST /start`; Python's files are in the system's cache after the first. Rest: CPU time over "
        f"{seconds:.0f} s of a cell that is READY and that nobody asks. Status: every client has its own connection.",
    )


def _start(shipped: ShippedCell) -> float:
    begun = time.perf_counter()
    with running(
        *(MODULE, "demo", "--once", "--port", str(shipped.config.api.port)),
        ready="accepted",
        environment=shipped.environment,
    ):
        return time.perf_counter() - begun


async def _ready(shipped: ShippedCell) -> None:
    async with CellClient(shipped.config.cell.id, [shipped.config.cell.endpoint]) as client:
        await operating.until(client, CellState.READY)


def _shares(server: int, seconds: float) -> dict[str, float]:
    """Return the share of a core that each process of a cell takes, by its role."""
    pids = {_role(pid): pid for pid in (server, *_descendants(server))}
    before = {role: cpu_s(pids[role]) for role in ROLES.values()}
    begun = time.perf_counter()
    time.sleep(seconds)
    return {role: (cpu_s(pids[role]) - spent) / (time.perf_counter() - begun) for role, spent in before.items()}


def _role(pid: int) -> str:
    line = Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
    return next((role for words, role in ROLES.items() if words in line), line)


def _descendants(pid: int) -> list[int]:
    children = [
        int(child) for file in Path(f"/proc/{pid}/task").glob("*/children") for child in file.read_text().split()
    ]
    return [*children, *(later for child in children for later in _descendants(child))]


def _reads(shipped: ShippedCell, seconds: float) -> list[float]:
    lines: list[str] = []
    with running(
        "benchmarks.stands.status_readers", str(shipped.config.api.port), str(seconds), lines=lines
    ) as readers:
        readers.wait(seconds + operating.STATE_TIMEOUT_S)
    spans: list[float] = json.loads(lines[-1])
    return spans
