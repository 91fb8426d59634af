"""Teaches the network's estimator where the hole is, from what the simulation knows, beside the reinforcement learning.

The estimator sees only what the policy sees. Reinforcement learning does not train it, and its errors do not reach the
policy's gradient: the policy is handed the estimate as one more observation.
"""

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from torch.nn.functional import mse_loss

from training.insertion import AIM
from training.network import AsymmetricNetwork

CAPACITY = 200_000
"""Samples kept: the latest ones, of a few dozen rollouts."""


class EstimatorTraining(BaseCallback):
    """After each update of the policy, some steps of regression on the latest samples.

    Args:
        batches: gradient steps per rollout.
        batch: samples in each.
        learning_rate: of Adam.
    """

    def __init__(self, batches: int = 60, batch: int = 1024, learning_rate: float = 1e-3) -> None:
        super().__init__()
        self._batches = batches
        self._batch = batch
        self._learning_rate = learning_rate
        self._kept = np.zeros((0, 0), np.float32)
        self._rng = np.random.default_rng(0)
        self.loss = float("nan")

    def _on_training_start(self) -> None:
        network = self.model.policy.mlp_extractor
        assert isinstance(network, AsymmetricNetwork)  # noqa: S101  # `training.learn` builds no other
        self._network = network
        self._optimiser = torch.optim.Adam(network.estimator.parameters(), self._learning_rate)

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        assert isinstance(self.model, PPO)  # noqa: S101  # likewise
        observations = self.model.rollout_buffer.observations
        fresh = observations.reshape(-1, observations.shape[-1])
        kept = self._kept.reshape(-1, fresh.shape[1])[-(CAPACITY - len(fresh)) :]
        self._kept = np.concatenate([kept, fresh])

    def _on_rollout_start(self) -> None:
        # here, not at the rollout's end: a policy must not change between acting and learning from it
        if not len(self._kept):
            return
        network = self._network
        losses: list[float] = []
        for _ in range(self._batches):
            rows = self._rng.integers(len(self._kept), size=self._batch)
            features = torch.as_tensor(self._kept[rows], device=self.model.device)
            seen, hidden = features[:, : network.seen], features[:, network.seen :]
            loss = mse_loss(network.estimator(network.normalise(seen)), hidden[:, AIM])
            self._optimiser.zero_grad()
            loss.backward()
            self._optimiser.step()
            losses.append(loss.item())
        self.loss = float(np.mean(losses))
