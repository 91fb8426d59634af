import hashlib
import os
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import TensorProto, helper, numpy_helper

from service.policy import model as model_module
from service.policy.contract import METADATA_KEY
from service.policy.model import SIZE_LIMIT_BYTES, Policy, PolicyError, PolicyFault
from tests.service.policy.model_files import contract, linear_model

SIZE = contract().observation_size
SHIPPED = Path(__file__).parents[3] / "models"


def refused(model: onnx.ModelProto | bytes) -> PolicyError:
    with pytest.raises(PolicyError) as refusal:
        Policy(model if isinstance(model, bytes) else model.SerializeToString(), source="model.onnx")
    assert "model.onnx" in refusal.value.text
    return refusal.value


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "policy.onnx"
    path.write_bytes(linear_model().SerializeToString())
    return path


def test_a_policy_runs_what_its_file_says(path: Path) -> None:
    weights = np.linspace(-1, 1, SIZE * 4).reshape(SIZE, 4)
    path.write_bytes(linear_model(weights=weights).SerializeToString())
    policy = Policy.load(path)
    observation = np.linspace(0, 1, SIZE).astype(np.float32)
    action, hidden = policy.act(observation)
    np.testing.assert_allclose(action, np.tanh(observation @ weights), rtol=1e-5)
    assert action.shape == (4,)
    assert hidden is None
    assert policy.initial_hidden() is None
    assert policy.contract == contract()


@pytest.mark.parametrize("shipped", sorted(SHIPPED.glob("*.onnx")), ids=lambda shipped: shipped.stem)
def test_stored_levels_are_unpacked_at_load_and_the_action_is_that_of_the_plain_graph_bit_for_bit(
    tmp_path: Path, shipped: Path
) -> None:
    options = model_module.session_options()
    options.optimized_model_filepath = str(tmp_path / "loaded.onnx")
    onnxruntime.InferenceSession(shipped.read_bytes(), options, providers=["CPUExecutionProvider"])
    loaded = onnx.load(options.optimized_model_filepath)
    assert "DequantizeLinear" not in {node.op_type for node in loaded.graph.node}
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # two threads share a product in another order
    plain = onnxruntime.InferenceSession(shipped.read_bytes(), options, providers=["CPUExecutionProvider"])
    policy = Policy.load(shipped)
    draws = np.random.default_rng(0)
    for rows in (1, 1, 1, 2, 3, 5, 8, 17, 64, 256):
        size = draws.choice([0.01, 0.1, 1.0, 10.0])
        feed = {
            node.name: (size * draws.normal(size=(rows, node.shape[1]))).astype(np.float32)
            for node in plain.get_inputs()
        }
        action, hidden = policy.act(feed["observation"], feed.get("hidden"))
        for mine, its in zip((action, hidden), plain.run(None, feed), strict=False):
            assert mine is not None
            assert mine.tobytes() == its.tobytes()


@pytest.mark.parametrize("shape", [(1,), (7,), (2, 3)])
def test_a_batch_acts_as_its_elements_do(path: Path, shape: tuple[int, ...]) -> None:
    policy = Policy.load(path)
    observation = np.random.default_rng(0).normal(size=(*shape, SIZE)).astype(np.float32)
    action, _ = policy.act(observation)
    assert action.shape == (*shape, 4)
    for index in np.ndindex(shape):
        np.testing.assert_allclose(action[index], policy.act(observation[index])[0], rtol=1e-5, atol=1e-6)


def test_recurrent_state_goes_in_and_comes_out() -> None:
    policy = Policy(linear_model(contract(hidden_size=5)).SerializeToString())
    hidden = policy.initial_hidden((3,))
    assert hidden is not None
    assert hidden.shape == (3, 5)
    observation = np.ones((3, SIZE), np.float32)
    level = 0.0
    for _ in range(3):
        _, hidden = policy.act(observation, hidden)
        level = np.tanh(level + 1.0)
    np.testing.assert_allclose(hidden, np.full((3, 5), level), rtol=1e-5)  # pyright: ignore


@pytest.mark.parametrize("hidden", [None, np.zeros((2, 5)), np.full(5, np.nan)])
def test_a_recurrent_state_that_does_not_fit_is_refused(hidden: Any) -> None:
    policy = Policy(linear_model(contract(hidden_size=5)).SerializeToString())
    with pytest.raises(PolicyError) as refusal:
        policy.act(np.ones(SIZE, np.float32), hidden)
    assert refusal.value.reason is PolicyFault.INVALID_OBSERVATION


