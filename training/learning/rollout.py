"""Rollouts for PPO: steps of every cell with the policy's exploration, and the advantages of its actions."""

import time
from dataclasses import dataclass

import torch
from torch import Tensor

from training.environment.vector import Ended, EndlessCells
from training.learning.network import ActorCritic


@dataclass(frozen=True, slots=True)
class Rollout:
    """A rollout of t steps in n cells; tensors (t, n, …).

    Attributes:
        features: observation in raw units, followed by the critic's own features.
        action: drawn action, not cut to -1 … 1.
        log_density: logarithm of the drawn action's density, up to a constant.
        value: return that the critic expected.
        reward: reward of the step.
        begins: 1 where an episode began with this step, else 0.
        ends: 1 where an episode ended with this step, else 0.
        hidden: (n, hidden) memory before the first step.
        last_value: (n,) return that the critic expects after the last step.
        ended: episodes that ended.
        simulating_s: host time spent waiting for the cells.
    """

    features: Tensor
    action: Tensor
    log_density: Tensor
    value: Tensor
    reward: Tensor
    begins: Tensor
    ends: Tensor
    hidden: Tensor
    last_value: Tensor
    ended: Ended
    simulating_s: float

    def advantages(self, gamma: float, gae_lambda: float) -> Tensor:
        """Return generalised advantage estimates (t, n) (Schulman et al., 2016).

        The value after an episode's end is zero, also where its time was up: the limit belongs to the task, and the
        policy observes how much of it has passed.
        """
        advantage = torch.zeros_like(self.reward)
        running = torch.zeros_like(self.last_value)
        next_value = self.last_value
        for t in range(len(self.reward) - 1, -1, -1):
            live = 1.0 - self.ends[t]
            surprise = self.reward[t] + gamma * next_value * live - self.value[t]
            running = surprise + gamma * gae_lambda * live * running
            advantage[t] = running
            next_value = self.value[t]
        return advantage


class Collector:
    """Plays the cells without end and keeps their state between two rollouts."""

    def __init__(self, cells: EndlessCells, network: ActorCritic) -> None:
        self._cells = cells
        self._network = network
        self._features = torch.from_numpy(cells.reset())
        self._hidden = network.initial_hidden(cells.n)
        self._begins = torch.ones(cells.n)

    @torch.no_grad()
    def collect(self, steps: int) -> Rollout:
        """Play `steps` steps of every cell with actions drawn around the policy's mean."""
        cells, network = self._cells, self._network
        features = torch.empty(steps, cells.n, cells.feature_size)
        action = torch.empty(steps, cells.n, cells.action_size)
        log_density, value, reward, begins, ends = (torch.empty(steps, cells.n) for _ in range(5))
        std = network.log_std.exp()
        first_hidden = self._hidden
        ended: list[Ended] = []
        simulating_s = 0.0
        for t in range(steps):
            perceived, hidden = self._remember()
            mean, _ = network.act(perceived, hidden)
            action[t] = mean + std * torch.randn_like(mean)
            features[t], begins[t] = self._features, self._begins
            log_density[t] = network.log_density(action[t], mean)
            value[t] = network.value(self._features, hidden)
            began = time.perf_counter()
            step = cells.step(action[t].clamp(-1.0, 1.0).numpy())
            simulating_s += time.perf_counter() - began
            reward[t] = torch.from_numpy(step.reward)
            self._hidden, self._features = hidden, torch.from_numpy(step.features)
            ends[t] = self._begins = torch.from_numpy(step.done).float()
            ended.append(step.ended)
        last_value = network.value(self._features, self._remember()[1])
        return Rollout(
            features,
            action,
            log_density,
            value,
            reward,
            begins,
            ends,
            first_hidden,
            last_value,
            Ended.joined(ended),
            simulating_s,
        )

    def _remember(self) -> tuple[Tensor, Tensor]:
        forgetting = self._hidden * (1.0 - self._begins)[:, None]
        return self._network.remember(self._features[:, : self._network.seen], forgetting)
