"""Reads an ONNX file: operator sets, metadata, operators of all graphs, and references to other files.

ONNX Runtime opens files that a model names, and says little about why it refuses a model. This module walks the
protocol buffer without building the model. The field numbers are those of onnx.proto3 of the ONNX project (Apache-2.0).
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

_MODEL_GRAPH, _MODEL_OPSET, _MODEL_METADATA, _MODEL_FUNCTIONS = 7, 8, 14, 25
_DEPTH_LIMIT = 32
# Fields that lead to a tensor, by kind of message: field number -> kind of the content
_PATHS: dict[str, dict[int, str]] = {
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "function": {7: "node", 11: "attribute"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: "tensor", 2: "tensor"},
    "tensor": {},
}
_TENSOR_EXTERNAL_DATA, _TENSOR_DATA_LOCATION = 13, 14
_NODE_INPUT, _NODE_OPERATOR, _NODE_DOMAIN = 1, 4, 7
_FUNCTION_NAME, _FUNCTION_DOMAIN = _FUNCTION_NAMES = 1, 10
_EXTERNAL = 1


class MalformedError(ValueError):
    """The bytes are not an ONNX model."""


@dataclass(frozen=True, slots=True)
class Operator:
    """Operator of a node.

    Attributes:
        domain: operator set; the standard one is "".
        name: name in that set.
        inputs: number of inputs up to the last one that is given.
    """

    domain: str
    name: str
    inputs: int = 0


@dataclass(frozen=True, slots=True)
class OnnxFile:
    """Content of a model file, without its numbers.

    Attributes:
        opsets: version of the operator set by domain; the standard domain is "". A model may import more than it uses.
        metadata: the model's `metadata_props`.
        external_data: True if a tensor's values are in another file.
        operators: operators of the nodes of every graph, subgraph and function.
        functions: domain and name of each function that the file defines.
    """

    opsets: dict[str, int]
    metadata: dict[str, str]
    external_data: bool
    operators: frozenset[Operator]
    functions: frozenset[tuple[str, str]]


@dataclass(slots=True)
class _Found:
    """Content met so far on the walk through graphs and functions."""

    external: bool = False
    operators: set[Operator] = field(default_factory=set[Operator])


def inspect(data: bytes) -> OnnxFile:
    """Read a model.

    Raises:
        MalformedError: the bytes are not a protocol buffer of a model, its graphs are nested too deep, or it imports an
            operator set in two versions.
    """
    view = memoryview(data)
    opsets: dict[str, int] = {}
    metadata: dict[str, str] = {}
    functions: set[tuple[str, str]] = set()
    found, has_graph = _Found(), False
    for number, value in _fields(view):
        if number == _MODEL_OPSET:
            domain, version = "", 0
            for inner, content in _fields(_bytes(value)):
                if inner == 1:
                    domain = _text(content)
                elif inner == 2:
                    version = _integer(content)
            if opsets.setdefault(_domain(domain), version) != version:
                raise MalformedError(f"it imports operator set {domain!r} in two versions")
        elif number == _MODEL_METADATA:
            entry = {inner: _text(content) for inner, content in _fields(_bytes(value)) if inner in (1, 2)}
            metadata[entry.get(1, "")] = entry.get(2, "")
        elif number == _MODEL_GRAPH:
            has_graph = True
            _walk(_bytes(value), "graph", 0, found)
        elif number == _MODEL_FUNCTIONS:
            names = {inner: _text(content) for inner, content in _fields(_bytes(value)) if inner in _FUNCTION_NAMES}
            functions.add((_domain(names.get(_FUNCTION_DOMAIN, "")), names.get(_FUNCTION_NAME, "")))
            _walk(_bytes(value), "function", 0, found)
    if not has_graph:
        raise MalformedError("it has no graph")
    return OnnxFile(opsets, metadata, found.external, frozenset(found.operators), frozenset(functions))


def _walk(message: memoryview, kind: str, depth: int, found: _Found) -> None:
    if depth > _DEPTH_LIMIT:
        raise MalformedError(f"graphs nested more than {_DEPTH_LIMIT} deep")
    if kind == "node":
        found.operators.add(_operator(message))
    for number, value in _fields(message):
        if kind == "tensor" and (
            number == _TENSOR_EXTERNAL_DATA or (number == _TENSOR_DATA_LOCATION and value == _EXTERNAL)
        ):
            found.external = True
        inner = _PATHS[kind].get(number)
        if inner is not None:
            _walk(_bytes(value), inner, depth + 1, found)


def _operator(node: memoryview) -> Operator:
    domain = name = ""
    inputs = given = 0
    for number, value in _fields(node):
        if number == _NODE_INPUT:
            inputs += 1
            given = inputs if _text(value) else given
        elif number == _NODE_OPERATOR:
            name = _text(value)
        elif number == _NODE_DOMAIN:
            domain = _domain(_text(value))
    return Operator(domain, name, given)


def _domain(name: str) -> str:
    return "" if name == "ai.onnx" else name


def _fields(message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Yield number and value of each field. A fixed-width value is yielded as its bytes."""
    at, end = 0, len(message)
    while at < end:
        key, at = _varint(message, at)
        number, wire_type = key >> 3, key & 7
        if wire_type == 0:
            value, at = _varint(message, at)
            yield number, value
            continue
        if wire_type == 2:
            length, at = _varint(message, at)
        elif wire_type in (1, 5):
            length = 8 if wire_type == 1 else 4
        else:
            raise MalformedError(f"field {number} has wire type {wire_type}")
        if length > end - at:
            raise MalformedError(f"field {number} wants {length} bytes, {end - at} are left")
        yield number, message[at : at + length]
        at += length


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(message):
            raise MalformedError("it ends within a number")
        byte = message[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise MalformedError("a number is longer than 64 bits")


def _bytes(value: int | memoryview) -> memoryview:
    if isinstance(value, int):
        raise MalformedError("it has a number in place of a message")
    return value


def _integer(value: int | memoryview) -> int:
    if not isinstance(value, int):
        raise MalformedError("it has a message in place of a number")
    return value


def _text(value: int | memoryview) -> str:
    try:
        return bytes(_bytes(value)).decode()
    except UnicodeDecodeError as error:
        raise MalformedError(f"a text is not UTF-8: {error}") from error
