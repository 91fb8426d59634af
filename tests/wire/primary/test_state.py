import contextlib
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wire.primary import realtime, state
from wire.primary.errors import PrimaryError, PrimaryErrorReason

REAL = st.floats(allow_nan=False)
REAL32 = st.floats(allow_nan=False, width=32)
BYTE = st.integers(0, 255)
UINT32 = st.integers(0, 2**32 - 1)
INT32 = st.integers(-(2**31), 2**31 - 1)


def vector(n: int) -> st.SearchStrategy[tuple[float, ...]]:
    return st.tuples(*[REAL] * n)


PARTS = st.one_of(
    st.builds(
        state.RobotMode,
        st.integers(0, 2**64 - 1),
        *[st.booleans()] * 7,
        st.integers(-1, 8),
        BYTE,
        REAL,
        REAL,
        REAL,
        BYTE,
    ),
    st.builds(state.Joints, st.tuples(*[st.builds(state.Joint, REAL, REAL, REAL, *[REAL32] * 4, BYTE)] * 6)),
    st.builds(state.Tool, BYTE, BYTE, REAL, REAL, REAL32, BYTE, REAL32, REAL32, BYTE),
    st.builds(
        state.Masterboard,
        *(UINT32, UINT32, BYTE, BYTE, REAL, REAL, st.integers(-128, 127), st.integers(-128, 127), REAL, REAL),
        *(REAL32, REAL32, REAL32, REAL32, BYTE, st.booleans()),
        *(st.none() | st.tuples(UINT32, UINT32, REAL32, REAL32), BYTE, BYTE),
    ),
    st.builds(state.Cartesian, vector(6), vector(6)),
    st.builds(state.Kinematics, st.tuples(*[UINT32] * 6), *[vector(6)] * 4, UINT32),
    st.builds(
        state.Configuration, vector(12), vector(12), REAL, REAL, REAL, REAL, REAL, *[vector(6)] * 4, *[INT32] * 4
    ),
    st.builds(state.ForceMode, vector(6), REAL),
    st.builds(state.Additional, *[st.booleans()] * 4),
    st.builds(state.ToolCommunication, st.booleans(), INT32, INT32, INT32, REAL32, REAL32),
    st.builds(state.ToolMode, BYTE, BYTE, BYTE),
)


@given(st.lists(PARTS, max_size=4))
def test_what_is_encoded_is_decoded(parts: list[state.SubPackage]) -> None:
    assert state.decode_state(state.encode_state(parts)) == parts


@pytest.mark.parametrize(
    ("part", "size"),
    [
        (state.RobotMode(0, *[True] * 7, robot_mode=7), 47),
        (state.Joints((state.Joint(0.0, 0.0, 0.0),) * 6), 251),
        (state.Tool(), 37),
        (state.Masterboard(0, 0, 0, 0, 0.0, 0.0, 0, 0, 0.0, 0.0, 0.0, 48.0, 0.0, 0.0, 1), 75),
        (state.Cartesian((0.0,) * 6, (0.0,) * 6), 101),
        (state.Kinematics((0,) * 6, *[(0.0,) * 6] * 4), 225),
        (state.ForceMode((0.0,) * 6), 61),
        (state.ToolCommunication(), 26),
        (state.ToolMode(), 8),
        (state.Additional(), 9),
    ],
)
def test_sizes_are_those_that_a_controller_sends(part: state.SubPackage, size: int) -> None:
    content = state.encode_state([part])

    assert len(content) == size
    assert struct.unpack_from(">IB", content) == (size, part.TYPE)


def test_the_robot_s_mode_stands_where_clients_look_for_it() -> None:
    mode = state.RobotMode(1, True, True, True, False, True, False, False, robot_mode=5)

    content = state.encode_state([mode])

    assert content[13:20] == b"\x01\x01\x01\x00\x01\x00\x00"
    assert content[20] == 5


def test_a_configuration_with_more_at_its_end_is_read() -> None:
    configuration = state.Configuration((0.0,) * 12, (0.0,) * 12, *[0.0] * 5, *[(0.0,) * 6] * 4, 6, 4, 3, 1)
    content = configuration.encode() + b"\x12\x34\x56\x78"

    assert state.decode_state(struct.pack(">IB", 5 + len(content), 6) + content) == [configuration]


def test_a_part_of_unknown_type_is_passed_over() -> None:
    tool = state.ToolMode()
    unknown = struct.pack(">IB", 8, 200) + b"abc"

    assert state.decode_state(unknown + state.encode_state([tool])) == [tool]


@given(st.binary(max_size=200))
def test_any_bytes_are_a_state_or_malformed(content: bytes) -> None:
    with contextlib.suppress(PrimaryError):
        assert sum(len(part.encode()) + 5 for part in state.decode_state(content)) <= len(content)


@pytest.mark.parametrize("size", [0, 4, 7, 9, 2**32 - 1])
def test_a_part_that_claims_another_size_is_malformed(size: int) -> None:
    with pytest.raises(PrimaryError, match=r"sub-package 12|ToolMode") as raised:
        state.decode_state(struct.pack(">IB", size, 12) + b"abc")
    assert raised.value.reason is PrimaryErrorReason.MALFORMED


def test_the_real_time_package_has_1220_bytes_and_its_values_in_their_places() -> None:
    values = [float(index) for index in range((realtime.SIZE - 4) // 8)]

    package = realtime.encode(values)
    decoded = realtime.decode(package)

    assert realtime.SIZE == len(package) == struct.unpack_from(">i", package)[0] == 1220
    assert struct.unpack_from(">6d", package, 252) == decoded["actual_q"]
    assert struct.unpack_from(">6d", package, 444) == decoded["actual_TCP_pose"]
    assert struct.unpack_from(">d", package, 756) == (decoded["robot_mode"],)
    assert struct.unpack_from(">d", package, 812) == (decoded["safety_mode"],)
    assert struct.unpack_from(">d", package, 1052) == (decoded["runtime_state"],)


def test_a_real_time_package_cut_short_is_refused() -> None:
    with pytest.raises(ValueError, match="needs 1220"):
        realtime.decode(bytes(1219))
