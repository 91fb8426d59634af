"""Baselines for learned policies: a scripted compliant search, and a policy that asks for nothing.

Both are ONNX files with a contract, like any policy, and run in the same service. The search is the classical one. It
spirals about the estimated hole, sweeps the yaw over its possible range and presses lightly. When the tip has dropped,
sideways motion and sweep end, and the compliance lets the peg in.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, get_args

import numpy as np
import numpy.typing as npt
import onnx
from onnx import TensorProto, helper

from service.policy.contract import ObservationEntry, PolicyContract
from service.policy.observation import ObservationMode
from training.environment import design
from wire.modes import LockMode
from wire.task import Part

OPSET = 17
CLEARANCE_M = (0.05e-3, 6e-3)
"""Admitted clearances: every one that a world can have."""

_LIMITS = {entry.name: entry.limit for entry in design.contract_for().action}
_SEEN = ("time_fraction", "hole_offset_xy", "height", "contact_height_known", "yaw")


@dataclass(frozen=True, slots=True)
class Search:
    """Numbers of the scripted search; a step is a policy step of 0.1 s.

    Attributes:
        begin: step at which spiral and sweep begin, near the first contact.
        radius_m: radius at the spiral's end. Radius and angle grow with the root of time, which keeps speed and pitch
            constant.
        turns: turns of the spiral from `begin` to the last step.
        sweep_rad: turn per step.
        sweep_half_range_rad: largest turn on either side of the start yaw.
        press_m: command below the measured height, in addition to the lock's while it seeks.
        dropped_m: depth below the first contact at which the tip has dropped into the hole.
    """

    begin: int = 7
    radius_m: float = 2.0e-3
    turns: float = 1.5
    sweep_rad: float = math.radians(5.0)
    sweep_half_range_rad: float = math.radians(62.0)
    press_m: float = 1.5e-3
    dropped_m: float = 1.0e-3


ABOUT_ESTIMATE = Search()
ABOUT_NOMINAL_CENTRE = Search(radius_m=10.0e-3, turns=4.0)
"""Search for FTM, whose hole is anywhere within the search domain."""


def scripted_search(
    mode: ObservationMode = "VFTM", lock: LockMode = "sliding", max_steps: int = design.MAX_STEPS
) -> bytes:
    """Return the file of the scripted search.

    Args:
        mode: VFTM spirals about the camera's estimate, FTM about the nominal centre.
        lock: lock that it runs under. It does best with `sliding`: the script itself presses with at most 4.5 N.
        max_steps: largest number of steps of an episode.

    Raises:
        ValueError: another mode.
    """
    if mode not in ("VFTM", "FTM"):
        raise ValueError(f"the scripted search is for VFTM and FTM, not for {mode}")
    search = ABOUT_ESTIMATE if mode == "VFTM" else ABOUT_NOMINAL_CENTRE
    contract = _contract("scripted-search" if mode == "VFTM" else "scripted-search-ftm", mode, lock, max_steps, search)
    return _document(_search_graph(search, contract), contract)


def still() -> bytes:
    """Return the file of a policy whose action is always zero; only the paper's lock brings the peg down."""
    contract = _contract("still", "VFTM", "paper", design.MAX_STEPS, None)
    graph = _Graph()
    nothing = graph.constant(np.zeros((contract.observation_size, len(contract.action)), np.float32))
    graph.add("MatMul", "observation", nothing, output="action")
    return _document(graph, contract)


