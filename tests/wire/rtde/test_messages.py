import contextlib
import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wire.rtde.codec import FrameReader, PackageType
from wire.rtde.errors import PackageError, RtdeErrorReason, SetupError
from wire.rtde.fields import FieldType
from wire.rtde.messages import (
    NAMES_LIMIT,
    ControllerVersion,
    InputsRequest,
    Level,
    OutputsRequest,
    SetupReply,
    TextMessage,
    decode_accepted,
    decode_version_request,
    encode_accepted,
    encode_version_request,
)

NAMES = st.lists(st.text("abcdefghijklmnopqrstuvwxyz_0123456789", min_size=1, max_size=20), min_size=1, max_size=60)
WORD = st.integers(0, 2**32 - 1)


def read(package: bytes, kind: PackageType) -> bytes:
    ((number, payload),) = FrameReader().feed(package)
    assert number == kind
    return payload


@given(st.integers(0, 2**16 - 1))
def test_a_version_request_comes_back(version: int) -> None:
    assert decode_version_request(read(encode_version_request(version), PackageType.PROTOCOL_VERSION)) == version


@given(WORD, WORD, WORD, WORD)
def test_a_controller_version_comes_back(major: int, minor: int, bugfix: int, build: int) -> None:
    version = ControllerVersion(major, minor, bugfix, build)
    assert ControllerVersion.decode(read(version.encode(), PackageType.CONTROLLER_VERSION)) == version


def test_versions_compare_as_versions() -> None:
    assert ControllerVersion(5, 9, 4, 10) < ControllerVersion(5, 21, 0, 0) > (5, 11, 0)


@given(st.sampled_from([PackageType.PROTOCOL_VERSION, PackageType.START, PackageType.PAUSE]), st.booleans())
def test_an_acceptance_comes_back(kind: PackageType, accepted: bool) -> None:
    assert decode_accepted(read(encode_accepted(kind, accepted), kind)) is accepted


@given(NAMES, st.none() | st.floats(1.0, 500.0))
def test_a_request_for_outputs_comes_back(names: list[str], frequency_hz: float | None) -> None:
    request = OutputsRequest(tuple(names), frequency_hz)
    payload = read(request.encode(), PackageType.SETUP_OUTPUTS)
    assert OutputsRequest.decode(payload, 1 if frequency_hz is None else 2) == request


@given(NAMES)
def test_a_request_for_inputs_comes_back(names: list[str]) -> None:
    request = InputsRequest(tuple(names))
    assert InputsRequest.decode(read(request.encode(), PackageType.SETUP_INPUTS)) == request


def test_the_bytes_are_those_of_the_guide() -> None:
    assert encode_version_request(2) == b"\x00\x05V\x00\x02"
    assert ControllerVersion(5, 21, 3, 9).encode() == b"\x00\x13v" + struct.pack(">4I", 5, 21, 3, 9)
    assert OutputsRequest(("timestamp", "actual_q"), 125.0).encode() == (
        b"\x00\x1dO" + struct.pack(">d", 125.0) + b"timestamp,actual_q"
    )
    assert InputsRequest(("speed_slider_mask",)).encode() == b"\x00\x14Ispeed_slider_mask"
    assert SetupReply(("DOUBLE", "VECTOR6D"), 1).encode(PackageType.SETUP_OUTPUTS) == b"\x00\x13O\x01DOUBLE,VECTOR6D"
    assert encode_accepted(PackageType.START, True) == b"\x00\x04S\x01"
    assert TextMessage("hi", "me", Level.ERROR).encode() == b"\x00\x0aM\x02hi\x02me\x01"
    assert TextMessage("hi", "", Level.WARNING).encode_v1() == b"\x00\x06M\x02hi"


def test_an_empty_name_after_a_last_comma_is_none() -> None:
    assert InputsRequest.decode(b"a,b,").names == ("a", "b")
    assert OutputsRequest.decode(bytes(8) + b"a,,b,").names == ("a", "b")
    assert InputsRequest.decode(b"").names == ()


