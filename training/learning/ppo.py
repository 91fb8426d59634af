"""Proximal policy optimisation (Schulman et al., 2017) over sequences, with an auxiliary loss on the hole's place."""

from dataclasses import dataclass

import torch
from torch import nn

from training.environment.insertion import AIM
from training.learning.experiment import AlgorithmSection
from training.learning.network import ActorCritic
from training.learning.rollout import Rollout

CLIP = 0.2
VALUE_WEIGHT = 0.5
GRADIENT_NORM = 0.5
EXCESS_WEIGHT = 0.05
"""Weight of the squared excess of a mean action over ±1: exploration does not return from far outside."""


@dataclass(frozen=True, slots=True)
class Losses:
    """Mean losses over an update.

    Attributes:
        policy_loss: clipped surrogate objective, negated.
        value_loss: squared error of the critic.
        auxiliary_loss: squared error of the guessed place of the hole, in the units of `Insertions.privileged`.
        kl: estimated divergence from the policy that acted, nats.
        clipped: share of the samples whose ratio was clipped.
    """

    policy_loss: float
    value_loss: float
    auxiliary_loss: float
    kl: float
    clipped: float


def update(
    network: ActorCritic, optimiser: torch.optim.Optimizer, rollout: Rollout, algorithm: AlgorithmSection
) -> Losses:
    """Improve the network on a rollout in `epochs` passes over minibatches of whole sequences."""
    advantages = rollout.advantages(algorithm.gamma, algorithm.gae_lambda)
    returns = advantages + rollout.value
    said: list[torch.Tensor] = []
    for _ in range(algorithm.epochs):
        for cells in torch.randperm(rollout.reward.shape[1]).tensor_split(algorithm.minibatches):
            features = rollout.features[:, cells]
            perceived, hidden = network.remember_sequence(
                features[..., : network.seen], rollout.hidden[cells], rollout.begins[:, cells]
            )
            mean, guess = network.act(perceived, hidden)
            change = network.log_density(rollout.action[:, cells], mean) - rollout.log_density[:, cells]
            ratio = change.exp()
            advantage = advantages[:, cells]
            advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
            policy_loss = -torch.min(ratio * advantage, ratio.clamp(1 - CLIP, 1 + CLIP) * advantage).mean()
            value_loss = ((network.value(features, hidden) - returns[:, cells]) ** 2).mean()
            truth = features[..., network.seen :][..., AIM]
            auxiliary_loss = ((guess - truth) ** 2).mean()
            excess_loss = ((mean.abs() - 1.0).clamp(min=0.0) ** 2).mean()
            loss = (
                policy_loss
                + VALUE_WEIGHT * value_loss
                - algorithm.entropy * network.log_std.sum()
                + algorithm.auxiliary_weight * auxiliary_loss
                + EXCESS_WEIGHT * excess_loss
            )
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(network.parameters(), GRADIENT_NORM)
            optimiser.step()
            with torch.no_grad():
                kl = (ratio - 1.0 - change).mean()  # Schulman's unbiased estimate that is never negative
                clipped = ((ratio - 1.0).abs() > CLIP).float().mean()
                said.append(torch.stack([policy_loss, value_loss, auxiliary_loss, kl, clipped]))
    return Losses(*(float(mean) for mean in torch.stack(said).mean(0)))
