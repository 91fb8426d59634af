"""Robot messages of the primary interface: versions, program starts and ends, errors, safety modes, texts.

Layouts are those of the vendor's client interface document for e-Series 5.x, as its client library reads them.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from types import MappingProxyType
from typing import Any, ClassVar, Self

from wire.primary.errors import PrimaryError, PrimaryErrorReason

PROGRAM_STARTED = "PROGRAM_XXX_STARTED"
PROGRAM_STOPPED = "PROGRAM_XXX_STOPPED"
"""Titles of key messages; their text is the program's name."""

_HEADER = struct.Struct(">QbB")
_VERSION = struct.Struct(">BBii")
_KEY = struct.Struct(">iiB")
_SAFETY_MODE = struct.Struct(">iiBII")
_ERROR_CODE = struct.Struct(">iiiII")
_PLACE = struct.Struct(">ii")
_POPUP = struct.Struct(">IB???B")
_TITLE_BYTES = 255


class MessageType(IntEnum):
    """Types of robot messages."""

    TEXT = 0
    PROGRAM_LABEL = 1
    POPUP = 2
    VERSION = 3
    SAFETY_MODE = 5
    ERROR_CODE = 6
    KEY = 7
    REQUEST_VALUE = 9
    RUNTIME_EXCEPTION = 10


class Source(IntEnum):
    """Senders of messages."""

    ROBOT_INTERFACE = -2
    RUNTIME = -3
    CONTROLLER = -1


class ReportLevel(IntEnum):
    """Severity of an error code."""

    DEBUG = 0
    INFO = 1
    WARNING = 2
    VIOLATION = 3
    FAULT = 4
    CRITICAL_FAULT = 5
    DEVELOPER_DEBUG = 128
    DEVELOPER_INFO = 129
    DEVELOPER_WARNING = 130
    DEVELOPER_VIOLATION = 131
    DEVELOPER_FAULT = 132
    DEVELOPER_CRITICAL_FAULT = 133


@dataclass(frozen=True, slots=True)
class Message:
    """Content of a robot message, apart from its time and source."""

    TYPE: ClassVar[MessageType]

    def encode(self) -> bytes:
        """Return the content after the header."""
        raise NotImplementedError

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Read the content after the header.

        Raises:
            PrimaryError: MALFORMED.
        """
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class Text(Message):
    """A line from a script, such as `textmsg` sends."""

    TYPE = MessageType.TEXT

    text: str

    def encode(self) -> bytes:
        """Return the content after the header."""
        return self.text.encode()

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Read the content after the header."""
        return cls(_text(data))


@dataclass(frozen=True, slots=True)
class Version(Message):
    """First message of a connection; it identifies the controller."""

    TYPE = MessageType.VERSION

    project: str
    major: int
    minor: int
    bugfix: int
    build: int
    build_date: str

    def encode(self) -> bytes:
        """Return the content after the header."""
        numbers = _VERSION.pack(self.major, self.minor, self.bugfix, self.build)
        return _titled(self.project) + numbers + self.build_date.encode()

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Read the content after the header.

        Raises:
            PrimaryError: MALFORMED.
        """
        project, rest = _split_title(data, cls.__name__)
        major, minor, bugfix, build = _unpack(_VERSION, rest, cls.__name__)
        return cls(project, major, minor, bugfix, build, _text(rest[_VERSION.size :]))


@dataclass(frozen=True, slots=True)
class Key(Message):
    """An event with a title, such as the start of a program."""

    TYPE = MessageType.KEY

    title: str
    text: str
    code: int = 0
    argument: int = 0

    def encode(self) -> bytes:
        """Return the content after the header."""
        title = _cut(self.title)
        return _KEY.pack(self.code, self.argument, len(title)) + title + self.text.encode()

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Read the content after the header.

        Raises:
            PrimaryError: MALFORMED.
        """
        code, argument, _ = _unpack(_KEY, data, cls.__name__)
        title, text = _split_title(data[_KEY.size - 1 :], cls.__name__)
        return cls(title, _text(text), code, argument)


