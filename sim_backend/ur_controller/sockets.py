"""TCP connections that programs have opened; a program connects out, nothing here listens.

Waiting is counted in ticks, so the timeouts of a world faster than the clock are faster too.
"""

import contextlib
import ipaddress
import select
import socket
from collections.abc import Generator

from wire.records import TICK_S

OPEN_TIMEOUT_S = 2.0
MOST_SOCKETS = 16
LARGEST_BUFFER = 65_536
"""Bytes kept until a program reads them; more wait on the network."""

_FRESH = 4096


class Connection:
    """One open connection and the bytes that have arrived on it."""

    def __init__(self, peer: socket.socket) -> None:
        self._peer = peer
        self.buffer = bytearray()
        self.is_open = True

    def receive(self) -> None:
        """Receive bytes as far as the buffer has room."""
        room = LARGEST_BUFFER - len(self.buffer)
        if not self.is_open or room <= 0:
            return
        try:
            data = self._peer.recv(min(room, _FRESH))
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            data = b""
        if data:
            self.buffer += data
        else:
            self.close()

    def send(self, data: bytes) -> bool:
        """Send all bytes; a peer that does not take them loses the connection."""
        try:
            sent = self._peer.send(data) if self.is_open else 0
        except OSError:
            sent = 0
        if sent == len(data):
            return True
        self.close()
        return False

    def take(self, count: int) -> bytes:
        """Remove the first `count` bytes from the buffer and return them."""
        data = bytes(self.buffer[:count])
        del self.buffer[:count]
        return data

    def close(self) -> None:
        """Close; bytes that have arrived can still be read."""
        self.is_open = False
        self._peer.close()


class Sockets:
    """The connections of a program by the names that it gave them."""

    def __init__(self) -> None:
        self._connections: dict[str, Connection] = {}

    def get(self, name: str) -> Connection | None:
        """Return the connection of that name, or None."""
        return self._connections.get(name)

    def open(self, address: str, port: int, name: str) -> Generator[None, None, bool]:
        """Connect, tick by tick; return True on success. An earlier connection of the same name is closed first."""
        self.close(name)
        host = "127.0.0.1" if address == "localhost" else address
        try:
            ipaddress.IPv4Address(host)  # resolving a name would delay the tick
        except ValueError:
            return False
        if not 0 < port < 65_536 or len(self._connections) >= MOST_SOCKETS:
            return False
        peer = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        kept = False
        try:
            peer.setblocking(False)
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with contextlib.suppress(BlockingIOError):
                peer.connect((host, port))
            for _ in range(round(OPEN_TIMEOUT_S / TICK_S)):
                yield  # a handshake takes time on every network, and peers count on several ticks
                if select.select((), (peer,), (), 0.0)[1]:
                    kept = peer.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) == 0
                    break
        except OSError:
            kept = False
        finally:
            if not kept:
                peer.close()
        if kept:
            self._connections[name] = Connection(peer)
        return kept

    def close(self, name: str) -> None:
        """Close the connection of that name, if there is one."""
        connection = self._connections.pop(name, None)
        if connection is not None:
            connection.close()

    def close_all(self) -> None:
        """Close all connections, because their program has ended."""
        for name in [*self._connections]:
            self.close(name)
