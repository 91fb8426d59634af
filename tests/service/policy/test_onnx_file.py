import onnx
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import helper

from service.policy.onnx_file import MalformedError, inspect
from tests.service.policy.model_files import linear_model


def test_opsets_and_metadata_are_read_as_onnx_wrote_them() -> None:
    model = linear_model(metadata={"a": "1", "ключ": "м·µ", "empty": ""})
    model.opset_import.append(helper.make_opsetid("com.example", 3))
    head = inspect(model.SerializeToString())
    assert head.opsets == {"": 17, "com.example": 3}
    assert head.metadata == {"a": "1", "ключ": "м·µ", "empty": ""}
    assert not head.external_data


def test_the_long_name_of_the_standard_domain_is_the_standard_domain() -> None:
    model = linear_model()
    model.opset_import[0].domain = "ai.onnx"
    assert inspect(model.SerializeToString()).opsets == {"": 17}


def nested(depth: int) -> bytes:
    """A model of `depth` graphs within each other: graph, node 1, attribute 5, graph 6."""
    graph = b""
    for _ in range(depth):
        for field in (6, 5, 1):
            graph = bytes([field << 3 | 2]) + length(graph) + graph
    return b"\x3a" + length(graph) + graph


def length(data: bytes) -> bytes:
    return bytes([len(data) & 0x7F | 0x80, len(data) >> 7])


def test_graphs_nested_without_end_are_refused() -> None:
    assert not inspect(nested(10)).external_data
    with pytest.raises(MalformedError, match="nested"):
        inspect(nested(60))


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x08\x07",  # an ir_version and nothing else
        b"\x3a\x05ab",  # a graph longer than the file
        b"\x38\x01",  # a number for a graph
        b"\x42\x03\x18\x00\x18",  # an opset cut short behind an unknown field
        b"\x42\x02\x12\x00\x3a\x00",  # text for an opset's version
        b"\x72\x03\x0a\x01\xff\x3a\x00",  # a key that is not UTF-8
        b"\x3b",  # a wire type that ended with protocol buffers 2
        b"\xff" * 11,  # a number without end
        b"\x3a\x80",  # cut within a number
    ],
)
def test_bytes_that_are_no_model_are_malformed(data: bytes) -> None:
    with pytest.raises(MalformedError):
        inspect(data)


def test_fixed_width_fields_are_passed_over() -> None:
    assert inspect(b"\x09" + bytes(8) + b"\x0d" + bytes(4) + b"\x3a\x00").opsets == {}


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes_are_read_or_malformed(data: bytes) -> None:
    try:
        inspect(data)
    except MalformedError:
        return


def test_the_operators_of_every_graph_are_read_with_their_inputs() -> None:
    model = linear_model(extra_nodes=[helper.make_node("Clip", ["product", "", "most"], ["cut"], domain="ai.onnx")])
    found = inspect(model.SerializeToString())
    assert {(one.domain, one.name, one.inputs) for one in found.operators} == {
        ("", "MatMul", 2),
        ("", "Tanh", 1),
        ("", "Clip", 3),
    }
    assert found.functions == frozenset()


def test_an_operator_set_in_two_versions_is_malformed() -> None:
    model = linear_model()
    model.opset_import.append(helper.make_opsetid("ai.onnx", 18))
    with pytest.raises(MalformedError, match="in two versions"):
        inspect(model.SerializeToString())


def test_functions_are_searched_for_external_data() -> None:
    tensor = onnx.TensorProto(data_location=onnx.TensorProto.EXTERNAL)
    function = helper.make_function(
        "local", "f", [], ["c"], [helper.make_node("Constant", [], ["c"], value=tensor)], [helper.make_opsetid("", 17)]
    )
    model = linear_model()
    model.functions.append(function)
    assert inspect(model.SerializeToString()).external_data