# The file


def test_the_hash_is_of_the_bytes_that_run_even_when_the_file_is_replaced(path: Path) -> None:
    data = path.read_bytes()
    policy = Policy.load(path)
    before, _ = policy.act(np.ones(SIZE, np.float32))
    path.write_bytes(linear_model(weights=np.zeros((SIZE, 4))).SerializeToString())
    after, _ = policy.act(np.ones(SIZE, np.float32))
    assert policy.sha256 == hashlib.sha256(data).hexdigest()
    np.testing.assert_array_equal(before, after)
    with pytest.raises(PolicyError) as refusal:
        Policy.load(path, expected_sha256=policy.sha256)
    assert refusal.value.reason is PolicyFault.HASH


def test_the_expected_hash_admits(path: Path) -> None:
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    assert Policy.load(path, expected_sha256=digest).sha256 == digest


@pytest.mark.parametrize("name", ["missing.onnx", "."])
def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(PolicyError) as refusal:
        Policy.load(tmp_path / name)
    assert refusal.value.reason is PolicyFault.UNREADABLE


def test_an_oversized_file_is_refused_without_reading_all_of_it(tmp_path: Path) -> None:
    path = tmp_path / "huge.onnx"
    with path.open("wb") as file:
        os.truncate(file.fileno(), 50 * SIZE_LIMIT_BYTES)
    with pytest.raises(PolicyError) as refusal:
        Policy.load(path)
    assert refusal.value.reason is PolicyFault.TOO_LARGE


@pytest.mark.parametrize("data", [b"", b"not a model", b"\x00" * 100, b"\xff" * 100])
def test_bytes_that_are_no_model_are_corrupt(data: bytes) -> None:
    assert refused(data).reason is PolicyFault.CORRUPT


def test_a_model_cut_short_anywhere_is_refused() -> None:
    data = linear_model().SerializeToString()
    for length in range(0, len(data), 97):
        refused(data[:length])


def test_a_model_with_any_byte_turned_is_refused_or_loads_and_never_crashes() -> None:
    data = linear_model().SerializeToString()
    rng = np.random.default_rng(0)
    for position in rng.integers(0, len(data), 200):
        broken = bytearray(data)
        broken[position] ^= int(rng.integers(1, 256))
        try:
            Policy(bytes(broken))
        except PolicyError:
            continue


def test_weights_in_another_file_are_refused(tmp_path: Path) -> None:
    model = linear_model(weights=np.ones((SIZE, 4)))
    onnx.save(model, tmp_path / "p.onnx", save_as_external_data=True, location="weights.bin", size_threshold=0)
    with pytest.raises(PolicyError) as refusal:
        Policy.load(tmp_path / "p.onnx")
    assert refusal.value.reason is PolicyFault.EXTERNAL_DATA


def test_weights_in_another_file_are_found_inside_a_constant_too() -> None:
    tensor = numpy_helper.from_array(np.ones(4, np.float32), "hidden_away")
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value="/etc/hostname")
    inner = helper.make_graph(
        [helper.make_node("Constant", [], ["c"], value=tensor)],
        "inner",
        [],
        [helper.make_tensor_value_info("c", TensorProto.FLOAT, [4])],
    )
    branch = helper.make_node("If", ["truth"], ["unused"], then_branch=inner, else_branch=inner)
    truth = helper.make_node("Constant", [], ["truth"], value=numpy_helper.from_array(np.array(True), "t"))
    assert refused(linear_model(extra_nodes=[truth, branch])).reason is PolicyFault.EXTERNAL_DATA


@pytest.mark.parametrize("opset", [7, 99])
def test_an_operator_set_that_is_not_admitted_is_refused(opset: int) -> None:
    error = refused(linear_model(opset=opset))
    assert error.reason is PolicyFault.OPSET
    assert str(opset) in error.text


def test_operators_of_others_are_refused() -> None:
    model = linear_model(extra_nodes=[helper.make_node("FastGelu", ["product"], ["odd"], domain="com.microsoft")])
    model.opset_import.append(helper.make_opsetid("com.microsoft", 1))
    error = refused(model)
    assert error.reason is PolicyFault.OPSET
    assert "com.microsoft.FastGelu" in error.text


