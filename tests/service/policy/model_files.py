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
