"""The network: an actor that observes the cell, and a critic that also observes the state of the simulation.

Normalisation belongs to the graph: the actor takes raw physical units, divides by the contract's scales and cuts at its
clips, in training and in the exported model alike. An auxiliary head learns to locate the hole from the actor's memory.
The actor receives its guess, but the actor's gradient does not reach the head.
"""

import torch
from torch import Tensor, nn

from service.policy.contract import PolicyContract
from training.environment.insertion import AIM, PRIVILEGED_SIZE

AIMS = AIM.stop - AIM.start
HEAD_SHRINK = 0.05
"""Factor on the action's last layer at the start: an untrained policy hardly moves beyond its exploration."""


class Normalisation(nn.Module):
    """Scale a raw observation (..., size) to about -1 … 1 by the contract's scales and clips."""

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


class ActorCritic(nn.Module):
    """Actor, auxiliary head and critic that share one memory.

    Args:
        contract: contract of the policy; with `hidden_size` 0 a feed-forward layer replaces the memory.
        width: width of the encoder.
        hidden: width of the memory, or of that layer.
        initial_log_std: logarithm of the exploration's deviation at the start, for every component.

    Attributes:
        seen: length of the policy's part of the features; the critic's own `PRIVILEGED_SIZE` follow it.
        hidden: width of the memory.
        recurrent: the network has a memory.
        log_std: (k,) logarithm of the exploration's deviation.
    """

    def __init__(self, contract: PolicyContract, width: int, hidden: int, initial_log_std: float) -> None:
        super().__init__()
        actions = len(contract.action)
        self.normalise = Normalisation(contract)
        self.seen = contract.observation_size
        self.hidden = hidden
        self.recurrent = contract.hidden_size > 0
        self.encoder = nn.Sequential(nn.Linear(self.seen, width), nn.ELU())
        if self.recurrent:
            self.gru = nn.GRUCell(width, hidden)
        else:
            self.layer = nn.Sequential(nn.Linear(width, hidden), nn.ELU())
        self.aux = nn.Sequential(nn.Linear(hidden, 64), nn.ELU(), nn.Linear(64, AIMS))
        last = nn.Linear(128, actions)
        with torch.no_grad():
            last.weight *= HEAD_SHRINK
            last.bias.zero_()
        self.head = nn.Sequential(nn.Linear(hidden + width + AIMS, 128), nn.ELU(), last)
        self.log_std = nn.Parameter(torch.full((actions,), initial_log_std))
        self.critic = nn.Sequential(
            nn.Linear(self.seen + PRIVILEGED_SIZE + hidden, 256),
            nn.ELU(),
            nn.Linear(256, 128),
            nn.ELU(),
            nn.Linear(128, 1),
        )

    @property
    def finite(self) -> bool:
        """True if every parameter is finite."""
        return all(bool(weights.isfinite().all()) for weights in self.parameters())

    def initial_hidden(self, cells: int) -> Tensor:
        """Return the memory at the beginning of an episode, (cells, hidden)."""
        return torch.zeros(cells, self.hidden)

    def remember(self, observation: Tensor, hidden: Tensor) -> tuple[Tensor, Tensor]:
        """Process one step.

        Args:
            observation: (n, seen) raw.
            hidden: (n, hidden) memory before it.

        Returns:
            The encoded observation (n, width) and the memory after it (n, hidden).
        """
        perceived = self.encoder(self.normalise(observation))
        return perceived, self.gru(perceived, hidden) if self.recurrent else self.layer(perceived)

    def remember_sequence(self, observation: Tensor, hidden: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Process steps in a row: as `remember`, for observations (t, n, seen).

        Args:
            observation: raw.
            hidden: (n, hidden) before the first.
            begins: (t, n) 1 where an episode begins with this step, which clears the memory; else 0.

        Returns:
            The encoded observations (t, n, width) and the memory after each step (t, n, hidden).
        """
        perceived = self.encoder(self.normalise(observation))
        if not self.recurrent:
            return perceived, self.layer(perceived)
        kept = (1.0 - begins)[..., None]
        memories: list[Tensor] = []
        for step, keep in zip(perceived, kept, strict=True):
            hidden = self.gru(step, hidden * keep)
            memories.append(hidden)
        return perceived, torch.stack(memories)

    def act(self, perceived: Tensor, hidden: Tensor) -> tuple[Tensor, Tensor]:
        """Return the mean action (..., k), not cut, and the auxiliary head's guess (..., AIMS)."""
        guess = self.aux(hidden)
        return self.head(torch.cat([hidden, perceived, guess.detach()], -1)), guess

    def value(self, features: Tensor, hidden: Tensor) -> Tensor:
        """Return the expected return (...) of features (..., seen + PRIVILEGED_SIZE), without training the memory."""
        seen, privileged = features[..., : self.seen], features[..., self.seen :]
        return self.critic(torch.cat([self.normalise(seen), privileged, hidden.detach()], -1))[..., 0]

    def log_density(self, action: Tensor, mean: Tensor) -> Tensor:
        """Return the logarithm of the exploration's density (...) at `action`, up to a constant."""
        return (-0.5 * ((action - mean) / self.log_std.exp()) ** 2 - self.log_std).sum(-1)
