"""Operators of the language.

From UR's script manual, "Matrix and Array Expressions": `+ - * / %` work on two numbers, on a number and every element
of a list or matrix, and element by element on two lists of one length; `*` of a matrix with a matrix or a list is the
product of linear algebra. Indices count from 0. A pose counts as a list here and stays a pose.

Not in the manual: `/` returns a float even for two ints (UR's own client relies on it for integers from the network),
`%` has the sign of its left operand, and an int beyond 32 bits becomes a float.
"""

import math
import operator
from collections.abc import Callable
from typing import Final, TypeGuard

from .budget import BUDGET
from .errors import ScriptRuntimeError
from .values import (
    DEEPEST_VALUE,
    LARGEST_INT,
    LARGEST_LIST,
    LEAST_INT,
    LONGEST_TEXT,
    Pose,
    Struct,
    Value,
    integer,
    is_list,
    is_number,
    kind_of,
    number,
    truth,
    vector,
)

MOST_PRODUCTS: Final = 32_768
"""Largest number of multiplications in one product of matrices."""


def add(a: Value, b: Value) -> Value:
    """`a + b`; two strings are concatenated."""
    if type(a) is float and type(b) is float:
        return a + b
    if is_number(a) and is_number(b):
        return _fit(a + b)
    if type(a) is str and type(b) is str:
        return checked_text(a + b)
    return _elementwise("+", add, a, b)


def subtract(a: Value, b: Value) -> Value:
    """`a - b`."""
    if type(a) is float and type(b) is float:
        return a - b
    if is_number(a) and is_number(b):
        return _fit(a - b)
    return _elementwise("-", subtract, a, b)


def multiply(a: Value, b: Value) -> Value:
    """`a * b`."""
    if type(a) is float and type(b) is float:
        return a * b
    if is_number(a) and is_number(b):
        return _fit(a * b)
    if is_matrix(a) and is_list(b):
        return _product(a, b)
    return _elementwise("*", multiply, a, b)


def divide(a: Value, b: Value) -> Value:
    """`a / b`."""
    if is_number(a) and is_number(b):
        return a / b
    return _elementwise("/", divide, a, b)


def modulo(a: Value, b: Value) -> Value:
    """`a % b`."""
    if is_number(a) and is_number(b):
        if b == 0:
            raise ZeroDivisionError
        remainder = math.fmod(a, b)
        return int(remainder) if type(a) is int and type(b) is int else remainder
    return _elementwise("%", modulo, a, b)


def negate(a: Value) -> Value:
    """`-a`."""
    if type(a) is float:
        return -a
    return multiply(a, -1)


def identity(a: Value) -> Value:
    """`+a`."""
    return multiply(a, 1)


def ordered(compare: Callable[[float, float], bool]) -> Callable[[Value, Value], bool]:
    """Return one of `< <= > >=`, which order numbers only."""

    def comparison(a: Value, b: Value) -> bool:
        if is_number(a) and is_number(b):
            return compare(a, b)
        raise ScriptRuntimeError(f"Type error: a {kind_of(a)} and a {kind_of(b)} have no order")

    return comparison


less, less_or_equal = ordered(operator.lt), ordered(operator.le)
greater, greater_or_equal = ordered(operator.gt), ordered(operator.ge)


def equal(a: Value, b: Value) -> bool:
    """`a == b`; values of different types differ, but an int equals a float of the same value."""
    if is_list(a) and is_list(b):
        BUDGET.take(min(len(a), len(b)) >> 3)
    return a == b


def unequal(a: Value, b: Value) -> bool:
    """`a != b`."""
    return not equal(a, b)


def condition(value: Value) -> bool:
    """Return the truth of a value in `if`, `while` and logical operators: a bool as it is, a number if it is not 0."""
    return value if type(value) is bool else truth(value, "A condition")


def is_matrix(value: Value) -> TypeGuard[list[list[Value]]]:
    """Return True for a list whose first element is a list and not a pose."""
    return is_list(value) and type(value) is not Pose and bool(value) and type(value[0]) is list


def _fit(value: float) -> float:
    return value if type(value) is float or LEAST_INT <= value <= LARGEST_INT else float(value)


def _elementwise(sign: str, apply: Callable[[Value, Value], Value], a: Value, b: Value) -> Value:
    if is_list(a) and is_list(b):
        if len(a) != len(b):
            raise ScriptRuntimeError(f"Lists of {len(a)} and {len(b)} elements cannot be combined by {sign}")
        BUDGET.take(len(a))
        items = [apply(x, y) for x, y in zip(a, b, strict=True)]
        return Pose(items) if type(a) is Pose and type(b) is Pose else items
    if is_list(a) and is_number(b):
        BUDGET.take(len(a))
        items = [apply(x, b) for x in a]
        return Pose(items) if type(a) is Pose else items
    if is_number(a) and is_list(b):
        BUDGET.take(len(b))
        items = [apply(a, y) for y in b]
        return Pose(items) if type(b) is Pose else items
    raise ScriptRuntimeError(f"Type error: {sign} cannot be applied to a {kind_of(a)} and a {kind_of(b)}")