class _Graph:
    """Nodes and constants of an ONNX graph, which names every value."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []

    def constant(self, value: npt.NDArray[Any]) -> str:
        name = f"constant{len(self.constants)}"
        self.constants.append(onnx.numpy_helper.from_array(value, name))
        return name

    def add(self, operator: str, *inputs: str | float, output: str = "", **attributes: Any) -> str:
        """Add a node; numbers among `inputs` become constants. Returns the name of its result."""
        output = output or f"value{len(self.nodes)}"
        names = [entry if isinstance(entry, str) else self.constant(np.array([entry], np.float32)) for entry in inputs]
        self.nodes.append(helper.make_node(operator, names, [output], **attributes))
        return output

    def split(self, source: str, sizes: Sequence[int]) -> list[str]:
        """Cut (batch, n) into columns of `sizes`."""
        outputs = [f"part{i}" for i in range(len(sizes))]
        self.nodes.append(
            helper.make_node("Split", [source, self.constant(np.array(sizes, np.int64))], outputs, axis=1)
        )
        return outputs


def _search_graph(search: Search, contract: PolicyContract) -> _Graph:
    graph = _Graph()
    add = graph.add
    time, offset_x, offset_y, height, known, yaw = graph.split("observation", [1] * contract.observation_size)
    steps = contract.max_steps - search.begin
    step = add("Relu", add("Sub", add("Mul", time, float(contract.max_steps)), float(search.begin)))

    root = add("Sqrt", add("Min", add("Div", step, float(steps)), 1.0))
    radius = add("Mul", root, search.radius_m)
    bearing = add("Sub", add("Mul", root, math.tau * search.turns), yaw)  # seen from the tool
    free = add("Sub", 1.0, _dropped(graph, height, known, search))
    aside = [
        _share(graph, free, add("Add", offset, add("Mul", radius, add(axis, bearing))), _LIMITS["dx"])
        for offset, axis in ((offset_x, "Cos"), (offset_y, "Sin"))
    ]

    # a triangle wave: 0 at first, then up to 1, down to -1 and back
    phase = add("Mod", add("Add", add("Mul", step, search.sweep_rad / search.sweep_half_range_rad), 3.0), 4.0, fmod=1)
    wave = add("Sub", add("Abs", add("Sub", phase, 2.0)), 1.0)
    turn = add("Sub", add("Mul", wave, search.sweep_half_range_rad), yaw)
    turned = _share(graph, free, turn, _LIMITS["dyaw"])

    press = add("Sub", add("Mul", free, 0.0), search.press_m / _LIMITS["dz"])
    together = add("Concat", *aside, press, turned, axis=1)
    add("Clip", together, -1.0, 1.0, output="action")
    return graph


def _dropped(graph: _Graph, height: str, known: str, search: Search) -> str:
    """Add a value that is 1 once the tip has dropped below the first contact, and 0 before."""
    add = graph.add
    low = add("And", add("Greater", known, 0.5), add("Less", height, -search.dropped_m))
    return add("Cast", low, to=int(TensorProto.FLOAT))


def _share(graph: _Graph, free: str, displacement: str, limit: float) -> str:
    """Add a displacement as a share of the action's limit, zero unless `free`."""
    return graph.add("Mul", free, graph.add("Div", displacement, limit))


def _contract(
    name: str, mode: ObservationMode, lock: LockMode, max_steps: int, search: Search | None
) -> PolicyContract:
    trained = design.contract_for(mode, lock, get_args(Part), clearance_m=CLEARANCE_M, max_steps=max_steps, name=name)
    return trained.model_copy(
        update={
            "observation": tuple(ObservationEntry.of(entry) for entry in _SEEN),
            "action": tuple(entry.model_copy(update={"map": "linear"}) for entry in trained.action),
            "provenance": {
                "script": "training.baseline",  # its name when the files that ship were written
                "search": None if search is None else asdict(search),
            },
        }
    )


def _document(graph: _Graph, contract: PolicyContract) -> bytes:
    def tensor(name: str, size: int) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", size])

    model = helper.make_model(
        helper.make_graph(
            graph.nodes,
            contract.name,
            [tensor("observation", contract.observation_size)],
            [tensor("action", len(contract.action))],
            graph.constants,
        ),
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=10,
    )
    helper.set_model_props(model, contract.to_metadata())
    onnx.checker.check_model(model)
    return model.SerializeToString()
