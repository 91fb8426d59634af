"""Requests and replies of RTDE, protocol versions 1 and 2: all packages except the data packages.

Source: UR's RTDE guide. `encode()` returns a whole package, `decode()` takes a payload.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple, Self

from wire.rtde.codec import PackageType, Recipe, frame
from wire.rtde.errors import PackageError, RtdeErrorReason, SetupError
from wire.rtde.fields import FieldType

PORT = 30004
PROTOCOL_VERSION = 2
NAMES_LIMIT = 2048
"""Largest size of a list of variable names, bytes, commas included."""

_LENGTHS = "the lengths inside a text message do not add up"
_VERSION = struct.Struct(">H")
_CONTROLLER = struct.Struct(">4I")
_FREQUENCY = struct.Struct(">d")


class Level(IntEnum):
    """Severity of a text message."""

    EXCEPTION = 0
    ERROR = 1
    WARNING = 2
    INFO = 3


class ControllerVersion(NamedTuple):
    """Version of the controller's software; tuples compare in this order."""

    major: int
    minor: int
    bugfix: int
    build: int

    def encode(self) -> bytes:
        """Return the reply to a request of type CONTROLLER_VERSION, which has no payload."""
        return frame(PackageType.CONTROLLER_VERSION, _CONTROLLER.pack(*self))

    @classmethod
    def decode(cls, payload: bytes) -> Self:
        """Read the reply.

        Raises:
            PackageError: the length is wrong.
        """
        _check(len(payload) == _CONTROLLER.size, "a controller version has four numbers of four bytes", payload)
        return cls(*_CONTROLLER.unpack(payload))


def encode_version_request(version: int = PROTOCOL_VERSION) -> bytes:
    """Ask the controller to speak a version of the protocol."""
    return frame(PackageType.PROTOCOL_VERSION, _VERSION.pack(version))


def decode_version_request(payload: bytes) -> int:
    """Return the version asked for.

    Raises:
        PackageError: the length is wrong.
    """
    _check(len(payload) == _VERSION.size, "a protocol version has two bytes", payload)
    return _VERSION.unpack(payload)[0]


def encode_accepted(kind: PackageType, accepted: bool) -> bytes:
    """Answer a request for a protocol version, or for the start or the pause of the data."""
    return frame(kind, b"\x01" if accepted else b"\x00")


def decode_accepted(payload: bytes) -> bool:
    """Return whether the controller agreed.

    Raises:
        PackageError: the length is wrong.
    """
    _check(len(payload) == 1, "an acceptance has one byte", payload)
    return payload[0] != 0


@dataclass(frozen=True, slots=True)
class OutputsRequest:
    """The variables that a client wants to receive; a later request replaces an earlier one.

    Attributes:
        names: variables in the order of the data packages.
        frequency_hz: rate of the data packages; None in protocol version 1, which has none.
    """

    names: tuple[str, ...]
    frequency_hz: float | None

    def encode(self) -> bytes:
        """Return the request in the version of the protocol that `frequency_hz` implies.

        Raises:
            PackageError: the names exceed `NAMES_LIMIT`.
        """
        head = b"" if self.frequency_hz is None else _FREQUENCY.pack(self.frequency_hz)
        return frame(PackageType.SETUP_OUTPUTS, head + _encode_names(self.names))

    @classmethod
    def decode(cls, payload: bytes, version: int = PROTOCOL_VERSION) -> Self:
        """Read a request in a version of the protocol.

        Raises:
            PackageError: the frequency is missing, or the names exceed `NAMES_LIMIT`.
        """
        if version < PROTOCOL_VERSION:
            return cls(_decode_names(payload), None)
        _check(len(payload) >= _FREQUENCY.size, "a request for outputs starts with a frequency of eight bytes", payload)
        return cls(_decode_names(payload[_FREQUENCY.size :]), _FREQUENCY.unpack_from(payload)[0])


@dataclass(frozen=True, slots=True)
class InputsRequest:
    """Variables that a client wants to write with one more input recipe, in the order of its data packages."""

    names: tuple[str, ...]

    def encode(self) -> bytes:
        """Return the request.

        Raises:
            PackageError: the names exceed `NAMES_LIMIT`.
        """
        return frame(PackageType.SETUP_INPUTS, _encode_names(self.names))

    @classmethod
    def decode(cls, payload: bytes) -> Self:
        """Read a request.

        Raises:
            PackageError: the names exceed `NAMES_LIMIT`.
        """
        return cls(_decode_names(payload))


