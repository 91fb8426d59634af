"""Training end to end: steps per second, and the share of the ticks in the time."""

import contextlib
import io
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.harness.result import Figure, Result
from benchmarks.harness.stopwatch import timed
from sim_backend.world.world import World
from training.environment.vector import EndlessInsertions
from training.learning import ppo
from training.learning.experiment import Experiment, load
from training.learning.learn import learn
from training.learning.rollout import Collector
from training.learning.run import TrainingRun

EXPERIMENT = "vftm-dsl"


@dataclass(frozen=True, slots=True)
class Share:
    """Distribution of the time of a training in one process, without the evaluations before and after it.

    Attributes:
        steps: policy steps of all cells.
        cells: number of cells stepped at once.
        ticks_s: time in the ticks: physics, law and sensor.
        environment_s: time in the environment, ticks and resets included.
        collecting_s: time in the rollouts, environment included.
        updates_s: time in gradient updates.
    """

    steps: int
    cells: int
    ticks_s: float
    environment_s: float
    collecting_s: float
    updates_s: float

    @property
    def total_s(self) -> float:
        return self.collecting_s + self.updates_s


def measure(scale: float) -> Result:
    """Measure; `scale` multiplies the four rollouts with their updates."""
    rollouts = max(1, round(4 * scale))
    share = one_process(rollouts)
    parts = {
        "ticks: physics, law, sensor": share.ticks_s,
        "the rest of the environment, resets": share.environment_s - share.ticks_s,
        "policy in the rollout, buffers": share.collecting_s - share.environment_s,
        "gradient updates": share.updates_s,
    }
    workers = len(os.sched_getaffinity(0))
    rate = steps_per_s(workers, rollouts)
    return Result(
        question="Where does the time of training go?",
        columns=("part", "s", "share"),
        rows=(
            *((name, f"{spent:.2f}", f"{spent / share.total_s:.0%}") for name, spent in parts.items()),
            ("all, one process", f"{share.total_s:.2f}", "100%"),
            (f"all, {workers} workers", f"{share.steps / rate:.2f}", "–"),
        ),
        finding=f"{share.steps / share.total_s:.0f} policy steps per second end to end in one process, ticks are "
        f"{share.ticks_s / share.total_s:.0%} of it; {rate:.0f} with {workers} workers.",
        figures=(Figure("training, one process", share.steps / share.total_s, "steps/s", 1600.0, at_least=True),),
        method=f"{rollouts} rollouts of {share.cells} cells x {load(EXPERIMENT).algorithm.rollout} steps with updates, "
        f"experiment {EXPERIMENT}, from a fresh network: episodes begin together, so contact is rarer than later on.",
    )


def one_process(rollouts: int, cells: int | None = None) -> Share:
    """Train for some rollouts with one worker; `cells` overrides the experiment's number."""
    here = _shortened(load(EXPERIMENT), 1, rollouts, cells)
    with (
        timed(World, "advance") as ticks,
        timed(EndlessInsertions, "step") as environment,
        timed(Collector, "collect") as collecting,
        timed(ppo, "update") as updates,
    ):
        _train(here)
    first, last = collecting.calls[0][0], updates.calls[-1][1]
    return Share(
        here.algorithm.steps,
        here.algorithm.cells,
        sum(end - begin for begin, end in ticks.calls if first <= begin < last),
        environment.spent_s,
        collecting.spent_s,
        updates.spent_s,
    )


def steps_per_s(workers: int, rollouts: int, cells: int | None = None) -> float:
    """Train for some rollouts; return policy steps per second end to end, for all `cells` of all workers together."""
    records = _train(_shortened(load(EXPERIMENT), workers, rollouts, cells))
    ends = [record for record in records if record["kind"] == "rollout"]
    return len(ends) / sum(1.0 / record["steps_per_s"] for record in ends)


def _shortened(experiment: Experiment, workers: int, rollouts: int, cells: int | None = None) -> Experiment:
    """Return `experiment` from a fresh network, with other workers, for a few rollouts and minimal evaluation."""
    cells = (cells or experiment.algorithm.cells) // workers * workers
    steps = cells * experiment.algorithm.rollout * rollouts
    return experiment.model_copy(
        update={
            "start_from": None,
            "algorithm": experiment.algorithm.model_copy(update={"workers": workers, "cells": cells, "steps": steps}),
            "evaluation": experiment.evaluation.model_copy(
                update={"episodes": 1, "every_steps": steps, "clearances_mm": (2.0,)}
            ),
        }
    )


def _train(experiment: Experiment) -> list[dict[str, Any]]:
    """Train, and return the records of its progress."""
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        run = TrainingRun(experiment, 0, Path(folder))
        learn(run)
        return run.records()
