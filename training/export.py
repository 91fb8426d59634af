"""From a trained network to the file that a cell loads: ONNX, normalisation inside, contract in the metadata."""

import tempfile
import warnings
from pathlib import Path

import numpy as np
import onnx
import torch
from stable_baselines3 import PPO
from torch import Tensor, nn

from service.policy.contract import PolicyContract
from service.policy.model import Policy
from training.network import AsymmetricNetwork

OPSET = 17
AGREEMENT = 1e-4
"""Largest difference between an action of the exported graph and of the network, in the action's -1 … 1."""


class DeterministicActor(nn.Module):
    """Raw observation (batch, n) to the mean action (batch, k), cut to -1 … 1."""

    def __init__(self, model: PPO) -> None:
        super().__init__()
        network = model.policy.mlp_extractor
        assert isinstance(network, AsymmetricNetwork)  # noqa: S101  # `training.learn` builds no other
        self.normalise, self.actor, self.head = network.normalise, network.actor, model.policy.action_net

    def forward(self, observation: Tensor) -> Tensor:
        return torch.clamp(self.head(self.actor(self.normalise(observation))), -1.0, 1.0)


def export(model: PPO, contract: PolicyContract, path: Path) -> Policy:
    """Write a model's deterministic actor with its contract, and load it back as a cell would.

    Raises:
        ValueError: the exported graph does not compute what the network computes; nothing is written.
        service.policy.model.PolicyError: the service would refuse the file.
    """
    actor = DeterministicActor(model).cpu().eval()
    example = torch.randn(64, contract.observation_size) * actor.normalise.scale
    with tempfile.TemporaryDirectory() as directory, warnings.catch_warnings():
        graph = Path(directory) / "actor.onnx"
        warnings.simplefilter("ignore", DeprecationWarning)  # the exporter that takes its place needs another package
        torch.onnx.export(
            actor,
            (example,),
            graph,
            input_names=["observation"],
            output_names=["action"],
            dynamic_axes={"observation": {0: "batch"}, "action": {0: "batch"}},
            opset_version=OPSET,
            dynamo=False,
        )
        document = onnx.load(graph)
    for key, value in contract.to_metadata().items():
        document.metadata_props.add(key=key, value=value)
    data = document.SerializeToString()
    policy = Policy(data, source=str(path))
    with torch.no_grad():
        want = actor(example).numpy()
    got, _ = policy.act(example.numpy())
    worst = float(np.abs(got - want).max())
    if worst > AGREEMENT:
        raise ValueError(f"the exported graph differs from the network by {worst:.2g}; nothing written to {path}")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return policy