@dataclass(frozen=True, slots=True)
class SetupReply:
    """Answer to a request for outputs or inputs.

    Attributes:
        types: one entry for each variable asked for: a name of `FieldType`, NOT_FOUND or IN_USE.
        recipe_id: number of the recipe; 0 if a variable was refused, None for outputs in protocol version 1.
    """

    types: tuple[str, ...]
    recipe_id: int | None

    def encode(self, kind: PackageType) -> bytes:
        """Return the answer to a request of type `kind`."""
        head = b"" if self.recipe_id is None else bytes([self.recipe_id])
        return frame(kind, head + ",".join(self.types).encode("ascii"))

    @classmethod
    def decode(cls, payload: bytes, *, with_id: bool = True) -> Self:
        """Read an answer; `with_id` is False for outputs in protocol version 1.

        Raises:
            PackageError: the recipe id is missing.
        """
        _check(len(payload) >= with_id, "an answer to a set-up starts with a recipe id", payload)
        return cls(_split(payload[with_id:]), payload[0] if with_id else None)

    def recipe(self, names: Sequence[str]) -> Recipe:
        """Return the recipe that was agreed for the variables asked for.

        Raises:
            SetupError: variables were refused; the error names each.
            PackageError: the answer does not match the request, or names a type that RTDE does not have.
        """
        if len(self.types) != len(names):
            text = f"{len(self.types)} types came back for {len(names)} variables: {', '.join(self.types)}"
            raise PackageError(RtdeErrorReason.MALFORMED, text)
        answers = list(zip(names, self.types, strict=True))
        if refused := {
            name: RtdeErrorReason(kind)
            for name, kind in answers
            if kind in (RtdeErrorReason.NOT_FOUND, RtdeErrorReason.IN_USE)
        }:
            raise SetupError(refused)
        if unknown := [f"{name} as {kind!r}" for name, kind in answers if kind not in FieldType.__members__]:
            raise PackageError(
                RtdeErrorReason.MALFORMED, f"the controller gives {', '.join(unknown)}, which is not an RTDE type"
            )
        if self.recipe_id == 0:
            raise PackageError(
                RtdeErrorReason.REFUSED, f"the controller accepts each of {', '.join(names)} but not the recipe"
            )
        return Recipe(names, [FieldType[kind] for kind in self.types], self.recipe_id)


@dataclass(frozen=True, slots=True)
class TextMessage:
    """Message in words from one end to the other; a real controller writes it to PolyScope's log.

    Attributes:
        message: at most 255 bytes of UTF-8; a longer text is cut.
        source: sender, at most 255 bytes; empty in protocol version 1 from the controller, which names none.
        level: a `Level`, or a number unknown here.
    """

    message: str
    source: str = ""
    level: int = Level.INFO

    def encode(self) -> bytes:
        """Return the message as in protocol version 2, and in version 1 from client to controller."""
        return frame(PackageType.TEXT, _encode_text(self.message) + _encode_text(self.source) + bytes([self.level]))

    def encode_v1(self) -> bytes:
        """Return the message as a controller sends it in protocol version 1."""
        return frame(PackageType.TEXT, bytes([self.level]) + self.message.encode(errors="replace"))

    @classmethod
    def decode(cls, payload: bytes) -> Self:
        """Read a message as in protocol version 2. Bytes that are not UTF-8 are replaced.

        Raises:
            PackageError: the lengths inside do not add up.
        """
        message, rest = _take_text(payload)
        source, level = _take_text(rest)
        _check(len(level) == 1, _LENGTHS, payload)
        return cls(message, source, level[0])

    @classmethod
    def decode_v1(cls, payload: bytes) -> Self:
        """Read a message as a controller sends it in protocol version 1.

        Raises:
            PackageError: the level is missing.
        """
        _check(bool(payload), "a text message starts with a level", payload)
        return cls(payload[1:].decode(errors="replace"), "", payload[0])


def _check(holds: bool, rule: str, payload: bytes) -> None:
    if not holds:
        raise PackageError(RtdeErrorReason.MALFORMED, f"{rule}, not {len(payload)} bytes: {payload[:32].hex()}")


def _encode_names(names: Sequence[str]) -> bytes:
    encoded = ",".join(names).encode("latin-1", errors="replace")
    _check(len(encoded) <= NAMES_LIMIT, f"a list of variables has at most {NAMES_LIMIT} bytes", encoded)
    return encoded


def _decode_names(payload: bytes) -> tuple[str, ...]:
    _check(len(payload) <= NAMES_LIMIT, f"a list of variables has at most {NAMES_LIMIT} bytes", payload)
    return _split(payload)


def _split(payload: bytes) -> tuple[str, ...]:
    """Split a list of names. Some clients end it with a comma, so an empty name is dropped; bytes that no name has
    yield an unknown name.
    """
    return tuple(name for name in payload.decode("latin-1").split(",") if name)


def _encode_text(text: str) -> bytes:
    """Encode a length byte and the text, cut at 255 bytes without cutting a character."""
    encoded = text.encode(errors="replace")[:0xFF].decode(errors="ignore").encode()
    return bytes([len(encoded)]) + encoded


def _take_text(payload: bytes) -> tuple[str, bytes]:
    """Return a text whose length precedes it, and the rest of the payload."""
    end = 1 + payload[0] if payload else 1
    _check(end <= len(payload), _LENGTHS, payload)
    return payload[1:end].decode(errors="replace"), payload[end:]