@pytest.mark.parametrize("domain", ["com.example", "ai.onnx.ml", "com.microsoft"])
def test_73_a_standard_graph_with_an_import_that_it_does_not_use_is_admitted(domain: str) -> None:
    model = linear_model()
    model.opset_import.append(helper.make_opsetid(domain, 1))
    with_it, without = (Policy(one.SerializeToString()) for one in (model, linear_model()))
    seen = np.ones(SIZE, np.float32)
    np.testing.assert_array_equal(with_it.act(seen)[0], without.act(seen)[0])


def test_73_a_standard_graph_in_functions_of_its_own_is_admitted() -> None:
    function = helper.make_function(
        "local", "Squash", ["x"], ["y"], [helper.make_node("Tanh", ["x"], ["y"])], [helper.make_opsetid("", 17)]
    )
    model = linear_model()
    model.graph.node[1].CopyFrom(helper.make_node("Squash", ["product"], ["action"], domain="local"))
    model.functions.append(function)
    model.opset_import.append(helper.make_opsetid("local", 1))
    seen = np.ones(SIZE, np.float32)
    action = Policy(model.SerializeToString()).act(seen)[0]
    np.testing.assert_allclose(action, Policy(linear_model().SerializeToString()).act(seen)[0])


def sampling(operator: str) -> list[onnx.NodeProto]:
    """Nodes that draw with `operator` from `product`, and give `drawn`."""
    shaped = {"shape": [1, 4]} if operator in ("RandomNormal", "RandomUniform") else {}
    inputs = [] if shaped else ["product"]
    if operator == "Dropout":
        truth = numpy_helper.from_array(np.array(True), "t")
        half = numpy_helper.from_array(np.array(0.5, np.float32), "h")
        constants = [helper.make_node("Constant", [], [n], value=v) for n, v in (("half", half), ("training", truth))]
        return [*constants, helper.make_node(operator, ["product", "half", "training"], ["drawn"])]
    return [helper.make_node(operator, inputs, ["drawn"], **shaped)]


SAMPLERS = (
    "RandomNormal",
    "RandomNormalLike",
    "RandomUniform",
    "RandomUniformLike",
    "Multinomial",
    "Bernoulli",
    "Dropout",
)


@pytest.mark.parametrize("operator", SAMPLERS)
def test_73_a_graph_that_samples_is_refused_by_the_operator_s_name(operator: str) -> None:
    error = refused(linear_model(extra_nodes=sampling(operator)))
    assert error.reason is PolicyFault.RANDOM
    assert f"({operator})" in error.text


def test_73_an_operator_that_samples_is_found_in_a_branch_and_in_a_function() -> None:
    inner = helper.make_graph(
        [helper.make_node("RandomNormal", [], ["c"], shape=[4])],
        "inner",
        [],
        [helper.make_tensor_value_info("c", TensorProto.FLOAT, [4])],
    )
    truth = helper.make_node("Constant", [], ["truth"], value=numpy_helper.from_array(np.array(True), "t"))
    branch = helper.make_node("If", ["truth"], ["unused"], then_branch=inner, else_branch=inner)
    assert refused(linear_model(extra_nodes=[truth, branch])).reason is PolicyFault.RANDOM
    model = linear_model()
    nodes = [helper.make_node("Bernoulli", ["x"], ["y"])]
    model.functions.append(helper.make_function("local", "F", ["x"], ["y"], nodes, [helper.make_opsetid("", 17)]))
    assert refused(model).reason is PolicyFault.RANDOM


def test_73_a_dropout_that_does_not_train_is_admitted() -> None:
    model = linear_model()
    model.graph.node[1].input[0] = "kept"
    model.graph.node.insert(1, helper.make_node("Dropout", ["product"], ["kept"]))
    Policy(model.SerializeToString())


