import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wire.rtde.codec import HEADER_SIZE, SIZE_LIMIT, FrameReader, PackageType, Recipe, frame
from wire.rtde.errors import FramingError, PackageError, RtdeErrorReason
from wire.rtde.fields import OUTPUTS, FieldType

INTEGERS = {"B": (0, 2**8 - 1), "I": (0, 2**32 - 1), "Q": (0, 2**64 - 1), "i": (-(2**31), 2**31 - 1)}


def element(kind: FieldType) -> st.SearchStrategy[Any]:
    if kind.letter == "?":
        return st.booleans()
    if kind.letter == "d":
        return st.floats(allow_nan=False)
    return st.integers(*INTEGERS[kind.letter])


def value(kind: FieldType) -> st.SearchStrategy[Any]:
    return element(kind) if kind.count == 1 else st.tuples(*[element(kind)] * kind.count)


@st.composite
def recipes_with_values(draw: st.DrawFn) -> tuple[Recipe, tuple[Any, ...]]:
    types = draw(st.lists(st.sampled_from(FieldType), min_size=1, max_size=30))
    recipe_id = draw(st.none() | st.integers(0, 255))
    recipe = Recipe([f"v{i}" for i in range(len(types))], types, recipe_id)
    return recipe, tuple(draw(value(kind)) for kind in types)


@given(recipes_with_values())
def test_what_is_encoded_is_decoded_again(case: tuple[Recipe, tuple[Any, ...]]) -> None:
    recipe, values = case
    package = recipe.encode(values)
    ((kind, payload),) = FrameReader().feed(package)
    assert kind == PackageType.DATA
    assert len(payload) == recipe.size
    decoded = recipe.decode(payload)
    assert decoded == values
    assert [type(one) for one in decoded] == [type(one) for one in values]
    assert recipe.encode(decoded) == package


def test_the_bytes_are_those_of_the_guide() -> None:
    names = ["timestamp", "robot_mode", "actual_q", "actual_digital_input_bits", "output_bit_register_64"]
    recipe = Recipe(names, [OUTPUTS[name] for name in names], 1)
    package = recipe.encode((1.5, -1, range(6), 2**63, True))
    assert package == (b"\x00\x49U\x01" + struct.pack(">di6dQ", 1.5, -1, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 2**63) + b"\x01")
    first_version = Recipe(names[:1], [FieldType.DOUBLE], None)
    assert first_version.encode((1.5,)) == b"\x00\x0bU" + struct.pack(">d", 1.5)


def test_numpy_values_are_values() -> None:
    recipe = Recipe(["a", "b", "c"], [FieldType.VECTOR6D, FieldType.INT32, FieldType.DOUBLE], 1)
    package = recipe.encode((np.arange(6.0), np.int64(3), np.float64(0.5)))
    assert recipe.decode(package[HEADER_SIZE:]) == ((0.0, 1.0, 2.0, 3.0, 4.0, 5.0), 3, 0.5)


def test_numbers_that_are_none_pass_as_they_are() -> None:
    recipe = Recipe(["a", "b"], [FieldType.DOUBLE, FieldType.VECTOR3D], 1)
    a, b = recipe.decode(recipe.encode((math.nan, (math.inf, -math.inf, -0.0)))[HEADER_SIZE:])
    assert math.isnan(a)  # type: ignore[arg-type]
    assert b == (math.inf, -math.inf, 0.0)


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ((1, [0.0] * 6), "3 values, not 2"),
        ((2**31, [0.0] * 6, 0), "speed .INT32. cannot be 2147483648"),
        ((1.5, [0.0] * 6, 0), "speed .INT32."),
        ((1, [0.0] * 5, 0), "pose .VECTOR6D."),
        ((1, [0.0] * 7, 0), "pose .VECTOR6D."),
        ((1, 0.0, 0), "pose .VECTOR6D."),
        ((1, [0.0] * 6, -1), "mask .UINT8."),
        ((1, [0.0, 0.0, "0", 0.0, 0.0, 0.0], 1), "pose .VECTOR6D."),
        ((1, [0.0] * 5 + [10**400], 1), "pose .VECTOR6D."),
        ((1, iter([0.0] * 6), 1), "recipe 2 cannot take"),
    ],
)
def test_a_value_that_does_not_fit_is_named(values: Any, told: str) -> None:
    recipe = Recipe(["speed", "pose", "mask"], [FieldType.INT32, FieldType.VECTOR6D, FieldType.UINT8], 2)
    with pytest.raises(PackageError, match=told) as caught:
        recipe.encode(values)
    assert caught.value.reason is RtdeErrorReason.WRONG_VALUE


