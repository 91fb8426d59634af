"""From a trained network to the file that a cell loads: ONNX, normalisation inside, contract in the metadata."""

import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnx
import onnx.helper
import torch
from stable_baselines3 import PPO
from torch import Tensor, nn

from service.policy.contract import EvaluationFigure, PolicyContract
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
        self.network, self.head = network, model.policy.action_net

    def forward(self, observation: Tensor) -> Tensor:
        return torch.clamp(self.head(self.network.act_on(observation)), -1.0, 1.0)


def contract_of(model: PPO) -> PolicyContract:
    """Return the contract that a model was trained under; it is saved with the model."""
    contract = model.policy_kwargs["contract"]
    assert isinstance(contract, PolicyContract)  # noqa: S101  # `training.learn` builds no other
    return contract


def record_evaluation(path: Path, figures: Sequence[EvaluationFigure]) -> Policy:
    """Write measured results into a policy's contract, in place of earlier ones of the same conditions.

    The file's hash changes with it.

    Raises:
        service.policy.model.PolicyError: the service would refuse the file; it is left as it was.
    """
    contract = Policy.load(path).contract
    measured = {(figure.conditions, figure.clearance_m): figure for figure in (*contract.evaluation, *figures)}
    ordered = sorted(measured.values(), key=lambda figure: (figure.conditions, -figure.clearance_m))
    document = onnx.load(path)
    return _write(document, contract.model_copy(update={"evaluation": tuple(ordered)}), path)


def export(model: PPO, contract: PolicyContract, path: Path) -> Policy:
    """Write a model's deterministic actor with its contract, and load it back as a cell would.

    Raises:
        ValueError: the exported graph does not compute what the network computes; nothing is written.
        service.policy.model.PolicyError: the service would refuse the file.
    """
    actor = DeterministicActor(model).cpu().eval()
    example = torch.randn(64, contract.observation_size) * actor.network.normalise.scale
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
    policy = Policy(_with_contract(document, contract), source=str(path))
    with torch.no_grad():
        want = actor(example).numpy()
    got, _ = policy.act(example.numpy())
    worst = float(np.abs(got - want).max())
    if worst > AGREEMENT:
        raise ValueError(f"the exported graph differs from the network by {worst:.2g}; nothing written to {path}")
    return _write(document, contract, path)


def _with_contract(document: onnx.ModelProto, contract: PolicyContract) -> bytes:
    onnx.helper.set_model_props(document, contract.to_metadata())
    return document.SerializeToString()


def _write(document: onnx.ModelProto, contract: PolicyContract, path: Path) -> Policy:
    """Write the file in one go, once it has loaded as a cell would load it."""
    data = _with_contract(document, contract)
    policy = Policy(data, source=str(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    fresh = path.with_name(path.name + ".new")
    fresh.write_bytes(data)
    fresh.replace(path)
    return policy
