"""True force on the part under every lie of the force/torque sensor, in lockstep with the cell, in simulated time."""

import asyncio
import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from benchmarks.harness.result import Result
from service.messages import CellState, ResetRequest, RunResult, StartRequest
from service.testing import RECIPE, Bench, cell_config, lockstep_cell
from service.testing.lying_sensor import LIES, LyingSensor
from sim_backend.zenoh_cell.cell import SimulatedCell

POLICY = Path("models/vftm-dsl.onnx")
MOMENTS = ("from the start", "in free air", "in contact")
FIRST_SEED = 3_000_000
SEEDS = 5
TOUCHED_N = 3.0
"""True contact force from which a lie in contact begins, N."""


class Outcome(NamedTuple):
    """One run under one lie.

    Attributes:
        end: fault code, or the run's state without one.
        peak_n: largest true force on the part, the stop included.
    """

    end: str
    peak_n: float


def measure(scale: float) -> Result:
    """Measure; `scale` multiplies the seeds per row."""
    seeds = range(FIRST_SEED, FIRST_SEED + max(1, int(SEEDS * scale)))
    with tempfile.TemporaryDirectory() as folder:
        honest = asyncio.run(_outcomes(Path(folder) / "honest", None, "", seeds))
        rows = [_row("none", "", honest)]
        for number, (name, moment) in enumerate((name, moment) for name in LIES for moment in MOMENTS):
            rows.append(_row(name, moment, asyncio.run(_outcomes(Path(folder) / str(number), name, moment, seeds))))
    worst = max(rows[1:], key=lambda row: float(row[3]))
    return Result(
        question="How much force does the part bear if the force/torque sensor lies?",
        columns=("lie", "from when", "true force p50 N", "true force max N", "how the runs ended"),
        rows=tuple(rows),
        finding=f"The largest true force of {len(rows) - 1} lies, {len(seeds)} runs each, is {worst[3]} N "
        f"({worst[0]}, {worst[1]}).",
        method="A cell in lockstep on the simulated arm, the shipped policy, standard conditions. The lie is put under "
        "everything: the arm's law, its ceiling, the lock and the monitor get the same false reading. True force: "
        "resultant of the contacts on the peg, every tick from the start to standstill.",
    )


async def _outcomes(folder: Path, name: str | None, moment: str, seeds: Sequence[int]) -> list[Outcome]:
    world = SimulatedCell("tr")
    sensor = LyingSensor(world.world)
    outcomes: list[Outcome] = []
    async with lockstep_cell(cell_config(folder, POLICY), world=world) as bench:
        for seed in seeds:
            sensor.be_honest()
            end = await _insert(bench, sensor, name, moment, seed)
            await bench.let_pass(0.3)
            outcomes.append(Outcome(end, sensor.peak_n))
            if bench.cell.state is CellState.LATCHED:
                sensor.be_honest()
                await bench.let_pass(0.3)
                await bench.cell.reset(ResetRequest())
    return outcomes


async def _insert(bench: Bench, sensor: LyingSensor, name: str | None, moment: str, seed: int) -> str:
    """Return how the run ended, or why the cell refused it."""
    if name is not None and moment == "from the start":
        sensor.begin(LIES[name], absolute=True)
        await bench.let_pass(0.3)
    answer = await bench.cell.start(StartRequest(recipe=RECIPE, seed=seed))
    if not isinstance(answer, RunResult):
        verdict = bench.cell.status().latch
        return f"refused, {answer.problem.reason if verdict is None else verdict.code}"
    if name is not None and moment != "from the start":
        await bench.state(CellState.APPROACH, CellState.READY)
        sensor.be_honest()  # a peg that the run before left in contact does not count
        if moment == "in contact":
            await bench.until(lambda: sensor.peak_n > TOUCHED_N or bench.cell.runs.active is None)
        sensor.begin(LIES[name])
    run = await bench.ended(answer.run)
    return run.code or run.state


def _row(name: str, moment: str, outcomes: Sequence[Outcome]) -> tuple[str, ...]:
    peaks = sorted(outcome.peak_n for outcome in outcomes)
    ends = Counter(outcome.end for outcome in outcomes)
    return (
        name,
        moment,
        f"{peaks[len(peaks) // 2]:.1f}",
        f"{peaks[-1]:.1f}",
        ", ".join(f"{end} {count}" for end, count in ends.most_common()),
    )
