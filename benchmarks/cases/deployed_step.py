"""From a sample's arrival to the command of its policy step, in real time and as deployed, beside a plain loop."""

import asyncio
import importlib.util
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.harness import operating
from benchmarks.harness.processes import running
from benchmarks.harness.result import QUANTILES, Figure, Result, UnavailableError, median, quantile_figures, quantiles
from benchmarks.stands.shipped_cell import ShippedCell, shipped_cell
from benchmarks.stands.ur_cell import HOST, controller_options, shipped_ur_cell
from service.client import CellClient
from service.program import MODULE
from wire.arrays import FloatArray
from wire.records import TICK_S

MARGIN_S = 30.0
"""Time beyond the loop's own within which ur_rtde must have connected, run and ended, s."""


class Taken(NamedTuple):
    """Durations, s.

    Attributes:
        command: from a sample's arrival to the departure of the command of its policy step.
        held: for which the step held the loop.
        judged: from a sample's arrival to the end of its judgement.
    """

    command: list[float]
    held: list[float]
    judged: list[float]


def measure(scale: float) -> Result:
    """Measure; `scale` multiplies the 200 s per row."""
    if importlib.util.find_spec("rtde_control") is None:
        raise UnavailableError("ur_rtde is not installed; it comes with the development dependencies")
    seconds = max(10.0, 200.0 * scale)
    with shipped_cell() as shipped:
        simulated = _simulated(shipped, seconds)
    with shipped_ur_cell() as shipped, running(MODULE, "sim", *controller_options(shipped)):
        ours = _ur(shipped, seconds)
        theirs = _peer(shipped, seconds)
    rows = {
        "control process, simulated cell": simulated,
        "control process, emulated UR controller": ours,
        "ur_rtde and ONNX Runtime, same controller": theirs,
    }
    return Result(
        question="How long from a sample's arrival to the command of its policy step, in real time?",
        columns=(
            *("way", "steps", *(f"{name} µs" for name in QUANTILES)),
            *("loop held p50 µs", "p99 µs", "sample judged p50 µs", "p99 µs"),
        ),
        rows=tuple(
            (name, str(len(taken.command)), *quantiles(taken.command), *_tails(taken.held), *_tails(taken.judged))
            for name, taken in rows.items()
        ),
        finding=f"On the same controller this control process takes {median(ours.command) * 1e6:.0f} µs (median), "
        f"ur_rtde with ONNX Runtime {median(theirs.command) * 1e6:.0f} µs.",
        figures=(
            *(
                figure
                for name, taken in (("simulated", simulated), ("UR", ours))
                for figure in (
                    *quantile_figures(f"arrival to command, {name}", taken.command, {"p50": 500.0, "p99": 1000.0}),
                    *quantile_figures(f"loop held, {name}", taken.held, {"p50": 300.0}),
                )
            ),
            Figure("arrival to command to ur_rtde", median(ours.command) / median(theirs.command), "times", 1.0),
            Figure("arrival to judged to ur_rtde", median(ours.judged) / median(theirs.judged), "times", 0.5),
        ),
        method=f"{seconds:.0f} s per row, all with real-time scheduling. Control process: insertions of the shipped "
        "policy one after another, in its own process; held: the sample's judgement with the observation, and later "
        "the action with the command. ur_rtde: polled at its own 500 Hz, the arm at rest, the same model every 100 ms, "
        "until `servoL` has returned; held: from the read of the package to there. On the controller a third process "
        "with a blocking socket says for both when a package arrived; on the simulated cell the transport's thread "
        "does.",
    )


def _tails(spans_s: list[float]) -> tuple[str, str]:
    p50, p99, *_ = quantiles(spans_s)
    return p50, p99


def _simulated(shipped: ShippedCell, seconds: float) -> Taken:
    sim = shipped.config.sim
    world = ("sim", "serve", "--world", sim.world, "--listen", sim.endpoint, "--realtime")
    with running(MODULE, *world):
        watched = _operated(shipped, seconds)
    with np.load(watched) as tables:
        steps: FloatArray = tables["steps"]
        late: FloatArray = tables["late"]
    return Taken((steps[:, 2] - steps[:, 1]).tolist(), steps[:, 3].tolist(), late.tolist())


def _ur(shipped: ShippedCell, seconds: float) -> Taken:
    arrivals = shipped.config.cell.state_dir / "arrivals.npy"
    with running("benchmarks.stands.rtde_referee", HOST, str(arrivals)) as referee:
        watched = _operated(shipped, seconds)
        referee.terminate()
        referee.wait(10)
    return refereed(watched, arrivals)


def _peer(shipped: ShippedCell, seconds: float) -> Taken:
    folder = shipped.config.cell.state_dir
    arrivals, output = folder / "arrivals.npy", folder / "peer.npz"
    loop = "benchmarks.stands.ur_rtde_policy", HOST, str(shipped.policy), str(seconds), str(output)
    with running("benchmarks.stands.rtde_referee", HOST, str(arrivals)) as referee:
        lines: list[str] = []
        with running(*loop, lines=lines) as peer:
            if peer.wait(seconds + MARGIN_S):
                raise UnavailableError(f"ur_rtde gave up: {''.join(lines[-1:]).strip()}")
        referee.terminate()
        referee.wait(10)
    return refereed(output, arrivals)


def _operated(shipped: ShippedCell, seconds: float) -> Path:
    """Insert for a while; return the file that the watched control process has written."""
    watched = shipped.config.cell.state_dir / "watched.npz"
    service = "benchmarks.stands.watched_service", str(watched)
    with running(*service, ready="serving", environment=shipped.environment) as control:
        asyncio.run(_operate(shipped, seconds))
        control.terminate()
        control.wait(10)
    return watched


async def _operate(shipped: ShippedCell, seconds: float) -> None:
    async with CellClient(shipped.config.cell.id, [shipped.config.cell.endpoint]) as client:
        await operating.insert_repeatedly(client, shipped.recipe, seconds)


def refereed(output: Path, arrivals: Path) -> Taken:
    """Return durations from the arrivals that the referee has seen."""
    seen: FloatArray = np.load(arrivals)
    with np.load(output) as tables:
        steps: FloatArray = tables["steps"]
        judged: FloatArray = tables["judged"]
    ticks, first = np.unique(np.round(seen[:, 0] / TICK_S).astype(np.int64), return_index=True)

    def since_arrival(stamps: FloatArray, times: FloatArray) -> tuple[list[float], list[int]]:
        wanted = np.round(stamps / TICK_S).astype(np.int64)
        places = np.minimum(np.searchsorted(ticks, wanted), len(ticks) - 1)
        known = np.flatnonzero(ticks[places] == wanted)
        return (times[known] - seen[first[places[known]], 1]).tolist(), known.tolist()

    command, known = since_arrival(steps[:, 0], steps[:, 2])
    return Taken(command, steps[known, 3].tolist(), since_arrival(judged[:, 0], judged[:, 1])[0])
