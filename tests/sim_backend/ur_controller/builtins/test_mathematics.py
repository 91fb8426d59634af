"""Examples of UR's script manual, and what its text says of errors."""

import math

import pytest

from sim_backend.ur_controller.builtins.mathematics import MATHEMATICS
from sim_backend.ur_controller.script import Pose, ScriptRuntimeError, Value


def call(name: str, *arguments: Value) -> Value:
    return MATHEMATICS[name].call(*arguments)


@pytest.mark.parametrize(
    ("name", "arguments", "expected"),
    [
        ("acos", (0.707,), 0.78555),
        ("atan2", (0.5, 0.5), math.pi / 4),
        ("ceil", (1.43,), 2),
        ("floor", (1.53,), 1),
        ("floor", (-0.5,), -1),
        ("d2r", (90,), math.pi / 2),
        ("r2d", (math.pi,), 180),
        ("log", (10.0, 4.0), 0.60206),
        ("pow", (5.0, 3), 125),
        ("sqrt", (9,), 3),
        ("tan", (0.7854,), 1.0),
        ("norm", (-5.3,), 5.3),
        ("norm", (-8,), 8),
        ("norm", (Pose([-0.2, 0.2, -0.2, -1.57, 0.0, 3.14]),), 3.52768),
        ("norm", ([3, 4],), 5),
        ("normalize", ([0, 1, 1],), [0, 0.70711, 0.70711]),
        ("binary_list_to_integer", ([True, False, False, True],), 9),
        ("binary_list_to_integer", ([True] * 40,), -1),
        ("binary_list_to_integer", ([],), 0),
        ("get_list_length", ([1, 3, 3, 6, 2],), 5),
        ("length", ("here I am",), 9),
        ("size", ([[1, 2], [3, 4], [5, 6]],), [3, 2]),
        ("size", ([1, 2, 3],), 3),
        ("make_list", (3, 1.5, 10), [1.5, 1.5, 1.5]),
        ("make_list", (0, 0, 100), []),
    ],
)
def test_gives_what_the_manual_says(name: str, arguments: tuple[Value, ...], expected: Value) -> None:
    assert call(name, *arguments) == pytest.approx(expected, abs=1e-5)


def test_an_integer_is_thirty_two_booleans() -> None:
    bits = call("integer_to_binary_list", 57)
    assert [index for index, bit in enumerate(bits) if bit] == [0, 3, 4, 5]
    assert len(bits) == 32
    assert call("binary_list_to_integer", call("integer_to_binary_list", -123456789)) == -123456789


def test_matrices_are_inverted_and_transposed() -> None:
    assert call("inv", [[0, 1, 0], [0, 0, 1], [1, 0, 0]]) == [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    assert call("transpose", [[1, 2], [3, 4], [5, 6]]) == [[1, 3, 5], [2, 4, 6]]
    assert call("transpose", [1, 2, 3]) == [[1], [2], [3]]
    assert call("transpose", [[1], [2], [3]]) == [1, 2, 3]


def test_the_inverse_of_a_pose_is_that_of_the_manual() -> None:
    inverse = call("inv", Pose([0.2, 0.5, 0.1, 1.57, 0.0, 3.14]))
    assert list(inverse) == pytest.approx([0.19324, 0.41794, -0.29662, 1.23993, 0.0, 2.47985], abs=1e-5)


def test_random_numbers_differ_and_stay_below_one() -> None:
    drawn = [call("random") for _ in range(100)]
    assert len(set(drawn)) == 100
    assert all(0.0 <= value < 1.0 for value in drawn)


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("acos", (1.5,)),
        ("sqrt", (-1,)),
        ("log", (1, 5)),
        ("log", (-2, 5)),
        ("pow", (-1, 0.5)),
        ("pow", (0, -1)),
        ("pow", (1e300, 2)),
        ("floor", (math.inf,)),
        ("sin", ("1",)),
        ("cos", (True,)),
        ("norm", (["a"],)),
        ("norm", ("a",)),
        ("normalize", ([0, 0, 0],)),
        ("inv", ([[1, 2], [2, 4]],)),
        ("inv", ([[1, 2, 3], [2, 4, 5]],)),
        ("inv", ([[1, 2], [2]],)),
        ("make_list", (5000, 0)),
        ("make_list", (-1, 0)),
        ("make_list", (2, [1, 2])),
        ("binary_list_to_integer", ([1, 0],)),
        ("get_list_length", (5,)),
    ],
)
def test_what_is_not_defined_is_an_error(name: str, arguments: tuple[Value, ...]) -> None:
    with pytest.raises(ScriptRuntimeError):
        call(name, *arguments)
