"""Examples of UR's script manual."""

import math

import pytest

from sim_backend.ur_controller.builtins.strings import STRINGS
from sim_backend.ur_controller.script import Pose, ScriptRuntimeError, Struct, Value


def call(name: str, *arguments: Value) -> Value:
    return STRINGS[name].call(*arguments)


@pytest.mark.parametrize(
    ("name", "arguments", "expected"),
    [
        ("str_cat", ("Hello", " World!"), "Hello World!"),
        ("str_cat", ("Integer ", 1), "Integer 1"),
        ("str_cat", ("", Pose([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])), "p[1, 2, 3, 4, 5, 6]"),
        ("str_cat", ([True, False, True], [1, 0, 1]), "[True, False, True][1, 0, 1]"),
        ("to_str", (10,), "10"),
        ("to_str", (2.123456123456,), "2.123456"),
        ("to_str", (100.0,), "100"),
        ("to_str", (-0.25,), "-0.25"),
        ("to_str", ([[1, 2], [3.5, 4]],), "[[1, 2], [3.5, 4]]"),
        ("str_at", ("Hello", 1), "e"),
        ("str_empty", ("",), True),
        ("str_empty", ("Hello",), False),
        ("str_find", ("Hello World!", "lo"), 3),
        ("str_find", ("Hello World!", "o", 5), 7),
        ("str_find", ("abc", "z"), -1),
        ("str_len", ("Hello",), 5),
        ("str_len", ("µ",), 2),
        ("str_sub", ("0123456789abcdefghij", 5, 3), "567"),
        ("str_sub", ("0123456789abcdefghij", 10), "abcdefghij"),
        ("str_sub", ("0123456789abcdefghij", 2, 0), ""),
        ("str_sub", ("abcde", 2, 50), "cde"),
        ("to_num", ("10",), 10),
        ("to_num", ("3.14",), 3.14),
        ("to_num", ("-3.0e5",), -3.0e5),
        ("to_num", ("+5.",), 5.0),
        ("to_num", ("  0X3A",), 58),
        ("to_num", ("INFINITY",), math.inf),
    ],
)
def test_gives_what_the_manual_says(name: str, arguments: tuple[Value, ...], expected: Value) -> None:
    assert call(name, *arguments) == expected


def test_a_decimal_point_makes_a_float() -> None:
    assert type(call("to_num", "10")) is int
    assert type(call("to_num", "10.")) is float


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("str_at", ("Hello", 10)),
        ("str_at", ("", 0)),
        ("str_sub", ("abcde", -5, 50)),
        ("str_sub", ("abcde", 6)),
        ("str_find", ("abc", "a", 9)),
        ("to_num", ("123abc",)),
        ("to_num", ("1" * 100_000 + "x",)),
        ("to_num", ("99999999999",)),
        ("to_num", ("",)),
        ("to_str", (Struct(a=1),)),
        ("to_str", (None,)),
        ("str_len", (5,)),
        ("str_cat", ("x" * 1000, "y" * 24)),
        ("to_str", ([1.5] * 4000,)),
        ("to_str", ([["x" * 2000]],)),
    ],
)
def test_what_is_not_defined_is_an_error(name: str, arguments: tuple[Value, ...]) -> None:
    with pytest.raises(ScriptRuntimeError):
        call(name, *arguments)
