"""Training end to end: steps per second, and what share is physics."""

import contextlib
import io
import os
import tempfile
from pathlib import Path
from typing import Any

from mujoco.batch import Batch

from benchmarks.result import Result
from benchmarks.stopwatch import timed
from training import ppo
from training.experiment import Experiment, load
from training.learn import learn
from training.rollout import Collector
from training.run import Run
from training.vector import EndlessInsertions

EXPERIMENT = "vftm-dsl"


def measure(scale: float) -> Result:
    """Measure; `scale` multiplies the four rollouts with their updates."""
    rollouts = max(1, round(4 * scale))
    here = _shortened(load(EXPERIMENT), 1, rollouts)
    with (
        timed(Batch, "step") as physics,
        timed(EndlessInsertions, "step") as environment,
        timed(Collector, "collect") as collecting,
        timed(ppo, "update") as updates,
    ):
        _train(here)
    total_s = collecting.spent_s + updates.spent_s
    first, last = collecting.calls[0][0], updates.calls[-1][1]  # the evaluations before and after are no part of it
    physics_s = sum(end - begin for begin, end in physics.calls if first <= begin < last)
    parts = {
        "physics (`Batch.step`)": physics_s,
        "the rest of the environment, resets": environment.spent_s - physics_s,
        "policy in the rollout, buffers": collecting.spent_s - environment.spent_s,
        "gradient updates": updates.spent_s,
    }
    cores = len(os.sched_getaffinity(0))
    spread = _shortened(load(EXPERIMENT), cores, rollouts)
    ends = [record for record in _train(spread) if record["kind"] == "rollout"]
    steps = here.algorithm.steps
    rate = len(ends) / sum(1.0 / record["steps_per_s"] for record in ends)
    return Result(
        question="Where does the time of training go?",
        columns=("part", "s", "share"),
        rows=(
            *((name, f"{spent:.2f}", f"{spent / total_s:.0%}") for name, spent in parts.items()),
            ("all, one process", f"{total_s:.2f}", "100%"),
            (f"all, {cores} workers", f"{spread.algorithm.steps / rate:.2f}", "–"),
        ),
        finding=f"{steps / total_s:.0f} policy steps per second end to end in one process, physics is "
        f"{physics_s / total_s:.0%} of it; {rate:.0f} with {cores} workers.",
        method=f"{rollouts} rollouts of {here.algorithm.cells} cells x {here.algorithm.rollout} steps with updates, "
        f"experiment {EXPERIMENT}, from a fresh network: episodes begin together, so contact is rarer than later on.",
    )


def _shortened(experiment: Experiment, workers: int, rollouts: int) -> Experiment:
    """Return `experiment` on other processes, for a few rollouts and with next to no evaluation."""
    cells = experiment.algorithm.cells // workers * workers
    steps = cells * experiment.algorithm.rollout * rollouts
    return experiment.model_copy(
        update={
            "algorithm": experiment.algorithm.model_copy(update={"workers": workers, "cells": cells, "steps": steps}),
            "evaluation": experiment.evaluation.model_copy(
                update={"episodes": 1, "every_steps": steps, "clearances_mm": (2.0,)}
            ),
        }
    )


def _train(experiment: Experiment) -> list[dict[str, Any]]:
    """Train, and return the records of its progress."""
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        run = Run(experiment, 0, Path(folder))
        learn(run)
        return run.records()
