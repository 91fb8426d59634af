"""Training end to end: steps per second, and what share is physics."""

import contextlib
import io
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from mujoco.batch import Batch
from stable_baselines3 import PPO

from benchmarks.result import Result
from benchmarks.stopwatch import timed
from training.design import vftm_dsl
from training.episodes import TaskSource
from training.learn import Recipe, learn
from training.vector import InsertionVecEnv


def measure(scale: float) -> Result:
    """Measure; `scale` multiplies the four rollouts with their updates."""
    recipe = replace(Recipe(), workers=1, threads=0)  # physics in this process, where it can be timed
    rollouts = max(1, round(4 * scale))
    recipe = replace(recipe, steps=recipe.cells * recipe.rollout * rollouts)
    with (
        timed(Batch, "step") as physics,
        timed(InsertionVecEnv, "step_wait") as environment,
        timed(PPO, "train") as updates,
        tempfile.TemporaryDirectory() as folder,
        contextlib.redirect_stdout(io.StringIO()),
    ):
        learn(vftm_dsl(), TaskSource(), recipe, Path(folder))
        total_s = time.perf_counter() - environment.calls[0][0]
    parts = {
        "physics (`Batch.step`)": physics.spent_s,
        "the rest of the environment": environment.spent_s - physics.spent_s,
        "policy in the rollout, buffers": total_s - environment.spent_s - updates.spent_s,
        "gradient updates": updates.spent_s,
    }
    return Result(
        question="Where does the time of training go?",
        columns=("part", "s", "share"),
        rows=(
            *((name, f"{spent:.2f}", f"{spent / total_s:.0%}") for name, spent in parts.items()),
            ("all", f"{total_s:.2f}", "100%"),
        ),
        finding=f"{recipe.steps / total_s:.0f} policy steps per second end to end; physics is "
        f"{physics.spent_s / total_s:.0%} of it.",
        method=f"{rollouts} rollouts of {recipe.cells} cells x {recipe.rollout} steps with the recipe's updates, "
        f"from a fresh network, {recipe.threads or 'all'} threads of physics.",
    )
