"""Export of a trained network to the ONNX file that a cell loads, with normalisation and contract inside."""

import copy
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import onnx
import onnx.helper
import onnx.numpy_helper
import torch
from torch import Tensor, nn
from torch.nn.functional import linear

from service.policy.contract import EvaluationFigure, PolicyContract
from service.policy.model import Policy
from service.safety.contact_loop import why_not_law
from training import files
from training.learning.network import ActorCritic
from wire.arrays import Float32Array

Matrix = Float32Array

OPSET = 17
AGREEMENT = 1e-4
"""Largest allowed difference between the exported graph and the network, for actions and memories in -1 … 1."""
PROBES = 64
LEVELS = 127
"""Largest whole number of one byte as which a weight is stored; every row of a matrix has its own scale."""


class DeterministicActor(nn.Module):
    """Map a raw observation (batch, n), and a recurrent policy's memory (batch, h), to the mean action in -1 … 1."""

    def __init__(self, network: ActorCritic) -> None:
        super().__init__()
        self.network = network

    def forward(self, observation: Tensor, hidden: Tensor | None = None) -> Tensor | tuple[Tensor, Tensor]:
        network = self.network
        perceived = network.encoder(network.normalise(observation))
        if hidden is None:
            return self._action(perceived, network.layer(perceived))
        hidden = gru(network.gru, perceived, hidden)
        return self._action(perceived, hidden), hidden

    def _action(self, perceived: Tensor, hidden: Tensor) -> Tensor:
        return torch.clamp(self.network.act(perceived, hidden)[0], -1.0, 1.0)


def gru(cell: nn.GRUCell, entering: Tensor, hidden: Tensor) -> Tensor:
    """Compute `cell` (Cho et al., 2014, in torch's form) with operators that ONNX has."""
    reset_in, update_in, new_in = linear(entering, cell.weight_ih, cell.bias_ih).chunk(3, 1)
    reset_kept, update_kept, new_kept = linear(hidden, cell.weight_hh, cell.bias_hh).chunk(3, 1)
    reset = torch.sigmoid(reset_in + reset_kept)
    update = torch.sigmoid(update_in + update_kept)
    new = torch.tanh(new_in + reset * new_kept)
    return new + update * (hidden - new)


def record_evaluation(path: Path, figures: Sequence[EvaluationFigure]) -> Policy:
    """Write measured results into a policy's contract; they replace earlier ones of the same conditions.

    The file's hash changes with it.

    Raises:
        service.policy.model.PolicyError: the service would refuse the file; the file stays as it was.
    """
    contract = Policy.load(path).contract
    measured = {(figure.conditions, figure.clearance_m): figure for figure in (*contract.evaluation, *figures)}
    ordered = sorted(measured.values(), key=lambda figure: (figure.conditions, -figure.clearance_m))
    changed = contract.model_copy(update={"evaluation": tuple(ordered)})
    return _write(_with_contract(onnx.load(path), changed), path)


def network_of(contract: PolicyContract, weights: dict[str, Tensor]) -> ActorCritic:
    """Make the network of `weights`, a state dictionary of `ActorCritic`.

    Raises:
        ValueError: the weights belong to another network or to another contract.
    """
    try:
        width, hidden = len(weights["encoder.0.bias"]), weights["aux.0.weight"].shape[1]
        network = ActorCritic(contract, width, hidden, 0.0)
        expected = {name: network.state_dict()[name].clone() for name in ("normalise.scale", "normalise.clip")}
        network.load_state_dict(weights)
    except (KeyError, RuntimeError) as error:
        raise ValueError(f"these weights do not fit the contract {contract.name!r}: {error}") from error
    if contract.hidden_size not in (0, hidden):
        raise ValueError(f"the memory has {hidden} numbers, the contract {contract.name!r} says {contract.hidden_size}")
    for name, tensor in expected.items():
        if not torch.equal(tensor, weights[name]):
            raise ValueError(f"{name} of the weights is not that of the contract {contract.name!r}")
    return network


