"""From nothing to a policy in a cell, in one script: train, export, let a cell check the file, run it.

    python examples/train_export_deploy.py                  # a minute or two on two cores
    python examples/train_export_deploy.py --steps 1000     # seconds: hardly trained, but the whole way

The experiment is a toy: easy conditions, a wide hole, the nominal plant, a small network. A policy of so few steps need
not insert. For a real one change `conditions`, `clearance_mm` and `randomise_plant` of the task, take the network's
default size and millions of steps: docs/how-to/train-a-policy.md, and `dsl-assembly train vftm-dsl-fast` to begin with.
"""

import argparse
import asyncio
import tempfile
from pathlib import Path

from service.messages import Refused, StartRequest
from service.testing import RECIPE, cell_config, lockstep_cell
from training.learning.experiment import Experiment
from training.learning.export import export
from training.learning.learn import learn
from training.learning.run import TrainingRun

CLEARANCE_M = 3e-3


def experiment(steps: int) -> Experiment:
    """Describe the training; `training/experiments/*.toml` are such descriptions as files."""
    return Experiment.model_validate(
        {
            "name": "example",
            "title": "A first look at training",
            "task": {"clearance_mm": [3.0, 3.0], "conditions": "easy", "randomise_plant": False, "max_steps": 45},
            "policy": {"press_mm": 3.0},  # how far below the depth lock a command may go
            "algorithm": {
                "steps": steps,
                "width": 64,
                "hidden": 64,
                "cells": 48,
                "rollout": 16,
                "learning_rate": 3e-3,
                "epochs": 8,
                "minibatches": 2,
                "gamma": 0.95,
                "gae_lambda": 0.8,
            },
            "evaluation": {"every_steps": steps, "episodes": 10, "clearances_mm": [3.0]},
        }
    )


async def deploy(policy: Path, folder: Path) -> None:
    """Put the file in two recipes of a cell in lockstep: one that it does not fit, one that it does."""
    config = cell_config(folder / "state", policy, clearance_m=CLEARANCE_M, conditions="easy")
    fitting = config.recipes[RECIPE]
    recipes = {"tight": fitting.model_copy(update={"clearance_m": 0.1e-3}), RECIPE: fitting}
    async with lockstep_cell(config.model_copy(update={"recipes": recipes})) as bench:
        # The cell compares the contract in the file with the recipe, and refuses a start that does not fit.
        answer = await bench.cell.start(StartRequest(recipe="tight", seed=0))
        if not isinstance(answer, Refused):
            raise SystemExit("a recipe far tighter than the training was accepted")
        print(f"check   recipe tight: {answer.problem.reason}, {answer.problem.detail}")
        for seed in (0, 3):
            run = await bench.insert(seed)
            end = "inserted" if run.code is None else f"{run.code}: {run.text}"
            print(f"deploy  seed {seed}: {end}; {run.steps} steps, peak force {run.peak_force_n:.1f} N")


def main() -> None:
    """Go the whole way in a temporary folder."""
    options = argparse.ArgumentParser(description="Train, export, check and deploy a policy.")
    options.add_argument("--steps", type=int, default=20_000, help="environment steps of the training")
    asked = experiment(options.parse_args().steps)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print(f"train   {asked.algorithm.steps} steps of {asked.algorithm.cells} simulated cells")
        network = learn(TrainingRun(asked, seed=0, directory=folder / "training"))
        policy = export(network, asked.contract(), folder / "example.onnx")
        print(f"export  {policy.source}: {policy.contract.name}, SHA-256 {policy.sha256[:12]}…")
        asyncio.run(deploy(folder / "example.onnx", folder))


if __name__ == "__main__":  # the training's worker processes import this file
    main()