def _product(matrix: list[list[Value]], other: list[Value]) -> list[Value]:
    rows = [vector(row, len(matrix[0]), "A row of the matrix") for row in matrix]
    width = len(other)
    if len(rows[0]) != width:
        raise ScriptRuntimeError(f"A matrix of {len(rows[0])} columns cannot be multiplied with {width} rows")
    if is_matrix(other):
        columns = list(zip(*(vector(row, len(other[0]), "A row of the matrix") for row in other), strict=True))
    else:
        columns = [tuple(vector(other, width, "The list"))]
    products = len(rows) * width * len(columns)
    if products > MOST_PRODUCTS:
        raise ScriptRuntimeError(f"A product of {products} multiplications is too large: the most is {MOST_PRODUCTS}")
    BUDGET.take(2 * products)
    product = [[sum(map(operator.mul, row, column)) for column in columns] for row in rows]
    return product if is_matrix(other) else [row[0] for row in product]


def make_list(*items: Value) -> list[Value]:
    """`[...]`."""
    return checked_list(list(items))


def make_pose(*items: Value) -> Pose:
    """`p[x, y, z, rx, ry, rz]`."""
    return Pose([number(item, "An element of a pose") for item in items])


def make_struct(names: tuple[str, ...], *items: Value) -> Struct:
    """`struct(name = value, ...)`."""
    struct = Struct(zip(names, items, strict=True))
    _measure(struct, 1)
    return struct


def checked_list(items: list[Value]) -> list[Value]:
    """Return `items` if they are within the limits of size and depth of a value.

    Raises:
        ScriptRuntimeError: they exceed the limits.
    """
    if len(items) > LARGEST_LIST or any(isinstance(item, list | dict) for item in items):
        _measure(items, 1)
    return items


def _measure(value: Value, depth: int) -> int:
    """Count numbers, strings and booleans in `value`; a list without inner lists is counted by its length."""
    if isinstance(value, Struct):
        items = list(value.values())
    elif is_list(value):
        items = value
    else:
        return 1
    if depth > DEEPEST_VALUE:
        raise ScriptRuntimeError(f"Lists and structs can be nested {DEEPEST_VALUE} deep")
    size = sum(_measure(item, depth + 1) for item in items)
    BUDGET.take(len(items))
    if size > LARGEST_LIST:
        raise ScriptRuntimeError(f"A list cannot have more than {LARGEST_LIST} elements")
    return size


def checked_text(text: str) -> str:
    """Return `text` if it is no longer than a string may be.

    Raises:
        ScriptRuntimeError: it is longer.
    """
    if len(text) > LONGEST_TEXT:
        raise ScriptRuntimeError(f"A string cannot have more than {LONGEST_TEXT} characters")
    return text


def element(base: Value, *path: Value) -> Value:
    """`base[i]`, or `base[i, j]` of a matrix."""
    for index in path:
        if not is_list(base):
            raise ScriptRuntimeError(f"Type error: a {kind_of(base)} has no elements")
        base = base[_position(base, index)]
    return base


def field(base: Value, name: str) -> Value:
    """`base.name`."""
    if not isinstance(base, Struct):
        raise ScriptRuntimeError(f"Type error: a {kind_of(base)} has no field {name}")
    if name not in base:
        raise ScriptRuntimeError(f"The struct has no field {name}, it has {', '.join(base)}")
    return base[name]


def replaced(base: Value, value: Value, *path: Value) -> Value:
    """Return `base` with `value` at `path`, in which a string is the name of a field."""
    key, *rest = path
    if isinstance(base, Struct):
        inner: Value = field(base, key)
        struct = Struct(base)
        struct[key] = replaced(inner, value, *rest) if rest else value
        _measure(struct, 1)
        return struct
    if type(base) is Pose:
        pose = Pose(base)
        pose[_position(base, key)] = number(value, "An element of a pose")
        return pose
    if not is_list(base):
        raise ScriptRuntimeError(f"Type error: a {kind_of(base)} has no elements")
    BUDGET.take(len(base) >> 3)
    position = _position(base, key)
    items = base.copy()
    items[position] = replaced(items[position], value, *rest) if rest else value
    if isinstance(value, list | dict):
        _measure(items, 1)
    return items


def _with(base: list[Value], position: int, value: Value) -> list[Value]:
    items = base.copy()
    items.insert(position, value)
    if len(items) > LARGEST_LIST or isinstance(value, list | dict):
        _measure(items, 1)
    return items


def _position(base: list[Value], index: Value) -> int:
    position = index if type(index) is int else integer(index, "An index")
    if 0 <= position < len(base):
        return position
    raise ScriptRuntimeError(f"Index {position} is out of range: the list has {len(base)} elements")


def method(base: Value, name: str, *arguments: Value) -> tuple[Value, Value]:
    """Return the value that `base.name(...)` leaves in the variable, and its result.

    Lists of variable length: `length`, `append`, `pop`, `insert` and `clear` (PolyScope 5.15).
    """
    if not is_list(base) or type(base) is Pose:
        raise ScriptRuntimeError(f"Type error: a {kind_of(base)} has no method {name}")
    BUDGET.take(len(base) >> 3)
    match name, arguments:
        case "length", ():
            return base, len(base)
        case "clear", ():
            return [], None
        case "append", (value,):
            return _with(base, len(base), value), None
        case "pop", () if base:
            return base[:-1], base[-1]
        case "insert", (position, value) if integer(position, "A position") <= len(base):
            position = integer(position, "A position")
            if position >= 0:
                return _with(base, position, value), None
        case _:
            pass
    raise ScriptRuntimeError(f"A list of {len(base)} elements has no {name} with {len(arguments)} such arguments")
