"""`train`: train an experiment or go on with it."""

import math
import signal
import time
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer

from training.commands.refusal import refuse, refuse_without_extra
from training.learning.experiment import Experiment, ExperimentError, load
from wire.exits import Exit


def train(
    experiment: Annotated[
        str, typer.Argument(help="Name of an experiment in training/experiments, or a file that ends in .toml.")
    ],
    seed: Annotated[
        list[int] | None,
        typer.Option(min=0, help="Seed of the training; may be repeated. Default: those of the experiment."),
    ] = None,
    start_from: Annotated[
        Path | None, typer.Option(help="Weights to begin with (a .pt file) instead of those that the experiment names.")
    ] = None,
    minutes: Annotated[
        float, typer.Option(help="Time limit for all seeds together; the same command goes on afterwards.")
    ] = math.inf,
) -> None:
    """Train an experiment, once for each seed, into var/training/EXPERIMENT/seed-N.

    The same command again goes on where the last one ended.
    """
    try:
        from sim_backend.world import engine
        from training.learning.learn import TrainingError, learn
        from training.learning.parallel import WorkerError
        from training.learning.run import CheckpointError, TrainingRun
    except ImportError as error:
        refuse_without_extra("train", error)
    signal.signal(signal.SIGTERM, _interrupt)
    deadline = time.monotonic() + minutes * 60
    if engine.obstacle():
        typer.echo(engine.describe(), err=True)
    try:
        asked = load(experiment)
        seeds = seed or asked.seeds
        for number, one in enumerate(seeds):
            if number and time.monotonic() >= deadline:
                typer.echo(f"out of time; the same command goes on with seed {', '.join(map(str, seeds[number:]))}")
                break
            run = TrainingRun(asked, one)
            try:
                learn(run, start_from, deadline - time.monotonic())
            except KeyboardInterrupt:
                typer.echo(f"interrupted; the same command goes on from {run.checkpoint}", err=True)
                raise typer.Exit(Exit.INTERRUPTED) from None
            then = f"dsl-assembly export {asked.name} OUT.onnx --seed {one}"
            typer.echo(f"{_state(asked, run.steps)} in {run.directory}; next: {then}")
    except (ExperimentError, CheckpointError, TrainingError, WorkerError) as error:
        refuse("train", str(error))


def _state(experiment: Experiment, steps: int) -> str:
    total = experiment.algorithm.steps
    return "finished" if steps >= total else f"{steps} of {total} steps"


def _interrupt(signum: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt
