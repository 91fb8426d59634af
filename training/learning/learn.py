"""The training: rollouts, updates, evaluations, and a checkpoint after each update."""

import math
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from training.environment.vector import Ended
from training.learning import ppo
from training.learning.experiment import Experiment, ExperimentError
from training.learning.export import network_of, to_onnx
from training.learning.network import ActorCritic
from training.learning.parallel import start
from training.learning.rollout import Collector, Rollout
from training.learning.run import CheckpointError, TrainingRun, beginning, contract_in, directory_of, read, save
from training.learning.validation import score, validate
from training.learning.worker import make_cells

RECENT = 500
"""Number of latest episodes that a line of progress averages."""
ADAM_EPSILON = 1e-5


class TrainingError(RuntimeError):
    """A training cannot go on; the text says why."""


def learn(run: TrainingRun, start_from: Path | None = None, deadline_s: float = float("inf")) -> ActorCritic:
    """Train one experiment and seed, or go on with it; all files go to the run's folder.

    Args:
        run: experiment, seed and folder.
        start_from: weights to begin with; None: those that the experiment names, if any.
        deadline_s: host time after which this session ends; the next session goes on from its checkpoint.

    Raises:
        ExperimentError: the experiment is no longer the one that the folder's training began with.
        CheckpointError: the weights to begin with are missing or of another network, or the training began with others.
        TrainingError: the training diverged; the checkpoint is the last good one.
        WorkerError: a worker's process ended or failed.
    """
    torch.set_num_threads(1)  # the cells' processes use the cores, and an update by several threads is no faster
    training = _Training(run, start_from)
    try:
        training.go_on(deadline_s)
    finally:
        training.close()
    return training.policy


def untrained(experiment: Experiment, seed: int) -> ActorCritic:
    """Return the network that a training begins with."""
    torch.manual_seed(seed)
    algorithm = experiment.algorithm
    return ActorCritic(experiment.contract(), algorithm.width, algorithm.hidden, algorithm.initial_log_std)