@dataclass(frozen=True, slots=True)
class ErrorCode(Message):
    """An error of the controller, `C<code>A<argument>` in its log.

    Attributes:
        code: 210 means that the connection was made in local control and cannot command.
        argument: case of the error.
        level: a `ReportLevel`; a newer controller may send others.
        text: detail.
        data_type: type of `data`.
        data: further detail.
    """

    TYPE = MessageType.ERROR_CODE
    READ_ONLY: ClassVar[int] = 210

    code: int
    argument: int
    level: int
    text: str = ""
    data_type: int = 0
    data: int = 0

    def encode(self) -> bytes:
        """Return the content after the header."""
        return _ERROR_CODE.pack(self.code, self.argument, self.level, self.data_type, self.data) + self.text.encode()

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Read the content after the header.

        Raises:
            PrimaryError: MALFORMED.
        """
        code, argument, level, data_type, detail = _unpack(_ERROR_CODE, data, cls.__name__)
        return cls(code, argument, level, _text(data[_ERROR_CODE.size :]), data_type, detail)


@dataclass(frozen=True, slots=True)
class SafetyMode(Message):
    """A change of the safety mode, in UR numbering."""

    TYPE = MessageType.SAFETY_MODE

    mode: int
    code: int = 0
    argument: int = 0
    data_type: int = 0
    data: int = 0

    def encode(self) -> bytes:
        """Return the content after the header."""
        return _SAFETY_MODE.pack(self.code, self.argument, self.mode, self.data_type, self.data)

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Read the content after the header.

        Raises:
            PrimaryError: MALFORMED.
        """
        code, argument, mode, data_type, detail = _unpack(_SAFETY_MODE, data, cls.__name__)
        return cls(mode, code, argument, data_type, detail)


@dataclass(frozen=True, slots=True)
class RuntimeException(Message):
    """A script failed to compile or failed while it ran; line and column count from 1."""

    TYPE = MessageType.RUNTIME_EXCEPTION

    line: int
    column: int
    text: str

    def encode(self) -> bytes:
        """Return the content after the header."""
        return _PLACE.pack(self.line, self.column) + self.text.encode()

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Read the content after the header.

        Raises:
            PrimaryError: MALFORMED.
        """
        line, column = _unpack(_PLACE, data, cls.__name__)
        return cls(line, column, _text(data[_PLACE.size :]))


@dataclass(frozen=True, slots=True)
class Popup(Message):
    """A window on the pendant."""

    TYPE = MessageType.POPUP

    title: str
    text: str
    is_warning: bool = False
    is_error: bool = False
    is_blocking: bool = False
    request_id: int = 0
    request_type: int = 0

    def encode(self) -> bytes:
        """Return the content after the header."""
        title = _cut(self.title)
        flags = self.is_warning, self.is_error, self.is_blocking
        return _POPUP.pack(self.request_id, self.request_type, *flags, len(title)) + title + self.text.encode()

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Read the content after the header.

        Raises:
            PrimaryError: MALFORMED.
        """
        request_id, request_type, is_warning, is_error, is_blocking, _ = _unpack(_POPUP, data, cls.__name__)
        title, text = _split_title(data[_POPUP.size - 1 :], cls.__name__)
        return cls(title, _text(text), is_warning, is_error, is_blocking, request_id, request_type)


@dataclass(frozen=True, slots=True)
class Received:
    """A robot message as received.

    Attributes:
        timestamp_us: time of the controller, µs; some controllers leave it 0.
        source: a `Source`, or a number unknown here.
        message: content; None if its type is unknown here.
    """

    timestamp_us: int
    source: int
    message: Message | None


_KNOWN: Mapping[int, type[Message]] = MappingProxyType(
    {one.TYPE: one for one in (Text, Version, Key, ErrorCode, SafetyMode, RuntimeException, Popup)}
)


def encode_message(message: Message, timestamp_us: int = 0, source: int = Source.ROBOT_INTERFACE) -> bytes:
    """Return the content of a robot message."""
    return _HEADER.pack(timestamp_us, source, message.TYPE) + message.encode()


def decode_message(content: bytes) -> Received:
    """Read a robot message.

    Raises:
        PrimaryError: MALFORMED.
    """
    timestamp_us, source, kind = _unpack(_HEADER, content, "the header of a robot message")
    known = _KNOWN.get(kind)
    return Received(timestamp_us, source, known.decode(content[_HEADER.size :]) if known else None)


def _unpack(layout: struct.Struct, data: bytes, what: str) -> tuple[Any, ...]:
    if len(data) < layout.size:
        raise PrimaryError(PrimaryErrorReason.MALFORMED, f"{what} has {len(data)} bytes, it needs {layout.size}")
    return layout.unpack_from(data)


def _titled(title: str) -> bytes:
    cut = _cut(title)
    return bytes((len(cut),)) + cut


def _cut(title: str) -> bytes:
    return title.encode()[:_TITLE_BYTES]


def _split_title(data: bytes, what: str) -> tuple[str, bytes]:
    """Split off a text that its length precedes; return the text and the rest."""
    if not data or len(data) < 1 + data[0]:
        raise PrimaryError(PrimaryErrorReason.MALFORMED, f"{what} ends within its title")
    return _text(data[1 : 1 + data[0]]), data[1 + data[0] :]


def _text(data: bytes) -> str:
    return data.decode("utf-8", "replace")