def test_73_a_graph_that_answers_twice_in_two_ways_is_refused_whatever_its_operators(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(model_module, "RANDOM", frozenset())
    model = linear_model()
    model.graph.node[1].input[0] = "noisy"
    model.graph.node.insert(1, helper.make_node("RandomNormalLike", ["product"], ["noise"]))
    model.graph.node.insert(2, helper.make_node("Add", ["product", "noise"], ["noisy"]))
    error = refused(model)
    assert error.reason is PolicyFault.RANDOM
    assert "in two ways" in error.text


def test_an_operator_that_does_not_exist_is_refused() -> None:
    error = refused(linear_model(extra_nodes=[helper.make_node("Frobnicate", ["product"], ["odd"])]))
    assert error.reason is PolicyFault.CORRUPT


# The contract against the graph


def test_a_model_without_a_contract_is_refused() -> None:
    error = refused(linear_model(metadata={}))
    assert error.reason is PolicyFault.CONTRACT_MISSING
    assert METADATA_KEY in error.text


def test_a_contract_that_does_not_hold_together_is_refused_with_the_field() -> None:
    text = contract().to_json().replace('"hole_offset_xy"', '"hole_offset"')
    error = refused(linear_model(metadata={METADATA_KEY: text}))
    assert error.reason is PolicyFault.CONTRACT_INVALID
    assert "hole_offset" in error.text


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"observation_name": "obs"}, "inputs are ['obs']"),
        ({"observation_size": SIZE + 1}, f"[batch, {SIZE}]"),
        ({"dtype": TensorProto.DOUBLE}, "tensor(double)"),
        ({"batch": 4}, "[4, "),
    ],
)
def test_a_graph_with_another_signature_than_its_contract_is_refused(changes: dict[str, Any], says: str) -> None:
    error = refused(linear_model(**changes))
    assert error.reason is PolicyFault.SIGNATURE
    assert says in error.text


def test_a_contract_that_promises_a_recurrent_state_is_held_to_it() -> None:
    error = refused(linear_model(metadata=contract(hidden_size=8).to_metadata()))
    assert error.reason is PolicyFault.SIGNATURE
    assert "hidden" in error.text


def test_a_fixed_batch_of_one_is_enough_for_a_cell() -> None:
    policy = Policy(linear_model(batch=1).SerializeToString())
    assert policy.act(np.zeros(SIZE, np.float32))[0].shape == (4,)


# Numbers


def test_a_model_that_answers_nan_is_refused_at_load() -> None:
    weights = np.zeros((SIZE, 4))
    weights[0, 0] = np.nan
    assert refused(linear_model(weights=weights)).reason is PolicyFault.INVALID_OUTPUT


def test_an_answer_that_is_not_finite_never_leaves() -> None:
    policy = Policy(linear_model(weights=np.full((SIZE, 4), 1e30), activation="Identity").SerializeToString())
    with pytest.raises(PolicyError, match="action is not finite") as refusal:
        policy.act(np.full(SIZE, 3e38, np.float32))
    assert refusal.value.reason is PolicyFault.INVALID_OUTPUT


def shaped(node: onnx.NodeProto, *constants: onnx.TensorProto) -> bytes:
    """A model whose signature is right and whose action comes out of `node`."""
    model = linear_model()
    model.graph.node[1].CopyFrom(node)
    model.graph.initializer.extend(constants)
    return model.SerializeToString()


def test_an_action_of_another_shape_than_declared_is_refused() -> None:
    error = refused(shaped(helper.make_node("Concat", ["product", "product"], ["action"], axis=0)))
    assert error.reason is PolicyFault.INVALID_OUTPUT
    assert "(2, 4), want (1, 4)" in error.text


def test_a_graph_that_fails_when_it_runs_is_refused_at_load() -> None:
    node = helper.make_node("Gather", ["product", "sixth"], ["action"], axis=0)
    error = refused(shaped(node, numpy_helper.from_array(np.array([5]), "sixth")))
    assert error.reason is PolicyFault.FAILED


def test_an_observation_that_is_not_finite_is_refused_with_the_entry(path: Path) -> None:
    policy = Policy.load(path)
    observation = np.zeros(SIZE, np.float32)
    observation[2] = np.nan
    with pytest.raises(PolicyError, match="not finite in height") as refusal:
        policy.act(observation)
    assert refusal.value.reason is PolicyFault.INVALID_OBSERVATION


@pytest.mark.parametrize("shape", [(SIZE + 1,), (2, SIZE - 1), ()])
def test_an_observation_of_another_length_is_refused(path: Path, shape: tuple[int, ...]) -> None:
    with pytest.raises(PolicyError, match="length"):
        Policy.load(path).act(np.zeros(shape, np.float32))
