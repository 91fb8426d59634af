"""`train`: train an experiment, or go on with it."""

import math
import signal
from pathlib import Path
from types import FrameType
from typing import Annotated, NoReturn

import typer

from training.experiment import Experiment, ExperimentError, load

EXIT_USAGE = 2
EXIT_INTERRUPTED = 130


def train(
    experiment: Annotated[
        str, typer.Argument(help="Name of one in training/experiments, or a file that ends in .toml.")
    ],
    seed: Annotated[
        list[int] | None,
        typer.Option(min=0, help="Of the training; may be repeated. Default: those of the experiment."),
    ] = None,
    start_from: Annotated[
        Path | None, typer.Option(help="Weights to begin with (a .pt), in place of what the experiment says.")
    ] = None,
    minutes: Annotated[
        float, typer.Option(help="End this session after so long; the same command goes on.")
    ] = math.inf,
) -> None:
    """Train an experiment, once for each seed, into var/training/EXPERIMENT/seed-N.

    The same command again goes on where the last one ended, however that was.
    """
    try:
        from training.learn import TrainingError, learn
        from training.parallel import WorkerError
        from training.run import CheckpointError, Run
    except ImportError as error:
        _fail(f"training needs the extra `training` ({error}): make setup-training")
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        asked = load(experiment)
        for one in seed or asked.seeds:
            run = Run(asked, one)
            try:
                learn(run, start_from, minutes * 60)
            except KeyboardInterrupt:
                typer.echo(f"interrupted; the same command goes on from {run.checkpoint}", err=True)
                raise typer.Exit(EXIT_INTERRUPTED) from None
            then = f"dsl-assembly export {asked.name} OUT.onnx --seed {one}"
            typer.echo(f"{_state(asked, run.steps)} in {run.directory}; next: {then}")
    except (ExperimentError, CheckpointError, TrainingError, WorkerError) as error:
        _fail(str(error))


def _state(experiment: Experiment, steps: int) -> str:
    total = experiment.algorithm.steps
    return "finished" if steps >= total else f"{steps} of {total} steps"


def _interrupt(signum: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _fail(text: str) -> NoReturn:
    typer.echo(f"training: {text}", err=True)
    raise typer.Exit(EXIT_USAGE)
