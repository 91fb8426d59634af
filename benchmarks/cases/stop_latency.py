"""Time from a sample above the ceiling to the stop command: within the process, and on the wire between processes."""

import asyncio
import contextlib
import dataclasses
from collections.abc import Awaitable, Callable
from contextlib import AbstractContextManager

from benchmarks.cases.round_trip import publication_echo
from benchmarks.harness import operating
from benchmarks.harness.exchange import spans
from benchmarks.harness.processes import free_port, running
from benchmarks.harness.result import (
    QUANTILES,
    Figure,
    Result,
    UnavailableError,
    median,
    quantile_figures,
    quantiles,
)
from benchmarks.harness.stopwatch import timed
from benchmarks.stands.flooded_api import CONNECTIONS, flooded
from benchmarks.stands.shipped_cell import ShippedCell, shipped_cell
from benchmarks.stands.tripping_world import FORCE_N, TRIP
from service.cell.cell import Cell
from service.cell.inference import InlineInference
from service.cell.process import attended
from service.client import CellClient
from service.messages import CellState, ResetRequest, StartRequest
from service.testing.in_process import InProcessDriver
from sim_backend.zenoh_cell.cell import SimulatedCell
from wire.records import STATE, Kind, new
from wire.session import close_session, open_session, query

TRIP_TIMEOUT_S = 5.0
Begin = Callable[[CellClient, str, int], Awaitable[object]]
"""Starts an insertion of a recipe and a seed."""
Load = Callable[[ShippedCell], AbstractContextManager[object]]
"""Loads the host beside a cell while a block lasts."""