def test_a_list_of_names_ends_at_2048_bytes() -> None:
    fits = ("x" * 1023, "y" * 1024)
    assert InputsRequest.decode(read(InputsRequest(fits).encode(), PackageType.SETUP_INPUTS)).names == fits
    for request in (InputsRequest((*fits, "")), OutputsRequest((*fits, ""), 1.0)):
        with pytest.raises(PackageError, match="2048"):
            request.encode()
    with pytest.raises(PackageError, match="2048"):
        InputsRequest.decode(bytes(NAMES_LIMIT + 1))
    with pytest.raises(PackageError, match="2048"):
        OutputsRequest.decode(bytes(NAMES_LIMIT + 9))


@given(st.lists(st.sampled_from(FieldType), min_size=1, max_size=300), st.none() | st.integers(1, 255))
def test_an_agreed_set_up_gives_its_recipe(types: list[FieldType], recipe_id: int | None) -> None:
    names = [f"v{i}" for i in range(len(types))]
    payload = read(
        SetupReply(tuple(kind.name for kind in types), recipe_id).encode(PackageType.SETUP_OUTPUTS),
        PackageType.SETUP_OUTPUTS,
    )
    recipe = SetupReply.decode(payload, with_id=recipe_id is not None).recipe(names)
    assert recipe.names == tuple(names)
    assert recipe.types == tuple(types)
    assert recipe.recipe_id == recipe_id


def test_a_refused_set_up_names_every_variable_and_why() -> None:
    reply = SetupReply(("DOUBLE", "IN_USE", "NOT_FOUND", "IN_USE"), 0)
    with pytest.raises(SetupError) as caught:
        reply.recipe(["a", "b", "c", "d"])
    assert caught.value.refused == {
        "b": RtdeErrorReason.IN_USE,
        "c": RtdeErrorReason.NOT_FOUND,
        "d": RtdeErrorReason.IN_USE,
    }
    assert "in use by another client or a field bus: b, d" in str(caught.value)
    assert "not known to the controller: c" in str(caught.value)


@pytest.mark.parametrize(
    ("types", "recipe_id", "told"),
    [
        (("DOUBLE",), 1, "1 types came back for 2"),
        (("DOUBLE", "FLOAT"), 1, "b as 'FLOAT'"),
        (("DOUBLE", "DOUBLE"), 0, "not the recipe"),
    ],
)
def test_an_answer_that_makes_no_recipe_is_refused(types: tuple[str, ...], recipe_id: int, told: str) -> None:
    with pytest.raises(PackageError, match=told):
        SetupReply(types, recipe_id).recipe(["a", "b"])


SHORT = st.text(st.characters(exclude_categories=["Cs"]), max_size=60)


@given(SHORT, SHORT, st.integers(0, 255))
def test_a_text_message_comes_back(message: str, source: str, level: int) -> None:
    said = TextMessage(message, source, level)
    assert TextMessage.decode(read(said.encode(), PackageType.TEXT)) == said
    alone = TextMessage(message, "", level)
    assert TextMessage.decode_v1(read(alone.encode_v1(), PackageType.TEXT)) == alone


def test_a_long_text_is_cut_between_characters() -> None:
    said = TextMessage.decode(read(TextMessage("x" + "ä" * 200, "y" * 300).encode(), PackageType.TEXT))
    assert said.message == "x" + "ä" * 127
    assert said.source == "y" * 255
    assert TextMessage.decode(read(TextMessage("a\ud800b").encode(), PackageType.TEXT)).message == "a?b"


@pytest.mark.parametrize(
    "payload", [b"", b"\x01", b"\x01a", b"\x01a\x00", b"\x01a\x01b", b"\x00\x00\x03?", b"\xff\xff"]
)
def test_a_text_message_whose_lengths_do_not_add_up_is_refused(payload: bytes) -> None:
    with pytest.raises(PackageError, match="add up"):
        TextMessage.decode(payload)


DECODERS = [
    ControllerVersion.decode, decode_version_request, decode_accepted, InputsRequest.decode, OutputsRequest.decode,
    SetupReply.decode, TextMessage.decode, TextMessage.decode_v1,
    lambda payload: OutputsRequest.decode(payload, 1), lambda payload: SetupReply.decode(payload, with_id=False),
]  # fmt: skip


@given(st.sampled_from(DECODERS), st.binary(max_size=600))
def test_any_payload_is_read_or_refused(decode: Any, payload: bytes) -> None:
    with contextlib.suppress(PackageError):
        decode(payload)
