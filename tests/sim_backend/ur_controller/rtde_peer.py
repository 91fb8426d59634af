"""A client of RTDE for tests: bytes by hand, so that a mistake in the codec cannot hide behind itself."""

import socket
import struct
from collections.abc import Callable

PATIENCE = 20_000
"""Polls to wait for bytes that are on their way over loopback."""


class Peer:
    """One connection to an RTDE service in the same thread.

    Args:
        address: of the service.
        poll: lets the service handle what has arrived; no time passes in it.
    """

    def __init__(self, address: tuple[str, int], poll: Callable[[], None], receive_buffer: int | None = None) -> None:
        self.socket = socket.socket()
        if receive_buffer is not None:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.socket.connect(address)
        self.socket.setblocking(False)
        self.closed = False
        self._poll = poll
        self._held = b""

    def send(self, kind: str, payload: bytes = b"") -> None:
        self.socket.sendall(struct.pack(">HB", 3 + len(payload), ord(kind)) + payload)

    def take(self) -> tuple[str, bytes] | None:
        """The next package that is here already."""
        try:
            data = self.socket.recv(1 << 16)
            self.closed |= not data
            self._held += data
        except BlockingIOError:
            pass
        except ConnectionResetError:
            self.closed = True
        if len(self._held) < 3:
            return None
        size, kind = struct.unpack_from(">HB", self._held)
        if len(self._held) < size:
            return None
        payload, self._held = self._held[3:size], self._held[size:]
        return chr(kind), payload

    def receive(self) -> tuple[str, bytes]:
        """Wait for the next package."""
        for _ in range(PATIENCE):
            package = self.take()
            if package is not None:
                return package
            assert not self.closed, "disconnected"
            self._poll()
        raise AssertionError("nothing came")

    def ask(self, kind: str, payload: bytes = b"") -> bytes:
        """Send a request; return the payload of the answer, which must be the next package."""
        self.send(kind, payload)
        answer, payload = self.receive()
        assert answer == kind
        return payload

    def settle(self) -> list[tuple[str, bytes]]:
        """Everything that comes of what was sent so far, without a tick."""
        packages: list[tuple[str, bytes]] = []
        for _ in range(50):
            self._poll()
            while (package := self.take()) is not None:
                packages.append(package)
        return packages

    def is_dropped(self) -> bool:
        self.settle()
        return self.closed

    # --- what most tests begin with

    def outputs(self, names: str, frequency_hz: float = 500.0) -> tuple[int, list[str]]:
        """Set up outputs in version 2; recipe id and types."""
        payload = self.ask("O", struct.pack(">d", frequency_hz) + names.encode())
        return payload[0], payload[1:].decode().split(",")

    def inputs(self, names: str) -> tuple[int, list[str]]:
        payload = self.ask("I", names.encode())
        return payload[0], payload[1:].decode().split(",")

    def begin(self, names: str, frequency_hz: float = 500.0) -> None:
        """Version 2, outputs and start."""
        assert self.ask("V", b"\x00\x02") == b"\x01"
        assert self.outputs(names, frequency_hz)[0] == 1
        assert self.ask("S") == b"\x01"

    def data(self, layout: str) -> tuple[float, ...]:
        """The next data package of recipe 1, which must be the next package."""
        kind, payload = self.receive()
        assert (kind, payload[0]) == ("U", 1)
        return struct.unpack(f">{layout}", payload[1:])