def measure(scale: float) -> Result:
    """Measure; `scale` multiplies the 1000 stops of each row of real processes, and the 200 within one."""
    count = max(5, int(1000 * scale))
    with shipped_cell() as shipped:
        inside = asyncio.run(_inside(shipped, max(20, int(200 * scale))))
    echo = _echo(max(100, int(2000 * scale)))
    rows = [("bare Zenoh echo: there and back", echo), ("monitor to driver, in one process", inside)]
    wired: dict[str, list[float]] = {}
    for name, load in LOADS.items():
        with shipped_cell(api__autostart="false") as shipped:
            wired[name] = _on_the_wire(shipped, count, load)
        rows.append((f"on the wire, {name}", wired[name]))
    with shipped_cell(cell__realtime="false") as shipped:
        taken = _on_the_wire(shipped, max(5, count // 10), _quiet)
    rows.append(("on the wire, quiet, without real-time scheduling", taken))
    reference = median(echo)
    return Result(
        question="How long from a sample above the ceiling to the stop command?",
        columns=("way", "stops", *(f"{name} µs" for name in QUANTILES), "to echo"),
        rows=tuple(
            (name, str(len(taken)), *quantiles(taken), f"{median(taken) / reference:.2f}") for name, taken in rows
        ),
        finding=f"On the wire {median(wired['quiet']) * 1e6:.0f} µs (median), "
        f"{median(wired['quiet']) / reference:.1f} bare echoes; the judgement itself {median(inside) * 1e6:.0f} µs.",
        figures=(
            *(
                figure
                for name, taken in wired.items()
                for figure in quantile_figures(f"over ceiling to stop, {name}", taken, {"p50": 250.0, "p99.9": 1000.0})
            ),
            Figure("over ceiling to stop, quiet, to echo", median(wired["quiet"]) / reference, "times", 3.0),
        ),
        method="In one process: from the call that passes the sample to the driver's stop. On the wire: a simulated "
        f"cell publishes samples of {FORCE_N:g} N while the control process has a run in its pre-flight, and times "
        "from the first one to the stop's arrival; three processes in real time, with the cell's own 500 Hz tick. "
        "Under inference: a policy computes without a pause in a process as a control process has it. Under a flood: "
        f"the API runs, and gets GET requests on {CONNECTIONS} connections. Runs that ended earlier are excluded.",
    )


def _quiet(_: ShippedCell) -> AbstractContextManager[object]:
    return contextlib.nullcontext()


def _inferring(shipped: ShippedCell) -> AbstractContextManager[object]:
    return running("benchmarks.stands.inferring", str(shipped.policy))


LOADS: dict[str, Load] = {"quiet": _quiet, "under inference": _inferring, "under an HTTP flood": flooded}


def _echo(count: int) -> list[float]:
    payload = new(STATE, Kind.STATE).tobytes()
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with running("benchmarks.stands.echo", endpoint):
        session = open_session(connect=[endpoint])
        try:
            return spans(count, publication_echo(session, payload))
        finally:
            close_session(session)


async def _inside(shipped: ShippedCell, count: int) -> list[float]:
    taken: list[float] = []
    cell = Cell(shipped.config, InProcessDriver(SimulatedCell()), inference=InlineInference)
    async with attended(cell):
        for seed in range(count):
            await _state(cell, CellState.READY)
            await cell.start(StartRequest(recipe=shipped.recipe, seed=seed))
            if await _state(cell, CellState.APPROACH, CellState.READY) is CellState.READY:
                continue  # its pre-flight failed
            sample = cell.newest_sample
            assert sample is not None  # noqa: S101  # it approaches
            wrench = sample.wrench.copy()
            wrench[2] = FORCE_N
            above = dataclasses.replace(sample, wrench=wrench, seq=sample.seq + 1)
            with timed(Cell, "on_sample") as judged, timed(InProcessDriver, "stop") as stopped:
                cell.on_sample(above)
            taken.append(stopped.calls[0][1] - judged.calls[0][0])
            await _state(cell, CellState.LATCHED)
            await cell.reset(ResetRequest())
    return taken


async def _state(cell: Cell, *wanted: CellState) -> CellState:
    async with asyncio.timeout(operating.STATE_TIMEOUT_S):
        while cell.state not in wanted:
            await asyncio.sleep(0)
    return cell.state


def _on_the_wire(shipped: ShippedCell, count: int, load: Load) -> list[float]:
    config = shipped.config
    output = str(config.cell.state_dir / "watched.npz")
    with (
        running("benchmarks.stands.tripping_world", config.sim.endpoint, config.sim.world),
        running("benchmarks.stands.watched_service", output, ready="serving", environment=shipped.environment),
        load(shipped),
    ):
        return asyncio.run(stops(shipped, config.sim.endpoint, count, operating.start))


async def stops(shipped: ShippedCell, endpoint: str, count: int, begin: Begin) -> list[float]:
    """Start insertions, trip each, and reset; return the spans from sample to stop, s.

    Args:
        shipped: cell whose service runs.
        endpoint: endpoint of the process that answers `TRIP`.
        count: number of insertions.
        begin: starts one and waits until it may be tripped; its answer is false if there is nothing to trip.

    Raises:
        UnavailableError: no stop came, or no insertion could be tripped.
    """
    taken: list[float] = []
    session = await asyncio.to_thread(open_session, connect=[endpoint])
    try:
        async with CellClient(shipped.config.cell.id, [shipped.config.cell.endpoint]) as client:
            for seed in range(count):
                try:
                    if not await begin(client, shipped.recipe, seed):
                        continue
                except operating.LatchedError:
                    await operating.reset(client)
                    continue
                answers = await query(session, TRIP, b"", TRIP_TIMEOUT_S)
                status = await client.status()
                if answers:
                    taken.append(float(answers[0]))
                elif status.state is not CellState.LATCHED:
                    raise UnavailableError(
                        f"no stop within {TRIP_TIMEOUT_S:g} s of a sample of {FORCE_N:g} N, the {seed + 1}th: the cell "
                        f"is {status.state}, its run {status.run}, {status.counters.samples_missed} samples were missed"
                    )
                await operating.reset(client)
    finally:
        await asyncio.to_thread(close_session, session)
    if not taken:
        raise UnavailableError(f"none of {count} runs could be tripped")
    return taken
