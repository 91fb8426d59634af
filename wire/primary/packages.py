"""Packages of the primary interface out of a stream of bytes, and into it."""

import struct
from collections.abc import Iterator
from enum import IntEnum

from wire.primary.errors import PrimaryError, PrimaryErrorReason

PORT = 30001
SECONDARY_PORT = 30002
STATE_HZ = 10
LIMIT = 1 << 16
"""Bytes of the largest package that a reader takes; a robot's state has some 1400."""

_HEADER = struct.Struct(">iB")


class PackageType(IntEnum):
    """What a package holds; a controller sends further types, which readers pass over."""

    ROBOT_STATE = 16
    ROBOT_MESSAGE = 20


def frame(kind: int, content: bytes) -> bytes:
    """Return a package."""
    return _HEADER.pack(_HEADER.size + len(content), kind) + content


class PackageReader:
    """Cuts a stream into packages, however it arrives; holds no more than one package."""

    def __init__(self, limit: int = LIMIT) -> None:
        self._limit = limit
        self._buffer = bytearray()

    def feed(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Yield type and content of every package that is complete.

        Raises:
            PrimaryError: FRAMING; the stream cannot be followed any further.
        """
        self._buffer += data
        at = 0
        try:
            while len(self._buffer) - at >= _HEADER.size:
                size, kind = _HEADER.unpack_from(self._buffer, at)
                if not _HEADER.size <= size <= self._limit:
                    raise PrimaryError(PrimaryErrorReason.FRAMING, f"a package of type {kind} claims {size} bytes")
                if len(self._buffer) - at < size:
                    break
                content = bytes(self._buffer[at + _HEADER.size : at + size])
                at += size
                yield kind, content
        finally:
            del self._buffer[:at]
