import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wire.primary.errors import PrimaryError
from wire.primary.messages import (
    ErrorCode,
    Key,
    Message,
    Popup,
    Received,
    ReportLevel,
    RuntimeException,
    SafetyMode,
    Source,
    Text,
    Version,
    decode_message,
    encode_message,
)

INT32 = st.integers(-(2**31), 2**31 - 1)
UINT32 = st.integers(0, 2**32 - 1)
TEXT = st.text(st.characters(codec="utf-8"))
TITLE = st.text(st.characters(codec="ascii"), max_size=255)
MESSAGES = st.one_of(
    st.builds(Text, TEXT),
    st.builds(Version, TITLE, st.integers(0, 255), st.integers(0, 255), INT32, INT32, TEXT),
    st.builds(Key, TITLE, TEXT, INT32, INT32),
    st.builds(ErrorCode, INT32, INT32, INT32, TEXT, UINT32, UINT32),
    st.builds(SafetyMode, st.integers(0, 255), INT32, INT32, UINT32, UINT32),
    st.builds(RuntimeException, INT32, INT32, TEXT),
    st.builds(Popup, TITLE, TEXT, st.booleans(), st.booleans(), st.booleans(), UINT32, st.integers(0, 255)),
)


@given(MESSAGES, st.integers(0, 2**64 - 1), st.integers(-128, 127))
def test_what_is_encoded_is_decoded(message: Message, timestamp_us: int, source: int) -> None:
    content = encode_message(message, timestamp_us, source)

    assert decode_message(content) == Received(timestamp_us, source, message)


def test_the_start_of_a_program_as_a_controller_sends_it() -> None:
    content = bytes.fromhex("0000000000000000 fe 07 00000000 00000000 13") + b"PROGRAM_XXX_STARTEDinsert"

    assert decode_message(content).message == Key("PROGRAM_XXX_STARTED", "insert")
    assert encode_message(Key("PROGRAM_XXX_STARTED", "insert"), 0, Source.ROBOT_INTERFACE) == content


def test_an_unknown_name_as_a_controller_sends_it() -> None:
    text = b"compile_error_name_not_found:foo:"
    content = bytes.fromhex("0000000000000000 fd 0a 00000003 00000001") + text

    assert decode_message(content).message == RuntimeException(3, 1, text.decode())


def test_a_read_only_connection_is_told_with_code_210() -> None:
    content = encode_message(ErrorCode(ErrorCode.READ_ONLY, 0, ReportLevel.VIOLATION, "local"))

    assert content[10:] == bytes.fromhex("000000d2 00000000 00000003 00000000 00000000") + b"local"


def test_a_title_too_long_for_its_length_is_cut() -> None:
    decoded = decode_message(encode_message(Key("t" * 300, "text"))).message

    assert decoded == Key("t" * 255, "text")


def test_a_type_that_is_not_known_is_passed_over() -> None:
    content = bytearray(encode_message(Text("hello")))
    content[9] = 99

    assert decode_message(bytes(content)).message is None


@given(st.binary(max_size=64))
def test_any_bytes_are_a_message_or_malformed(content: bytes) -> None:
    with contextlib.suppress(PrimaryError):
        assert decode_message(content).timestamp_us == int.from_bytes(content[:8], "big")


@pytest.mark.parametrize("cut", range(1, 20))
def test_a_message_cut_short_is_malformed(cut: int) -> None:
    content = encode_message(Version("URControl", 5, 21, 3, 1, ""))

    with pytest.raises(PrimaryError):
        decode_message(content[:-cut])
