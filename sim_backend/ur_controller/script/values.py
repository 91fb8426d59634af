"""Values of a script, and their checks in builtins.

An int is an int of 32 bits, a float a float, a string a str, a boolean a bool. A list is a list, a matrix a list of
lists of equal length, a pose a `Pose`, a struct a `Struct`. A thread handle is an int; 0 is no thread.

No value is ever changed in place: `q[0] = 1` gives the variable a new list. Assigning and passing by value, as the
language requires, therefore cost nothing. A builtin must not change a list that it was given or has returned.
"""

from typing import Any, TypeAlias, TypeGuard

from .errors import ScriptRuntimeError

Value: TypeAlias = Any
"""int, float, bool, str, list, `Pose`, `Struct`, or None if a function returned nothing."""

LEAST_INT, LARGEST_INT = -(2**31), 2**31 - 1
LONGEST_TEXT = 1_023
"""Characters of a string: the script manual's limit for str_cat and to_str."""
LARGEST_LIST = 4_096
LARGEST_QUANTITY = 1e3
"""Largest input to the arm's motion and dynamics, SI units and rad: beyond any arm, far from overflow."""
DEEPEST_VALUE = 4


class Pose(list[float]):
    """`p[x, y, z, rx, ry, rz]`, m and rotation vector in rad; equal to poses only."""

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        return type(other) is Pose and list.__eq__(self, other)

    def __ne__(self, other: object) -> bool:
        return not self == other

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"p{list.__repr__(self)}"


class Struct(dict[str, Value]):
    """`struct(name = value, ...)`, read and written as `s.name`."""

    __slots__ = ()


def is_number(value: Value) -> TypeGuard[int | float]:
    """Return True if `value` is an int or a float; a bool is neither."""
    return type(value) is float or type(value) is int


def is_list(value: Value) -> TypeGuard[list[Value]]:
    """Return True if `value` is a list, a matrix or a pose."""
    return isinstance(value, list)


def kind_of(value: Value) -> str:
    """Return the type's name in error texts."""
    match value:
        case None:
            return "no value"
        case bool():
            return "bool"
        case int():
            return "int"
        case float():
            return "float"
        case str():
            return "string"
        case Pose():
            return "pose"
        case Struct():
            return "struct"
        case [list(), *_] if not isinstance(value[0], Pose):
            return "matrix"
        case _:
            return "list"


def number(value: Value, what: str) -> float:
    """Return `value` as a float.

    Raises:
        ScriptRuntimeError: it is not a number; the text names it as `what`.
    """
    if type(value) is float:
        return value
    if type(value) is int:
        return float(value)
    raise ScriptRuntimeError(f"Type error: {what} must be a number, not a {kind_of(value)}")


def integer(value: Value, what: str) -> int:
    """Return `value` as an int; a whole float is accepted.

    Raises:
        ScriptRuntimeError: it is not a whole number.
    """
    if type(value) is int:
        return value
    if type(value) is float and value.is_integer() and LEAST_INT <= value <= LARGEST_INT:
        return int(value)
    raise ScriptRuntimeError(f"Type error: {what} must be an int, not {text_of_kind(value)}")


def truth(value: Value, what: str) -> bool:
    """Return `value` as a condition; it must be a bool or a number, which is true if not zero.

    Raises:
        ScriptRuntimeError: it is neither.
    """
    if type(value) is bool:
        return value
    if is_number(value):
        return value != 0
    raise ScriptRuntimeError(f"Type error: {what} must be a bool, not a {kind_of(value)}")


def text(value: Value, what: str) -> str:
    """Return `value`, which must be a string.

    Raises:
        ScriptRuntimeError: it is not a string.
    """
    if type(value) is str:
        return value
    raise ScriptRuntimeError(f"Type error: {what} must be a string, not a {kind_of(value)}")


def vector(value: Value, length: int, what: str) -> list[float]:
    """Return `value`, a list or a pose of `length` numbers, as a new list of floats.

    Raises:
        ScriptRuntimeError: it is not such a list.
    """
    if is_list(value) and len(value) == length:
        if all(type(item) is float for item in value):
            return list(value)
        return [number(item, f"{what}[{index}]") for index, item in enumerate(value)]
    raise ScriptRuntimeError(f"Type error: {what} must be a list of {length} numbers, not {text_of_kind(value)}")


def quantities(value: Value, length: int, what: str) -> list[float]:
    """Return `value` as `vector` does; its numbers must be within the range of the arm's computations.

    Raises:
        ScriptRuntimeError: it is not such a list, or a number exceeds `LARGEST_QUANTITY` or is NaN.
    """
    numbers = vector(value, length, what)
    if all(-LARGEST_QUANTITY <= item <= LARGEST_QUANTITY for item in numbers):
        return numbers
    raise ScriptRuntimeError(f"{what} must hold finite numbers up to {LARGEST_QUANTITY:.0f} only, not {numbers}")


def pose(value: Value, what: str) -> list[float]:
    """Return `value`, which must be a pose, as a new list of 6 floats: m, rad.

    Raises:
        ScriptRuntimeError: it is not a pose; a list of six numbers is not accepted.
    """
    if type(value) is Pose:
        return list(value)
    raise ScriptRuntimeError(f"Type error: {what} must be a pose, not {text_of_kind(value)}")


def text_of_kind(value: Value) -> str:
    """Return the type and, for a list, the length, for an error text."""
    return f"a {kind_of(value)}" + (f" of {len(value)}" if is_list(value) else "")
