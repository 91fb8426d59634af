"""Builds small real ONNX policies, whole and broken."""

from collections.abc import Sequence

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from service.policy.contract import ActionEntry, ObservationEntry, PolicyContract
from service.safety.dsl import DslParameters
from wire.law import ComplianceLaw

LAW = ComplianceLaw(
    stiffness=(800.0,) * 3 + (10.0,) * 3, damping=(400.0,) * 3 + (1.0,) * 3, inertia=(2.0,) * 3 + (0.02,) * 3
)
ACTION = (
    ActionEntry(name="dx", unit="m", frame="tool", limit=3e-3, map="signed_square"),
    ActionEntry(name="dy", unit="m", frame="tool", limit=3e-3, map="signed_square"),
    ActionEntry(name="dz", unit="m", frame="base", limit=1.5e-3, map="linear"),
    ActionEntry(name="dyaw", unit="rad", frame="base", limit=0.14, map="linear"),
)
OBSERVATION = (
    ObservationEntry.of("hole_offset_xy", scale=0.01, clip=5.0),
    ObservationEntry.of("height", scale=0.02),
    ObservationEntry.of("force_mean", scale=(5.0, 5.0, 10.0), history=3),
)


def contract(**changes: object) -> PolicyContract:
    fields: dict[str, object] = {
        "name": "test policy",
        "parts": ("tr",),
        "clearance_m": (0.3e-3, 2.0e-3),
        "mode": "VFTM",
        "ticks_per_step": 40,
        "max_steps": 110,
        "observation": OBSERVATION,
        "action": ACTION,
        "dsl": DslParameters(),
        "compliance": LAW,
        "wrench_window_ticks": 40,
    }
    return PolicyContract.model_validate(fields | changes)


def linear_model(
    document: PolicyContract | None = None,
    *,
    weights: np.ndarray | None = None,
    observation_name: str = "observation",
    observation_size: int | None = None,
    batch: int | str = "batch",
    dtype: int = TensorProto.FLOAT,
    opset: int = 17,
    activation: str = "Tanh",
    metadata: dict[str, str] | None = None,
    extra_nodes: Sequence[onnx.NodeProto] = (),
) -> onnx.ModelProto:
    """`action = activation(observation @ W)`, `next_hidden = tanh(hidden + mean(observation))`."""
    document = document or contract()
    size = observation_size or document.observation_size
    actions = len(document.action)
    kind = helper.tensor_dtype_to_np_dtype(dtype)
    if weights is None:
        weights = np.random.default_rng(0).normal(scale=0.1, size=(size, actions))
    nodes = [
        helper.make_node("MatMul", [observation_name, "W"], ["product"]),
        helper.make_node(activation, ["product"], ["action"]),
    ]
    inputs = [helper.make_tensor_value_info(observation_name, dtype, [batch, size])]
    outputs = [helper.make_tensor_value_info("action", dtype, [batch, actions])]
    if document.hidden_size:
        nodes += [
            helper.make_node("ReduceMean", [observation_name], ["level"], axes=[1], keepdims=1),
            helper.make_node("Add", ["hidden", "level"], ["sum"]),
            helper.make_node("Tanh", ["sum"], ["next_hidden"]),
        ]
        inputs.append(helper.make_tensor_value_info("hidden", dtype, [batch, document.hidden_size]))
        outputs.append(helper.make_tensor_value_info("next_hidden", dtype, [batch, document.hidden_size]))
    graph = helper.make_graph(
        [*nodes, *extra_nodes], "policy", inputs, outputs, [numpy_helper.from_array(weights.astype(kind), "W")]
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=8)
    for key, value in (document.to_metadata() if metadata is None else metadata).items():
        model.metadata_props.add(key=key, value=value)
    return model


HANGS = ("load", "first", "later")


