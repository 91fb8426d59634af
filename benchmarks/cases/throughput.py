"""The training environment beside raw `mujoco.batch.Batch.step`: same scene, states and threads, taking turns."""

import os
import time
from dataclasses import dataclass

import numpy as np
from mujoco.batch import Batch

from benchmarks.harness.result import Figure, Result
from benchmarks.harness.stopwatch import timed
from training.environment.design import vftm_dsl
from training.environment.episodes import TaskSource
from training.environment.insertion import Insertions
from training.environment.vector import EndlessInsertions
from training.learning.parallel import ParallelInsertions
from wire.records import TICK_S

CELLS = 256
TARGET = 0.88
WARM_UP = 20


@dataclass(slots=True)
class _Spent:
    ticks: int = 0
    raw_s: float = 0.0
    raw_by_tick_s: float = 0.0
    steps_s: float = 0.0
    physics_s: float = 0.0
    resets_s: float = 0.0
    resets: int = 0


def measure(scale: float) -> Result:
    """Measure; `scale` multiplies the 60 environment steps per row."""
    steps = max(4, int(60 * scale))
    cores = len(os.sched_getaffinity(0))
    settings = sorted({(CELLS, 1), (CELLS, cores), (4 * CELLS, cores)})
    runs = {setting: _run(*setting, steps) for setting in settings}
    rows = tuple(
        (
            f"{cells} cells, {threads} thread{'s' * (threads > 1)}",
            f"{spent.ticks / spent.raw_s / 1e3:.0f}",
            f"{spent.ticks / spent.raw_by_tick_s / 1e3:.0f}",
            f"{spent.ticks / spent.steps_s / 1e3:.0f}",
            f"{spent.raw_s / spent.steps_s:.2f}",
            f"{spent.physics_s / spent.steps_s:.0%}",
            f"{spent.resets_s / spent.resets * 1e6:.0f}" if spent.resets else "–",
            f"{steps * cells / (spent.steps_s + spent.resets_s):.0f}",
        )
        for (cells, threads), spent in runs.items()
    )
    if cores > 1:
        rows += (_workers(cores, steps, runs[CELLS, cores]),)
    ratios = ", ".join(f"{s.raw_s / s.steps_s:.2f} with {c} cells on {t}" for (c, t), s in runs.items())
    return Result(
        question="How much of raw `Batch.step` does the training environment keep?",
        columns=(
            "batch",
            "raw k/s",
            "raw by tick k/s",
            "env k/s",
            "env/raw",
            "physics",
            "µs/reset",
            "steps/s",
        ),
        rows=rows,
        finding=f"Of raw: {ratios} threads.",
        figures=tuple(
            Figure(f"environment to raw, {c} cells on {t}", s.raw_s / s.steps_s, "of raw", TARGET, at_least=True)
            for (c, t), s in runs.items()
        ),
        method=(
            f"{steps} steps of {vftm_dsl().ticks_per_step} ticks with random actions; before each, the same states "
            "step raw, controls held, once in one call and once tick by tick. k/s: thousands of ticks per second, "
            f"a tick being {TICK_S * 1e3:g} ms of one cell. physics: share of `Batch.step` in the environment's step; "
            "the rest is law and sensor at every tick, lock, bounds and observation at every step. "
            "steps/s: policy steps, resets included. The row of workers is several environments of one thread each, in "
            "processes, resets included; its raw figure is that of as many threads."
        ),
    )


def _worker(number: int) -> EndlessInsertions:
    return EndlessInsertions(Insertions(vftm_dsl(), CELLS, threads=1), TaskSource(), number)


def _workers(workers: int, steps: int, raw: _Spent) -> tuple[str, ...]:
    """Return the row of several environments in processes of their own."""
    environment = ParallelInsertions(_worker, workers)
    rng = np.random.default_rng(0)
    try:
        environment.reset()
        spent_s = 0.0
        for number in range(WARM_UP + steps):
            action = rng.uniform(-1, 1, (environment.n, len(vftm_dsl().action)))
            begin = time.perf_counter()
            environment.step(action)
            if number >= WARM_UP:
                spent_s += time.perf_counter() - begin
    finally:
        environment.close()
    per_s = steps * environment.n / spent_s
    ticks_per_s, raw_per_s = per_s * vftm_dsl().ticks_per_step, raw.ticks / raw.raw_s
    return (
        f"{workers} workers of {CELLS} cells",
        f"{raw_per_s / 1e3:.0f}",
        "–",
        f"{ticks_per_s / 1e3:.0f}",
        f"{ticks_per_s / raw_per_s:.2f}",
        "–",
        "–",
        f"{per_s:.0f}",
    )


def _run(cells: int, threads: int, steps: int) -> _Spent:
    contract, rng, source = vftm_dsl(), np.random.default_rng(0), TaskSource()
    environment = Insertions(contract, cells, threads=threads)
    batch: Batch = environment.world._batch  # pyright: ignore[reportPrivateUsage]  # the comparison needs it
    environment.reset(np.arange(cells), source.draw(rng, cells))
    spent = _Spent()
    for number in range(WARM_UP + steps):
        state = batch.state.copy()
        raw = _raw(batch, state, contract.ticks_per_step)
        with timed(Batch, "step") as physics:
            begin = time.perf_counter()
            outcome = environment.step(rng.uniform(-1, 1, (cells, environment.action_size)))
            step_s = time.perf_counter() - begin
        ended = np.flatnonzero(outcome.terminated | outcome.truncated)
        begin = time.perf_counter()
        if ended.size:
            environment.reset(ended, source.draw(rng, ended.size))
        reset_s = time.perf_counter() - begin
        if number < WARM_UP:
            continue
        spent.ticks += contract.ticks_per_step * cells
        spent.raw_s += raw[0]
        spent.raw_by_tick_s += raw[1]
        spent.steps_s += step_s
        spent.physics_s += physics.spent_s
        spent.resets_s += reset_s
        spent.resets += ended.size
    return spent


def _raw(batch: Batch, state: np.ndarray, ticks: int) -> tuple[float, float]:
    """Step from `state` in one call and tick by tick; return the seconds of each, and restore the state."""
    begin = time.perf_counter()
    batch.step(nstep=ticks)
    whole_s = time.perf_counter() - begin
    batch.state[:] = state
    begin = time.perf_counter()
    for _ in range(ticks):
        batch.step()
    singly_s = time.perf_counter() - begin
    batch.state[:] = state
    return whole_s, singly_s