class _Training:
    """The state of a training under way."""

    def __init__(self, run: TrainingRun, start_from: Path | None) -> None:
        self._run = run
        self._experiment = run.experiment
        self._algorithm = run.experiment.algorithm
        self._contract = run.experiment.contract()
        self.network = untrained(run.experiment, run.seed)
        self._optimiser = torch.optim.Adam(self.network.parameters(), self._algorithm.learning_rate, eps=ADAM_EPSILON)
        average = cast(Callable[..., None], get_ema_multi_avg_fn(self._algorithm.averaging))
        self._averaged = AveragedModel(self.network, multi_avg_fn=average)
        self._steps, self._earlier_s, self._evaluated = 0, 0.0, -1
        self._best = (-1.0, 0.0)
        checkpoint = read(run.checkpoint) if run.checkpoint.is_file() else None
        if checkpoint is None:
            weights = start_from or self._named_start()
            self._load(weights)
            run.open(0, None if weights is None else beginning(weights))
        elif start_from is not None and run.began_with != beginning(start_from):
            raise CheckpointError(
                f"{run.directory} did not begin with the weights of {start_from}: "
                "leave out --start-from to go on with it, or move the folder away to begin anew"
            )
        else:
            self._check_contract(checkpoint)
            run.open(checkpoint["steps"])
            self._restore(checkpoint)
        if checkpoint is None:
            self._averaged.update_parameters(self.network)
        self._cells = start(partial(make_cells, self._experiment, run.seed, self._steps), self._algorithm.workers)
        self._board = SummaryWriter(run.directory / "tensorboard", purge_step=self._steps)
        self._recent: Ended | None = None
        self._began = time.monotonic()

    def go_on(self, deadline_s: float) -> None:
        """Alternate rollouts and updates to the end."""
        total = self._algorithm.steps
        if self._steps >= total:
            return
        collector = Collector(self._cells, self.network)
        bar = tqdm(total=total, initial=self._steps, unit=" steps", unit_scale=True, disable=None)
        with bar:
            if self._evaluated < 0:
                self._evaluate()
            while self._steps < total and time.monotonic() - self._began < deadline_s:
                began = time.monotonic()
                for group in self._optimiser.param_groups:
                    group["lr"] = self._algorithm.learning_rate * (1.0 - 0.9 * self._steps / total)
                rollout = collector.collect(self._algorithm.rollout)
                losses = ppo.update(self.network, self._optimiser, rollout, self._algorithm)
                if not (all(map(math.isfinite, asdict(losses).values())) and self.network.finite):
                    raise TrainingError(f"diverged at {self._steps} steps: {losses}; try a smaller learning_rate")
                self._averaged.update_parameters(self.network)
                self._steps += rollout.reward.numel()
                bar.update(rollout.reward.numel())
                self._note(rollout, losses, time.monotonic() - began, bar)
                due = self._steps // self._experiment.evaluation.every_steps
                if due > self._evaluated // self._experiment.evaluation.every_steps or self._steps >= total:
                    self._evaluate()
                self._checkpoint()

    def close(self) -> None:
        self._cells.close()
        self._board.close()

    @property
    def policy(self) -> ActorCritic:
        """Running average of the weights (Polyak & Juditsky, 1992): the result of a training."""
        return cast(ActorCritic, self._averaged.module)

    @property
    def _elapsed_s(self) -> float:
        """Host time of all sessions."""
        return self._earlier_s + time.monotonic() - self._began

    def _note(self, rollout: Rollout, losses: ppo.Losses, spent_s: float, bar: "tqdm[Any]") -> None:
        """Log the progress of the training over the latest episodes."""
        recent = Ended.joined([self._recent, rollout.ended] if self._recent else [rollout.ended]).latest(RECENT)
        self._recent = recent
        figures: dict[str, float] = {
            "steps_per_s": rollout.reward.numel() / spent_s,
            "simulation_share": rollout.simulating_s / spent_s,
            "episodes": len(recent),
            **asdict(losses),
            "std": float(self.network.log_std.detach().exp().mean()),
            "learning_rate": self._optimiser.param_groups[0]["lr"],
        }
        if len(recent):
            median, p99 = np.percentile(recent.peak_force, [50, 99]).tolist()
            figures |= {
                "success": float(recent.success.mean()),
                "fault": float(recent.fault.mean()),
                "episode_steps": float(recent.steps.mean()),
                "episode_return": float(recent.episode_return.mean()),
                "peak_force_median_n": median,
                "peak_force_p99_n": p99,
            }
            bar.set_postfix(success=f"{figures['success']:.1%}", force=f"{p99:.1f} N")
        self._add("rollout", "rollout", figures)

    def _evaluate(self) -> None:
        """Play the validation's episodes; keep the weights if they are the best so far."""
        validations = validate(self._experiment, to_onnx(self.policy, self._contract), self._cells)
        for validation in validations:
            record = validation.record()
            self._add("evaluation", f"evaluation/{validation.part} {validation.clearance_m * 1e3:.2f} mm", record)
        told = ", ".join(f"{v.part} {v.clearance_m * 1e3:.2f} mm {v.success:.1%}" for v in validations)
        tqdm.write(
            f"{self._experiment.name} seed {self._run.seed}: {self._steps} steps, {self._elapsed_s:.0f} s: {told}"
        )
        sys.stdout.flush()
        reached = score(validations)
        if reached > self._best:
            self._best = reached
            save(
                self._run.best,
                {
                    **self._weights(),
                    "score": list(reached),
                    "evaluation": self._judged_at(),
                    "validation": [validation.record() for validation in validations],
                },
            )
        self._evaluated = self._steps

    def _add(self, kind: str, tag: str, figures: dict[str, Any]) -> None:
        numbers = {name: round(value, 6) if isinstance(value, float) else value for name, value in figures.items()}
        self._run.add({"kind": kind, "steps": self._steps, "elapsed_s": round(self._elapsed_s, 2), **numbers})
        for name, value in figures.items():
            if not isinstance(value, str):
                self._board.add_scalar(f"{tag}/{name}", value, self._steps)

    def _weights(self) -> dict[str, Any]:
        return {
            "net": self.policy.state_dict(),
            "steps": self._steps,
            "elapsed_s": self._elapsed_s,
            "contract": self._contract.to_json(),
        }

    def _checkpoint(self) -> None:
        save(
            self._run.checkpoint,
            {
                **self._weights(),
                "learning": self.network.state_dict(),
                "optimiser": self._optimiser.state_dict(),
                "evaluated": self._evaluated,
                "random": torch.get_rng_state(),
            },
        )

    def _check_contract(self, document: dict[str, Any]) -> None:
        """Raise ExperimentError if the experiment's contract differs from the checkpoint's in more than its use."""
        now, then = self._contract, contract_in(document)
        if then is None or then.model_copy(update={"parts": now.parts, "clearance_m": now.clearance_m}) != now:
            raise ExperimentError(
                f"{self._run.checkpoint} was trained under another contract than {now.name!r} has by now: "
                f"move {self._run.directory} away, or give the experiment another name"
            )

    def _restore(self, document: dict[str, Any]) -> None:
        self.network.load_state_dict(document["learning"])
        self.policy.load_state_dict(document["net"])
        self._averaged.n_averaged += 1
        self._optimiser.load_state_dict(document["optimiser"])
        torch.set_rng_state(document["random"])
        self._steps, self._earlier_s = document["steps"], document["elapsed_s"]
        self._evaluated = document["evaluated"]
        best = read(self._run.best) if self._run.best.is_file() else None
        if best is not None and best.get("evaluation", self._judged_at()) == self._judged_at():
            self._best = tuple(best["score"])

    def _judged_at(self) -> dict[str, Any]:
        """Return the settings of an evaluation; scores compare only under equal settings."""
        return self._experiment.evaluation.model_dump(mode="json", exclude={"every_steps"})

    def _named_start(self) -> Path | None:
        name = self._experiment.start_from
        return None if name is None else directory_of(name, self._run.seed) / "best.pt"

    def _load(self, path: Path | None) -> None:
        """Begin with these weights, if any, and with the exploration of a fresh training."""
        if path is None:
            return
        try:
            self.network.load_state_dict(network_of(self._contract, read(path)["net"]).state_dict())
        except (ValueError, RuntimeError) as error:
            raise CheckpointError(f"cannot begin with {path}: {error}") from error
        with torch.no_grad():
            self.network.log_std.clamp_(min=self._algorithm.initial_log_std)
