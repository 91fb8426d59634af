"""Framing of primary packages: bytes of a stream to packages, and back."""

import struct
from collections.abc import Iterator
from enum import IntEnum

from wire.primary.errors import PrimaryError, PrimaryErrorReason

PORT = 30001
SECONDARY_PORT = 30002
STATE_HZ = 10
LIMIT = 1 << 16
"""Size of the largest package that a reader accepts, bytes; a robot state has about 1400."""

_HEADER = struct.Struct(">iB")


class PackageType(IntEnum):
    """Content of a package. A controller sends further types, which readers skip."""

    ROBOT_STATE = 16
    ROBOT_MESSAGE = 20


def frame(kind: int, content: bytes) -> bytes:
    """Return a package."""
    return _HEADER.pack(_HEADER.size + len(content), kind) + content


class PackageReader:
    """Cuts a stream into packages, whatever its chunks; holds no more than one package."""

    def __init__(self, limit: int = LIMIT) -> None:
        self._limit = limit
        self._buffer = bytearray()

    def feed(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Yield type and content of every complete package.

        Raises:
            PrimaryError: FRAMING; the rest of the stream cannot be read.
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
