"""The training environment beside raw `mujoco.batch.Batch.step`: same scene, states and threads, taking turns."""

import os
import time
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import Batch

from benchmarks.harness.result import Figure, Result
from sim_backend.world import engine
from training.environment.design import vftm_dsl
from training.environment.episodes import TaskSource
from training.environment.insertion import Insertions
from training.environment.vector import EndlessInsertions
from training.learning.parallel import ParallelInsertions
from wire.records import TICK_S

CELLS = 256
TICKS = vftm_dsl().ticks_per_step
TARGET = 0.88
WARM_UP = 20


@dataclass(slots=True)
class _Spent:
    ticks: int = 0
    raw_s: float = 0.0
    untimed_s: float = 0.0
    by_tick_s: float = 0.0
    steps_s: float = 0.0
    resets_s: float = 0.0
    resets: int = 0
    cpu_s: float = 0.0


def measure(scale: float) -> Result:
    """Measure; `scale` multiplies the 60 environment steps per row, and the 1200 of a single cell."""
    steps = max(4, int(60 * scale))
    cores = len(os.sched_getaffinity(0))
    settings = sorted({(1, 1), (CELLS, 1), (CELLS, cores), (4 * CELLS, cores)})
    runs = {setting: _run(*setting, steps if setting[0] > 1 else 20 * steps) for setting in settings}
    rows = tuple(
        (
            f"{cells} cell{'s' * (cells > 1)}, {threads} thread{'s' * (threads > 1)}",
            f"{spent.ticks / spent.raw_s / 1e3:.0f}",
            f"{spent.ticks / spent.untimed_s / 1e3:.0f}",
            f"{spent.ticks / spent.by_tick_s / 1e3:.0f}",
            f"{spent.ticks / spent.steps_s / 1e3:.0f}",
            f"{spent.raw_s / spent.steps_s:.2f}",
            f"{spent.untimed_s / spent.steps_s:.2f}",
            f"{spent.resets_s / spent.resets * 1e6:.0f}" if spent.resets else "–",
            f"{spent.ticks / TICKS / (spent.steps_s + spent.resets_s):.0f}",
            f"{spent.ticks / TICKS / spent.cpu_s:.0f}",
        )
        for (cells, threads), spent in runs.items()
    )
    if cores > 1:
        rows += (_workers(cores, steps, runs[CELLS, cores]),)
    batches = {setting: spent for setting, spent in runs.items() if setting[0] > 1}
    ratios = ", ".join(f"{s.raw_s / s.steps_s:.2f} with {c} cells on {t}" for (c, t), s in batches.items())
    single, resets = runs[1, 1], [spent for spent in batches.values() if spent.resets]
    return Result(
        question="How much of raw `Batch.step` does the training environment keep?",
        columns=(
            "batch",
            "raw k/s",
            "untimed k/s",
            "by tick k/s",
            "env k/s",
            "env/raw",
            "env/untimed",
            "µs/reset",
            "steps/s",
            "steps/CPU-s",
        ),
        rows=rows,
        finding=f"Of raw: {ratios} threads.",
        figures=(
            *(
                Figure(f"environment to raw, {c} cells on {t}", s.raw_s / s.steps_s, "of raw", TARGET, at_least=True)
                for (c, t), s in batches.items()
            ),
            Figure("one environment", single.ticks / TICKS / single.cpu_s, "steps/CPU-s", 800.0, at_least=True),
            *(
                Figure("a reset", 1e6 * sum(s.resets_s for s in resets) / sum(s.resets for s in resets), "µs", 300.0)
                for _ in resets[:1]
            ),
        ),
        method=(
            f"{steps} steps of {TICKS} ticks with random actions, 20 times as many of a single cell; before each, the "
            "same states step raw, controls held: in one call as MuJoCo comes; in one call with MuJoCo's timers "
            "stopped, as the environment stops them (untimed); so tick by tick. k/s: thousands of ticks per second, "
            f"a tick being {TICK_S * 1e3:g} ms of one cell. The environment adds law and sensor at every tick, lock, "
            "bounds and observation at every step. steps/s: policy steps, resets included; CPU-s: seconds of all "
            "threads' processor time. The row of workers is several environments of one thread each, in "
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
    ticks_per_s, raw_per_s = per_s * TICKS, raw.ticks / raw.raw_s
    return (
        f"{workers} workers of {CELLS} cells",
        f"{raw_per_s / 1e3:.0f}",
        "–",
        "–",
        f"{ticks_per_s / 1e3:.0f}",
        f"{ticks_per_s / raw_per_s:.2f}",
        "–",
        "–",
        f"{per_s:.0f}",
        "–",
    )


def _run(cells: int, threads: int, steps: int) -> _Spent:
    contract, rng, source = vftm_dsl(), np.random.default_rng(0), TaskSource()
    environment = Insertions(contract, cells, threads=threads)
    batch: Batch = environment.world._batch  # pyright: ignore[reportPrivateUsage]  # the comparison needs it
    environment.reset(np.arange(cells), source.draw(rng, cells))
    spent = _Spent()
    for number in range(WARM_UP + steps):
        raw = _raw(batch)
        action = rng.uniform(-1, 1, (cells, environment.action_size))
        begin, cpu_began = time.perf_counter(), time.process_time()
        outcome = environment.step(action)
        step_s = time.perf_counter() - begin
        ended = np.flatnonzero(outcome.terminated | outcome.truncated)
        begin = time.perf_counter()
        if ended.size:
            environment.reset(ended, source.draw(rng, ended.size))
        reset_s, cpu_s = time.perf_counter() - begin, time.process_time() - cpu_began
        if number < WARM_UP:
            continue
        spent.ticks += TICKS * cells
        spent.raw_s += raw[0]
        spent.untimed_s += raw[1]
        spent.by_tick_s += raw[2]
        spent.steps_s += step_s
        spent.resets_s += reset_s
        spent.resets += ended.size
        spent.cpu_s += cpu_s
    return spent


def _raw(batch: Batch) -> tuple[float, float, float]:
    """Step in one call as MuJoCo comes, in one call without timers, and tick by tick; return the seconds of each.

    All begin with the present state, and leave it.
    """
    state = batch.state.copy()
    spent_s: list[float] = []
    for timers, calls in ((True, 1), (False, 1), (False, TICKS)):
        mujoco.set_mjcb_time(None)  # MuJoCo's own clock
        if not timers:
            engine.stop_timers()
        begin = time.perf_counter()
        for _ in range(calls):
            batch.step(nstep=TICKS // calls)
        spent_s.append(time.perf_counter() - begin)
        batch.state[:] = state
    return spent_s[0], spent_s[1], spent_s[2]
