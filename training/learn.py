"""PPO with stable-baselines3 on the insertions."""

import sys
import time
from collections import deque
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from tqdm import tqdm

from service.policy.contract import PolicyContract
from training.episodes import TaskSource
from training.estimator import EstimatorTraining
from training.insertion import Insertions
from training.network import InsertionPolicy
from training.parallel import ParallelInsertions
from training.recipe import Recipe
from training.vector import InsertionVecEnv


class Progress(BaseCallback):
    """Says one line per rollout, into `log.txt` too, and writes checkpoints; `deadline_s` ends the training early."""

    def __init__(
        self, directory: Path, estimator: EstimatorTraining, deadline_s: float = float("inf"), every: int = 200_000
    ) -> None:
        super().__init__()
        self._estimator = estimator
        self._directory = directory
        self._deadline = deadline_s
        self._every = every
        self._next = every
        self._begin = time.monotonic()
        self._recent: deque[dict[str, Any]] = deque(maxlen=500)
        self._simulating = 0.0
        self._rollout_began = 0.0
        self._done = 0
        self._bar: tqdm[Any] | None = None

    def _on_training_start(self) -> None:
        total = int(self.locals["total_timesteps"])
        self._bar = tqdm(total=total, unit=" steps", unit_scale=True, disable=None)  # none where nobody looks

    def _on_training_end(self) -> None:
        if self._bar is not None:
            self._bar.close()

    def _on_rollout_start(self) -> None:
        self._rollout_began = time.monotonic()

    def _on_rollout_end(self) -> None:
        now = time.monotonic()
        self._simulating += now - self._rollout_began
        elapsed = now - self._begin
        recent = self._recent
        if recent:
            success = np.mean([r["is_success"] for r in recent])
            peak = np.percentile([r["peak_force"] for r in recent], [50, 99])
            line = (
                f"{self.num_timesteps:9d} steps {elapsed:6.0f} s {self.num_timesteps / elapsed:6.0f}/s "
                f"(simulation {self._simulating / elapsed:.0%}) success {success:.3f} "
                f"steps/episode {np.mean([r['episode']['l'] for r in recent]):5.1f} "
                f"return {np.mean([r['episode']['r'] for r in recent]):6.2f} "
                f"peak force {peak[0]:4.1f} / {peak[1]:4.1f} N faults {np.mean([r['fault'] for r in recent]):.3f} "
                f"estimator {self._estimator.loss:.3f}"
            )
            tqdm.write(line)
            sys.stdout.flush()
            with (self._directory / "log.txt").open("a") as log:
                log.write(line + "\n")
        if self._bar is not None:
            self._bar.update(self.num_timesteps - self._done)
            self._done = self.num_timesteps
        if self.num_timesteps >= self._next:
            self._next += self._every
            save(self.model, self._directory / "checkpoint.zip")

    def _on_step(self) -> bool:
        self._recent.extend(info for info in self.locals["infos"] if "episode" in info)
        return time.monotonic() - self._begin < self._deadline


def save(model: BaseAlgorithm, path: Path) -> None:
    """Write a model in one go: whoever reads `path` finds the old one or the new one."""
    fresh = path.with_suffix(".new.zip")
    model.save(fresh)
    fresh.replace(path)


def build(contract: PolicyContract, tasks: TaskSource, recipe: Recipe) -> PPO:
    """Make an untrained model and its environment, whose `close` is the caller's."""
    make = partial(_environment, contract, tasks, recipe)
    return PPO(
        InsertionPolicy,
        make(0) if recipe.workers == 1 else ParallelInsertions(make, recipe.workers),
        learning_rate=lambda left: recipe.learning_rate * (0.1 + 0.9 * left),
        n_steps=recipe.rollout,
        batch_size=recipe.batch,
        n_epochs=recipe.epochs,
        gamma=recipe.gamma,
        gae_lambda=recipe.gae_lambda,
        ent_coef=recipe.entropy,
        target_kl=recipe.target_kl,
        seed=recipe.seed,
        device=recipe.device,
        policy_kwargs={
            "contract": contract,
            "hidden": list(recipe.hidden),
            "log_std_init": recipe.initial_log_std,
            "share_features_extractor": True,
        },
    )


def learn(
    contract: PolicyContract,
    tasks: TaskSource,
    recipe: Recipe,
    directory: Path,
    start_from: Path | None = None,
    deadline_s: float = float("inf"),
) -> PPO:
    """Train a policy; checkpoints and the final model go to `directory`.

    Args:
        contract: what the policy sees and does.
        tasks: what it is trained on.
        recipe: how.
        directory: is made if it does not exist.
        start_from: a model saved by an earlier run, whose weights this one begins with.
        deadline_s: seconds after which the training ends with what it has.
    """
    directory.mkdir(parents=True, exist_ok=True)
    if recipe.torch_threads:
        torch.set_num_threads(recipe.torch_threads)
    model = build(contract, tasks, recipe)
    estimator = EstimatorTraining()
    environment = model.get_env()
    if start_from is not None:
        earlier = PPO.load(start_from, device=recipe.device)
        model.set_parameters(cast(Any, earlier.get_parameters()))
    try:
        model.learn(recipe.steps, callback=[estimator, Progress(directory, estimator, deadline_s)])
        save(model, directory / "final.zip")
    except KeyboardInterrupt:
        save(model, directory / "checkpoint.zip")
        raise
    finally:
        if environment is not None:
            environment.close()
    return model


def _environment(contract: PolicyContract, tasks: TaskSource, recipe: Recipe, worker: int) -> InsertionVecEnv:
    cells = Insertions(contract, recipe.cells // recipe.workers, tasks.part, recipe.threads, reward_name=recipe.reward)
    return InsertionVecEnv(cells, tasks, recipe.seed * 1000 + worker)
