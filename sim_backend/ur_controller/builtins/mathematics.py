"""URScript's mathematics: numbers, lists and matrices. UR's script manual, "Module urmath"."""

import math
import random as pseudo_random
from collections.abc import Callable
from typing import Final

import numpy as np

from sim_backend.ur_controller.script import Builtin, Pose, ScriptRuntimeError, Value
from sim_backend.ur_controller.script.arithmetic import checked_list, is_matrix
from sim_backend.ur_controller.script.budget import BUDGET
from sim_backend.ur_controller.script.values import (
    LARGEST_INT,
    LARGEST_LIST,
    LEAST_INT,
    integer,
    is_list,
    is_number,
    kind_of,
    number,
    vector,
)

from .poses import pose_inv

_BITS: Final = 32
_random: Final = pseudo_random.Random(0)  # noqa: S311  # not secret; the same in every run


def acos(f: Value) -> float:
    return _in_domain("acos", math.acos, f)


def asin(f: Value) -> float:
    return _in_domain("asin", math.asin, f)


def atan(f: Value) -> float:
    return math.atan(number(f, "f"))


def atan2(x: Value, y: Value) -> float:
    """Arc tangent of x / y, in the quadrant of both signs."""
    return math.atan2(number(x, "x"), number(y, "y"))


def cos(f: Value) -> float:
    return _in_domain("cos", math.cos, f)


def sin(f: Value) -> float:
    return _in_domain("sin", math.sin, f)


def tan(f: Value) -> float:
    return _in_domain("tan", math.tan, f)


def sqrt(f: Value) -> float:
    return _in_domain("sqrt", math.sqrt, f)


def log(b: Value, f: Value) -> float:
    """Logarithm of `f` to the base `b`."""
    base, value = number(b, "b"), number(f, "f")
    if base <= 0.0 or base == 1.0 or value <= 0.0:
        raise ScriptRuntimeError(f"log is not defined for base {base} and {value}")
    return math.log(value) / math.log(base)


def pow_(base: Value, exponent: Value) -> float:
    try:
        return math.pow(number(base, "base"), number(exponent, "exponent"))
    except (ValueError, OverflowError):
        raise ScriptRuntimeError(f"pow is not defined for {base} and {exponent}") from None


def d2r(d: Value) -> float:
    return math.radians(number(d, "d"))


def r2d(r: Value) -> float:
    return math.degrees(number(r, "r"))


def ceil(f: Value) -> float:
    return _whole("ceil", math.ceil, f)


def floor(f: Value) -> float:
    return _whole("floor", math.floor, f)


def random() -> float:
    return _random.random()


def norm(a: Value) -> float:
    """Size of a number, Euclidean length of a list or of all six elements of a pose."""
    if is_number(a):
        return abs(a) if a != LEAST_INT else -float(LEAST_INT)
    return math.hypot(*vector(a, _length_of(a), "a"))


def normalize(v: Value) -> list[float]:
    items = vector(v, _length_of(v), "v")
    length = math.hypot(*items)
    if length == 0.0:
        raise ScriptRuntimeError("normalize is not defined for a list of zeros")
    return [item / length for item in items]


def get_list_length(v: Value) -> int:
    return _length_of(v)


def length(v: Value) -> int:
    """Elements of a list, bytes of a string."""
    return len(v.encode()) if isinstance(v, str) else _length_of(v)


def size(v: Value) -> Value:
    """Rows and columns of a matrix, else what `length` gives."""
    return [len(v), len(v[0])] if is_matrix(v) else length(v)


def make_list(length: Value, initial_value: Value, capacity: Value = None) -> list[Value]:
    """Return `length` times `initial_value`; `capacity` has no effect, since lists grow as needed."""
    count = integer(length, "length")
    most = count if capacity is None else integer(capacity, "capacity")
    if not 0 <= count <= most <= LARGEST_LIST:
        raise ScriptRuntimeError(f"A list can have 0 … {LARGEST_LIST} elements, not {count} of {most}")
    if is_list(initial_value) and not isinstance(initial_value, Pose):
        raise ScriptRuntimeError("Type error: make_list cannot make a list of lists")
    BUDGET.take(count)
    return checked_list([initial_value] * count)


def integer_to_binary_list(x: Value) -> list[bool]:
    """32 booleans, the least significant first."""
    value = integer(x, "x")
    return [bool(value >> bit & 1) for bit in range(_BITS)]


def binary_list_to_integer(l: Value) -> int:  # noqa: E741  # the manual's name
    """Return the signed integer of up to 32 booleans, the least significant first; further ones are ignored."""
    if not is_list(l) or any(type(bit) is not bool for bit in l[:_BITS]):
        raise ScriptRuntimeError(f"Type error: l must be a list of booleans, not a {kind_of(l)}")
    value = sum(1 << position for position, bit in enumerate(l[:_BITS]) if bit)
    return value - (1 << _BITS) if value > LARGEST_INT else value


def inv(m: Value) -> Value:
    """Inverse of a square matrix or a pose."""
    if isinstance(m, Pose):
        return pose_inv(m)
    rows = _matrix_of(m)
    if len(rows) != len(rows[0]):
        raise ScriptRuntimeError(f"Only a square matrix has an inverse, not {len(rows)} × {len(rows[0])}")
    BUDGET.take(200 + len(rows) ** 2)
    try:
        inverse: list[list[float]] = np.linalg.inv(np.array(rows)).tolist()
    except np.linalg.LinAlgError:
        raise ScriptRuntimeError("The matrix is singular and has no inverse") from None
    return inverse


def transpose(m: Value) -> Value:
    """Transpose of a matrix; a list becomes a column and a column a list."""
    if is_list(m) and not is_matrix(m):
        return [[item] for item in vector(m, len(m), "m")]
    rows = _matrix_of(m)
    BUDGET.take(len(rows) * len(rows[0]))
    return [row[0] for row in rows] if len(rows[0]) == 1 else [list(column) for column in zip(*rows, strict=True)]


def _in_domain(name: str, function: Callable[[float], float], f: Value) -> float:
    value = number(f, "f")
    try:
        return function(value)
    except ValueError:
        raise ScriptRuntimeError(f"{name} is not defined for {value}") from None


def _whole(name: str, function: Callable[[float], int], f: Value) -> float:
    value = number(f, "f")
    if not math.isfinite(value):
        raise ScriptRuntimeError(f"{name} is not defined for {value}")
    whole = function(value)
    return whole if LEAST_INT <= whole <= LARGEST_INT else float(whole)


def _length_of(v: Value) -> int:
    if not is_list(v):
        raise ScriptRuntimeError(f"Type error: a list is needed, not a {kind_of(v)}")
    BUDGET.take(len(v) >> 3)
    return len(v)


def _matrix_of(m: Value) -> list[list[float]]:
    if not is_matrix(m) or not m[0]:
        raise ScriptRuntimeError(f"Type error: m must be a matrix, not a {kind_of(m)}")
    return [vector(row, len(m[0]), f"Row {index} of m") for index, row in enumerate(m)]


MATHEMATICS: Final = {
    function.__name__.rstrip("_"): Builtin.of(function)
    for function in (
        acos,
        asin,
        atan,
        atan2,
        binary_list_to_integer,
        ceil,
        cos,
        d2r,
        floor,
        get_list_length,
        integer_to_binary_list,
        inv,
        length,
        log,
        make_list,
        norm,
        normalize,
        pow_,
        r2d,
        random,
        sin,
        size,
        sqrt,
        tan,
        transpose,
    )
}
"""Builtins by script name."""
