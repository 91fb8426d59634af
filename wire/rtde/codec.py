"""Framing and data packages of RTDE, protocol versions 1 and 2.

Source: UR's RTDE guide. All numbers are big-endian. A package is a header (total size including the header `uint16`,
type `uint8`) and a payload. `encode()` returns a whole package, `decode()` takes a payload.
"""

import struct
from collections.abc import Callable, Iterator, Sequence
from enum import IntEnum
from operator import itemgetter
from typing import Any, cast

from wire.rtde.errors import FramingError, PackageError, RtdeErrorReason
from wire.rtde.fields import FieldType

SIZE_LIMIT = 0xFFFF
"""Largest package that a header can announce."""
REQUEST_LIMIT = 4096
"""Largest package that a client needs to send: a list of names, or the values of as many variables."""

Value = bool | int | float | Sequence[int] | Sequence[float]
"""Value of one variable to be sent: a scalar, or a sequence of its vector's length."""

Decoded = bool | int | float | tuple[int | float, ...]
"""Received value of one variable."""

_HEADER = struct.Struct(">HB")
HEADER_SIZE = _HEADER.size


class PackageType(IntEnum):
    """Second field of the header; each is an ASCII letter."""

    PROTOCOL_VERSION = ord("V")
    CONTROLLER_VERSION = ord("v")
    TEXT = ord("M")
    DATA = ord("U")
    SETUP_OUTPUTS = ord("O")
    SETUP_INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")


def frame(kind: int, payload: bytes = b"") -> bytes:
    """Return a whole package.

    Raises:
        PackageError: the payload is too long for a package.
    """
    size = HEADER_SIZE + len(payload)
    if size > SIZE_LIMIT:
        raise PackageError(
            RtdeErrorReason.MALFORMED, f"a package holds at most {SIZE_LIMIT} bytes, this one has {size}"
        )
    return _HEADER.pack(size, kind) + payload