def hanging_model(document: PolicyContract, when: str) -> onnx.ModelProto:
    """A policy that asks for nothing, in a graph whose loop does not end.

    Args:
        document: with `height` as its third number, and one recurrent number.
        when: `load`, at every inference; `first`, at the first one of a real run; `later`, at the fourth of a run.
    """
    make = helper.make_node
    triggers = {
        "load": [make("Greater", ["one", "nothing"], ["hangs"])],
        "first": _away_from_trial("hangs"),
        "later": [make("Greater", ["hidden", "steps"], ["hangs"])],
    }
    number = helper.make_tensor_value_info
    body = helper.make_graph(
        [make("Identity", ["condition"], ["goes_on"]), make("Identity", ["in"], ["out"])],
        "body",
        [
            number("turn", TensorProto.INT64, []),
            number("condition", TensorProto.BOOL, []),
            number("in", TensorProto.FLOAT, [None, None]),
        ],
        [number("goes_on", TensorProto.BOOL, []), number("out", TensorProto.FLOAT, [None, None])],
    )
    nodes = [
        make("MatMul", ["observation", "W"], ["product"]),
        *triggers[when],
        make("Where", ["hangs", "ever", "never"], ["turns"]),
        make("Reshape", ["turns", "scalar"], ["times"]),
        make("Loop", ["times", "yes", "product"], ["action"], body=body),
        make("Add", ["hidden", "one"], ["next_hidden"]),
    ]
    return _recurrent(document, nodes)


def greedy_model(document: PolicyContract) -> onnx.ModelProto:
    """A policy of a few hundred bytes that wants 16 GiB."""
    make = helper.make_node
    nodes = [
        make("ConstantOfShape", ["huge"], ["much"]),
        make("ReduceSum", ["much"], ["sum"], keepdims=0),
        make("MatMul", ["observation", "W"], ["product"]),
        make("Add", ["product", "sum"], ["action"]),
        make("Add", ["hidden", "one"], ["next_hidden"]),
    ]
    return _recurrent(document, nodes)


def failing_model(document: PolicyContract) -> onnx.ModelProto:
    """A policy that answers with NaN in a real run, and with zero when it is tried at loading."""
    make = helper.make_node
    nodes = [
        make("MatMul", ["observation", "W"], ["product"]),
        *_away_from_trial("fails"),
        make("Where", ["fails", "nan", "nil"], ["bad"]),
        make("Add", ["product", "bad"], ["action"]),
        make("Add", ["hidden", "one"], ["next_hidden"]),
    ]
    return _recurrent(document, nodes)


def _away_from_trial(name: str) -> list[onnx.NodeProto]:
    """Tell whether the height is other than in the trial at loading: zero, plus and minus the scale."""
    make = helper.make_node
    return [
        make("Gather", ["observation", "third"], ["height"], axis=1),
        make("Abs", ["height"], ["size"]),
        make("Sub", ["size", "scale"], ["above"]),
        make("Mul", ["size", "above"], ["both"]),
        make("Abs", ["both"], ["odd"]),
        make("Greater", ["odd", "nothing"], [name]),
    ]


def _recurrent(document: PolicyContract, nodes: Sequence[onnx.NodeProto]) -> onnx.ModelProto:
    """Build a model of a batch of one whose hidden state counts its steps."""
    scale = next(entry.scale for entry in document.observation if entry.name == "height")
    constants = {
        "W": np.zeros((document.observation_size, len(document.action)), np.float32),
        "one": np.ones(1, np.float32),
        "nil": np.zeros(1, np.float32),
        "nan": np.full(1, np.nan, np.float32),
        "huge": np.array([2**32]),
        "third": np.array([2]),
        "never": np.array([0]),
        "ever": np.array([2**62]),
        "scale": np.array([scale], np.float32),
        "nothing": np.array([1e-9], np.float32),
        "steps": np.array([2.5], np.float32),
        "yes": np.array(True),
        "scalar": np.array([], np.int64),
    }
    number = helper.make_tensor_value_info
    sizes = {"observation": document.observation_size, "hidden": 1, "action": len(document.action), "next_hidden": 1}
    ends = {name: number(name, TensorProto.FLOAT, [1, size]) for name, size in sizes.items()}
    graph = helper.make_graph(
        list(nodes),
        "recurrent",
        [ends["observation"], ends["hidden"]],
        [ends["action"], ends["next_hidden"]],
        [numpy_helper.from_array(value, name) for name, value in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    for key, value in document.to_metadata().items():
        model.metadata_props.add(key=key, value=value)
    return model