def to_onnx(network: ActorCritic, contract: PolicyContract) -> bytes:
    """Return the file of a network's deterministic actor with its contract and its weights rounded to one byte.

    Raises:
        ValueError: the exported graph and the rounded network compute different actions.
        service.policy.model.PolicyError: the service would refuse the file.
    """
    network = rounded(network)
    actor = DeterministicActor(network).eval()
    probe = torch.Generator().manual_seed(0)
    observation = torch.randn(PROBES, network.seen, generator=probe) * network.normalise.scale
    hidden = torch.rand(PROBES, network.hidden, generator=probe) * 2.0 - 1.0
    inputs = {"observation": observation} | ({"hidden": hidden} if network.recurrent else {})
    outputs = ["action", *(["next_hidden"] if network.recurrent else [])]
    with tempfile.TemporaryDirectory() as directory, warnings.catch_warnings():
        graph = Path(directory) / "actor.onnx"
        warnings.simplefilter("ignore", DeprecationWarning)  # its successor needs another package
        torch.onnx.export(
            actor,
            tuple(inputs.values()),
            graph,
            input_names=list(inputs),
            output_names=outputs,
            dynamic_axes={name: {0: "batch"} for name in (*inputs, *outputs)},
            opset_version=OPSET,
            dynamo=False,
        )
        data = _with_contract(_packed(onnx.load(graph)), contract)
    with torch.no_grad():
        perceived, remembered = network.remember(observation, hidden)
        wanted = network.act(perceived, remembered)[0].clamp(-1.0, 1.0).numpy()
    action, next_hidden = Policy(data).act(observation.numpy(), hidden.numpy() if network.recurrent else None)
    worst = float(np.abs(action - wanted).max())
    if next_hidden is not None:
        worst = max(worst, float(np.abs(next_hidden - remembered.numpy()).max()))
    if worst > AGREEMENT:
        raise ValueError(f"the exported graph differs from the network by {worst:.2g}")
    return data


def export(network: ActorCritic, contract: PolicyContract, path: Path) -> Policy:
    """Write a network's deterministic actor with its contract, after loading it as a cell would.

    Raises:
        ValueError: the exported graph and the network compute different actions, or the contract's compliance law
            swings; nothing is written.
        service.policy.model.PolicyError: the service would refuse the file; nothing is written.
    """
    if reasons := tuple(why_not_law(contract.compliance)):
        raise ValueError(f"{path} is not written, because no cell would run it: {'; '.join(reasons)}")
    return _write(to_onnx(network, contract), path)


def rounded(network: ActorCritic) -> ActorCritic:
    """Return a copy with matrices rounded to `LEVELS`; the arithmetic stays in single precision."""
    network = copy.deepcopy(network)
    with torch.no_grad():
        for weights in network.parameters():
            if weights.ndim == 2:
                levels, scale = _levels(weights.numpy())
                weights.copy_(torch.from_numpy(levels * scale[:, None]))
    return network


def _levels(weights: Matrix) -> tuple[npt.NDArray[np.int8], Float32Array]:
    """Return the whole numbers (rows, columns) and the scales (rows,) nearest to a matrix of weights."""
    largest = np.abs(weights).max(1)
    scale = np.where(largest > 0.0, largest / LEVELS, 1.0).astype(np.float32)
    return np.rint(weights / scale[:, None]).astype(np.int8), scale


def _packed(document: onnx.ModelProto) -> onnx.ModelProto:
    """Store the matrices of a graph as `_levels` and unpack them inside the graph."""
    graph = document.graph
    for tensor in list(graph.initializer):
        weights = onnx.numpy_helper.to_array(tensor)
        if weights.dtype == np.float32 and weights.ndim == 2:
            graph.initializer.remove(tensor)
            stored = [f"{tensor.name}.levels", f"{tensor.name}.scale"]
            for array, name in zip(_levels(weights), stored, strict=True):
                graph.initializer.append(onnx.numpy_helper.from_array(array, name))
            graph.node.insert(0, onnx.helper.make_node("DequantizeLinear", stored, [tensor.name], axis=0))
    return document


def _with_contract(document: onnx.ModelProto, contract: PolicyContract) -> bytes:
    onnx.helper.set_model_props(document, contract.to_metadata())
    return document.SerializeToString()


def _write(data: bytes, path: Path) -> Policy:
    policy = Policy(data, source=str(path))
    files.write(path, data)
    return policy
