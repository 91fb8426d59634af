"""The network: an actor that sees what the cell measures, a critic that may also see what only the simulation knows.

Normalisation belongs to the graph: the actor takes raw physical units, divides by the contract's scales and cuts at its
clips, in training and in the exported model alike. An estimator of the hole's pose, taught by `training.estimator`, is
part of the actor's graph.
"""

from itertools import pairwise
from typing import Any

import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import Tensor, nn

from service.policy.contract import PolicyContract
from training.insertion import AIM, PRIVILEGED_SIZE


class Normalisation(nn.Module):
    """Raw observation (batch, size) to about -1 … 1, by the contract's scales and clips."""

    scale: Tensor
    clip: Tensor

    def __init__(self, contract: PolicyContract) -> None:
        super().__init__()
        scale: list[float] = []
        clip: list[float] = []
        for entry in contract.observation:
            scales = entry.scale if isinstance(entry.scale, tuple) else (entry.scale,) * entry.size
            scale += list(scales) * entry.history
            clip += [entry.clip if entry.clip is not None else float("inf")] * (entry.size * entry.history)
        self.register_buffer("scale", torch.tensor(scale))
        self.register_buffer("clip", torch.tensor(clip))

    def forward(self, observation: Tensor) -> Tensor:
        return torch.minimum(torch.maximum(observation / self.scale, -self.clip), self.clip)


def _layers(sizes: list[int]) -> nn.Sequential:
    modules: list[nn.Module] = []
    for before, after in pairwise(sizes):
        modules += [nn.Linear(before, after), nn.ELU()]
    return nn.Sequential(*modules)


class AsymmetricNetwork(nn.Module):
    """Both towers, in the form that stable-baselines3 asks of a custom network."""

    def __init__(self, contract: PolicyContract, hidden: list[int]) -> None:
        super().__init__()
        self.normalise = Normalisation(contract)
        self.seen = len(self.normalise.scale)
        aims = AIM.stop - AIM.start
        self.estimator = nn.Sequential(_layers([self.seen, 256, 128]), nn.Linear(128, aims))
        self.actor = _layers([self.seen + aims, *hidden])
        self.critic = _layers([self.seen + PRIVILEGED_SIZE, *hidden])
        self.latent_dim_pi = self.latent_dim_vf = hidden[-1]

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        return self.forward_actor(features), self.forward_critic(features)

    def forward_actor(self, features: Tensor) -> Tensor:
        return self.act_on(features[:, : self.seen])

    def act_on(self, observation: Tensor) -> Tensor:
        """Last hidden layer of the actor, from a raw observation: with the estimate of the hole as a further input."""
        seen = self.normalise(observation)
        return self.actor(torch.cat([seen, self.estimator(seen).detach()], dim=1))

    def forward_critic(self, features: Tensor) -> Tensor:
        return self.critic(torch.cat([self.normalise(features[:, : self.seen]), features[:, self.seen :]], dim=1))


class InsertionPolicy(ActorCriticPolicy):
    """stable-baselines3's actor-critic on the network above."""

    def __init__(self, *args: Any, contract: PolicyContract, hidden: list[int], **kwargs: Any) -> None:
        self._contract, self._hidden = contract, hidden
        super().__init__(*args, **kwargs)

    def _build_mlp_extractor(self) -> None:
        network = AsymmetricNetwork(self._contract, self._hidden).to(self.device)
        self.mlp_extractor = network  # pyright: ignore[reportAttributeAccessIssue]  # its documented extension point