def test_vectors_of_wrong_lengths_do_not_make_up_for_each_other() -> None:
    recipe = Recipe(["a", "b"], [FieldType.VECTOR6D, FieldType.VECTOR6D], 1)
    with pytest.raises(PackageError, match=r"a .VECTOR6D."):
        recipe.encode(([0.0] * 5, [0.0] * 7))


def test_a_package_of_another_recipe_or_length_is_refused() -> None:
    recipe = Recipe(["a"], [FieldType.INT32], 2)
    for payload, reason in (
        (b"\x01\0\0\0\0", RtdeErrorReason.WRONG_RECIPE),
        (b"\x02\0\0\0", RtdeErrorReason.MALFORMED),
        (b"", RtdeErrorReason.MALFORMED),
    ):
        with pytest.raises(PackageError) as caught:
            recipe.decode(payload)
        assert caught.value.reason is reason


def test_a_recipe_that_cannot_be_is_refused() -> None:
    for names, types, recipe_id in (
        ([], [], 1),
        (["a"], [], 1),
        (["a"], [FieldType.BOOL], 256),
        (["a"] * 1400, [FieldType.VECTOR6D] * 1400, 1),
    ):
        with pytest.raises(PackageError):
            Recipe(names, types, recipe_id)


@st.composite
def streams(draw: st.DrawFn) -> tuple[list[tuple[int, bytes]], list[bytes]]:
    """Packages, and their bytes cut anywhere."""
    packages = draw(st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=40)), max_size=12))
    stream = b"".join(frame(kind, payload) for kind, payload in packages)
    cuts = sorted(draw(st.lists(st.integers(0, len(stream)), max_size=20)))
    return packages, [stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)]


@given(streams())
def test_a_stream_gives_the_same_packages_however_it_is_cut(case: tuple[list[tuple[int, bytes]], list[bytes]]) -> None:
    packages, chunks = case
    reader = FrameReader()
    assert [package for chunk in chunks for package in reader.feed(chunk)] == packages


@given(streams(), st.data())
def test_packages_that_nobody_took_yet_are_not_lost(
    case: tuple[list[tuple[int, bytes]], list[bytes]], data: st.DataObject
) -> None:
    packages, chunks = case
    reader = FrameReader()
    taken: list[tuple[int, bytes]] = []
    for chunk in chunks:
        waiting = reader.feed(chunk)
        for _ in range(data.draw(st.integers(0, 3))):
            if (package := next(waiting, None)) is not None:
                taken.append(package)
    taken.extend(reader.feed(b""))
    assert taken == packages


@pytest.mark.parametrize("header", [b"\x00\x00U", b"\x00\x02U", b"\x01\x01U"])
def test_a_length_that_no_package_has_ends_the_stream_after_the_good_packages(header: bytes) -> None:
    reader = FrameReader(limit=256)
    packages = reader.feed(frame(PackageType.DATA, b"good") + header + frame(PackageType.DATA, b"never"))
    assert next(packages) == (PackageType.DATA, b"good")
    with pytest.raises(FramingError, match="outside 3 to 256"):
        next(packages)
    with pytest.raises(FramingError):
        list(reader.feed(frame(PackageType.DATA, b"never")))


def test_the_largest_package_passes_and_a_larger_one_cannot_be_made() -> None:
    payload = bytes(SIZE_LIMIT - HEADER_SIZE)
    assert list(FrameReader().feed(frame(PackageType.TEXT, payload))) == [(PackageType.TEXT, payload)]
    with pytest.raises(PackageError):
        frame(PackageType.TEXT, payload + b"1")


@given(st.lists(st.binary(max_size=200), max_size=20), st.integers(3, 300))
def test_any_bytes_give_packages_or_a_framing_error_and_little_is_held(chunks: list[bytes], limit: int) -> None:
    reader = FrameReader(limit)
    given_out = 0
    total = 0
    for chunk in chunks:
        total += len(chunk)
        try:
            for _, payload in reader.feed(chunk):
                given_out += HEADER_SIZE + len(payload)
        except FramingError:
            return
        assert total - given_out < limit
