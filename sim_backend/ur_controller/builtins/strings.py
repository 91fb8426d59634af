"""URScript's strings. UR's script manual, "Module internals".

Positions and lengths count bytes of UTF-8, as in the manual.
"""

import re
from typing import Final

from sim_backend.ur_controller.script import Builtin, Pose, ScriptRuntimeError, Value
from sim_backend.ur_controller.script.arithmetic import checked_text
from sim_backend.ur_controller.script.budget import BUDGET
from sim_backend.ur_controller.script.values import (
    LARGEST_INT,
    LEAST_INT,
    integer,
    is_list,
    kind_of,
    text,
)

_QUOTED: Final = 40
"""Characters of a string that an error text quotes."""
_NUMBER: Final = re.compile(
    r"\s*(?P<hexadecimal>[+-]?0[xX][0-9A-Fa-f]+)|"
    r"\s*(?P<decimal>[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?)|"
    r"\s*(?P<special>[+-]?(inf(inity)?|nan))",
    re.ASCII | re.IGNORECASE,
)


def text_of(value: Value) -> str:
    """Write a value as `to_str`, `str_cat` and `textmsg` do: floats with 6 decimals less trailing zeros.

    Raises:
        ScriptRuntimeError: the value is a struct, None, or longer than a string may be.
    """
    if isinstance(value, str):
        return value
    return checked_text(_written(value))


def to_str(val: Value) -> str:
    return text_of(val)


def str_cat(op1: Value, op2: Value) -> str:
    return checked_text(text_of(op1) + text_of(op2))


def str_at(src: Value, index: Value) -> str:
    """Return the character whose byte is at `index`."""
    data, position = text(src, "src").encode(), integer(index, "index")
    if not 0 <= position < len(data):
        raise ScriptRuntimeError(f"Index {position} is out of range: the string has {len(data)} bytes")
    return _decoded(data[position : position + 1])


def str_empty(str_: Value) -> bool:
    return not text(str_, "str")


def str_find(src: Value, target: Value, start_from: Value = 0) -> int:
    """Return the position of the first `target` at or after `start_from`, -1 if there is none."""
    data, start = text(src, "src").encode(), integer(start_from, "start_from")
    if not 0 <= start <= len(data):
        raise ScriptRuntimeError(f"Position {start} is out of range: the string has {len(data)} bytes")
    return data.find(text(target, "target").encode(), start)


def str_len(str_: Value) -> int:
    return len(text(str_, "str").encode())


def str_sub(src: Value, index: Value, len_: Value = LARGEST_INT) -> str:
    """Return at most `len` bytes from `index`."""
    data, start, length = text(src, "src").encode(), integer(index, "index"), integer(len_, "len")
    if not 0 <= start <= len(data) or length < 0:
        raise ScriptRuntimeError(f"{length} bytes from {start} are out of range: the string has {len(data)} bytes")
    return _decoded(data[start : start + length])


def to_num(str_: Value) -> float:
    """Return an int, or a float if there is a decimal point or the value is not whole."""
    source = text(str_, "str")
    match = _NUMBER.fullmatch(source)
    if match is None:
        raise ScriptRuntimeError(f'"{source[:_QUOTED]}" is not a number')
    if match["hexadecimal"]:
        return _within_int(int(match["hexadecimal"], 16), source)
    if match["decimal"] and "." not in source:
        value = float(match["decimal"])
        return _within_int(int(value), source) if value.is_integer() else value
    return float(source)


def _within_int(value: int, source: str) -> int:
    if not LEAST_INT <= value <= LARGEST_INT:
        raise ScriptRuntimeError(f'"{source[:_QUOTED]}" is out of the range of an int')
    return value


def _decoded(data: bytes) -> str:
    return data.decode(errors="replace")


def _written(value: Value) -> str:
    if isinstance(value, int):  # a bool too
        return str(value)
    if isinstance(value, float):
        written = f"{value:.6f}"
        return written.rstrip("0").rstrip(".") if "." in written else written
    if is_list(value):
        BUDGET.take(len(value))
        if len(value) > 512:  # with its separators longer than a string may be
            return checked_text(" " * 2 * len(value))
        inner = ", ".join(f'"{checked_text(item)}"' if isinstance(item, str) else _written(item) for item in value)
        return f"p[{inner}]" if isinstance(value, Pose) else f"[{inner}]"
    raise ScriptRuntimeError(f"Type error: a {kind_of(value)} cannot be written as a string")


STRINGS: Final = {
    function.__name__: Builtin.of(function)
    for function in (str_at, str_cat, str_empty, str_find, str_len, str_sub, to_num, to_str)
}
"""Builtins by script name."""