class FrameReader:
    """Cuts a stream of bytes into packages, whatever its chunks. Holds at most one package and one chunk.

    Attributes:
        limit: largest package accepted, bytes with header; a smaller limit detects a broken stream earlier.
    """

    def __init__(self, limit: int = SIZE_LIMIT) -> None:
        self.limit = limit
        self._held = b""
        self._at = 0
        self._error: str | None = None

    def feed(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Append `data` and return the packages that are now complete, as type and payload, in order.

        Unread packages remain for the next call. A type that RTDE does not have is returned unchanged.

        Raises:
            FramingError: a length that no package has. It is raised after the good packages before it, and again on
                every later call, since the stream can no longer be trusted.
        """
        self._held = self._held[self._at :] + data if self._at < len(self._held) else data
        self._at = 0
        return self._packages()

    def _packages(self) -> Iterator[tuple[int, bytes]]:
        if self._error is None:
            while (start := self._at + HEADER_SIZE) <= len(self._held):
                size, kind = _HEADER.unpack_from(self._held, self._at)
                if not HEADER_SIZE <= size <= self.limit:
                    self._error = f"a package of {size} bytes, outside {HEADER_SIZE} to {self.limit}; type {kind}"
                    break
                end = self._at + size
                if end > len(self._held):
                    return
                self._at = end
                yield kind, self._held[start:end]
        if self._error is not None:
            self._held, self._at = b"", 0
            raise FramingError(self._error)


class Recipe:
    """Variables of a data package in order, with a compiled layout.

    Attributes:
        names: names of the variables.
        types: types of the variables.
        recipe_id: number given by the controller; None for an output recipe of protocol version 1, which has none.
        size: size of a payload, bytes.
    """

    def __init__(self, names: Sequence[str], types: Sequence[FieldType], recipe_id: int | None) -> None:
        """Compile the layout.

        Raises:
            PackageError: names and types differ in number, there are none, the id exceeds one byte, or the package is
                too long.
        """
        if len(names) != len(types) or not names:
            raise PackageError(
                RtdeErrorReason.MALFORMED, f"{len(names)} variables and {len(types)} types make no recipe"
            )
        if recipe_id is not None and not 0 <= recipe_id <= 0xFF:
            raise PackageError(RtdeErrorReason.MALFORMED, f"a recipe's id is one byte, not {recipe_id}")
        self.names = tuple(names)
        self.types = tuple(types)
        self.recipe_id = recipe_id
        head = "" if recipe_id is None else "B"
        body = "".join(f"{kind.count}{kind.letter}" for kind in types)
        self._payload = struct.Struct(f">{head}{body}")
        self._package = struct.Struct(f">HB{head}{body}")
        self.size = self._payload.size
        if self._package.size > SIZE_LIMIT:
            raise PackageError(
                RtdeErrorReason.MALFORMED, f"a package of {self._package.size} bytes is more than {SIZE_LIMIT}"
            )
        self._start = (self._package.size, PackageType.DATA, *(() if recipe_id is None else (recipe_id,)))
        self._counts = tuple(kind.count for kind in types)
        self._group = _grouping(self._counts, len(head))

    def encode(self, values: Sequence[Value]) -> bytes:
        """Return a whole data package with `values`, one for each variable in order.

        Raises:
            PackageError: a value is missing, not of its variable's type or out of its range.
        """
        flat: list[Any] = [*self._start]
        try:
            for value, count in zip(cast("Sequence[Any]", values), self._counts, strict=True):
                if count == 1:
                    flat.append(value)
                elif len(value) == count:
                    flat.extend(value)
                else:
                    raise ValueError
            return self._package.pack(*flat)
        except (struct.error, TypeError, ValueError, OverflowError):
            raise PackageError(RtdeErrorReason.WRONG_VALUE, self._fault(values)) from None

    def decode(self, payload: bytes) -> tuple[Decoded, ...]:
        """Return the values of a data package's payload: a number, or a tuple of them, for each variable in order.

        Raises:
            PackageError: the length or the recipe id is not this recipe's.
        """
        if self.recipe_id is not None and payload and payload[0] != self.recipe_id:
            text = f"a data package of recipe {payload[0]} where {self.recipe_id} was agreed"
            raise PackageError(RtdeErrorReason.WRONG_RECIPE, text)
        if len(payload) != self.size:
            text = f"a data package of recipe {self.recipe_id} has {self.size} bytes, this one {len(payload)}"
            raise PackageError(RtdeErrorReason.MALFORMED, text)
        return self._group(self._payload.unpack(payload))

    def _fault(self, values: Sequence[Value]) -> str:
        """Describe the value that does not fit."""
        if len(values) != len(self.names):
            return f"recipe {self.recipe_id} takes {len(self.names)} values, not {len(values)}"
        for name, kind, value in zip(self.names, self.types, cast("Sequence[Any]", values), strict=True):
            try:
                struct.pack(f">{kind.count}{kind.letter}", *([value] if kind.count == 1 else value))
            except (struct.error, TypeError, ValueError, OverflowError) as error:
                return f"{name} ({kind.name}) cannot be {value!r}: {error}"
        return f"recipe {self.recipe_id} cannot take {values!r}"


def _grouping(counts: Sequence[int], start: int) -> Callable[[tuple[int | float, ...]], tuple[Decoded, ...]]:
    """Return a function that groups the flat numbers of a package by variable, without a loop in Python."""
    keys: list[int | slice] = []
    for count in counts:
        keys.append(start if count == 1 else slice(start, start + count))
        start += count
    if all(count == 1 for count in counts):
        whole = slice(start - len(counts), start)
        return lambda flat: flat[whole]
    if len(keys) == 1:
        only = keys[0]
        return lambda flat: (flat[only],)
    return cast("Callable[[tuple[int | float, ...]], tuple[Decoded, ...]]", itemgetter(*keys))
