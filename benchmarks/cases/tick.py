"""Computing time of the control process per sample and per policy step, beside one bare call of ONNX Runtime."""

import asyncio
import time

from benchmarks.harness.exchange import spans
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
from benchmarks.stands.bare_inference import bare_call
from benchmarks.stands.shipped_cell import ShippedCell, shipped_cell
from service.cell.cell import Cell
from service.cell.inference import InlineInference
from service.cell.process import attended
from service.messages import CellState, RunResult, StartRequest
from service.policy.model import Policy
from service.testing.in_process import InProcessDriver
from sim_backend.zenoh_cell.cell import SimulatedCell

RUN_TIMEOUT_S = 120.0


def measure(scale: float) -> Result:
    """Measure; `scale` multiplies the 10 insertions and the 5000 bare calls."""
    runs = max(1, int(10 * scale))
    with (
        shipped_cell() as shipped,
        timed(Cell, "on_sample") as samples,
        timed(Policy, "act") as inference,
    ):
        asyncio.run(_insert(shipped, runs))
        bare = spans(max(200, int(5000 * scale)), bare_call(shipped.policy))
    steps, others = samples.split(inference)
    inferences = [end - begin for begin, end in inference.calls if begin >= samples.calls[0][0]]
    reference = median(bare)
    rows = tuple(
        (name, str(len(taken)), *quantiles(taken), f"{median(taken) / reference:.1f}")
        for name, taken in (
            ("one sample, no policy step: monitor, stage, telemetry", others),
            ("one sample with a policy step: all, command included", steps),
            ("of which inference with its checks", inferences),
            ("bare ONNX Runtime call", bare),
        )
    )
    return Result(
        question="What does one control tick cost?",
        columns=("part", "count", *(f"{name} µs" for name in QUANTILES), "to bare"),
        rows=rows,
        finding=f"A policy step costs {median(steps) * 1e6:.0f} µs of a tick's 2000 (median), "
        f"or {median(steps) / reference:.0f} bare calls.",
        figures=(
            *quantile_figures("policy step in lockstep", steps, {"p50": 250.0, "p99": 500.0}),
            *quantile_figures("sample without a policy step", others, {"p50": 25.0}),
            Figure("policy step to bare ONNX call", median(steps) / reference, "times", 10.0),
            Figure("sample without a policy step to bare ONNX call", median(others) / reference, "times", 0.5),
        ),
        method=f"{runs} whole insertions in lockstep in this process, recipe {shipped.recipe}, {shipped.policy.name}; "
        "from the driver's delivery of a sample to the command encoded as its wire record.",
    )


async def _insert(shipped: ShippedCell, runs: int) -> None:
    cell = Cell(shipped.config, InProcessDriver(SimulatedCell()), inference=InlineInference)
    async with attended(cell):
        for seed in range(runs):
            await _until_ready(cell)
            answer = await cell.start(StartRequest(recipe=shipped.recipe, seed=seed))
            if not isinstance(answer, RunResult):
                raise UnavailableError(f"the run was refused: {answer.problem.detail}")
        await _until_ready(cell)


async def _until_ready(cell: Cell) -> None:
    deadline = time.monotonic() + RUN_TIMEOUT_S
    while cell.state is not CellState.READY:
        if cell.state is CellState.LATCHED or time.monotonic() > deadline:
            raise UnavailableError(f"the cell is {cell.state}: {cell.status().why_not}")
        await asyncio.sleep(0.01)
