"""TCP services on one thread: connections with bounded buffers, and the loop that polls them once per tick.

Nothing here blocks. A client that does not read is disconnected, so it can neither delay the tick nor fill the memory.
"""

import contextlib
import selectors
import socket
import time
from collections.abc import Callable
from typing import Protocol

DRAIN_TIMEOUT_S = 10.0
"""Time after which a connection is closed if its peer takes none of the waiting bytes; an e-Series controller
does so.
"""
MAX_PENDING_BYTES = 1 << 20
"""Largest number of bytes that may wait for one peer in this process; a connection that would exceed it is closed."""
MAX_CONNECTIONS = 32
"""Connections per service; further peers are accepted and closed at once, so that they notice."""
READ_BYTES = 8192
"""Bytes read from one connection per poll. TCP's own window holds a flood back, so the tick stays in time."""

_SEND_BUFFER_BYTES = 64 * 1024  # small, so that a slow reader falls behind by only a fraction of a second
_BACKLOG = 16
_KEEPALIVE = {"TCP_KEEPIDLE": 10, "TCP_KEEPINTVL": 2, "TCP_KEEPCNT": 5}  # a vanished peer frees its resources in 20 s


class ListenError(OSError):
    """An address at which listening fails; the text names it and the reason."""


class Connection:
    """One accepted peer.

    Attributes:
        peer: address of the peer, `host:port`.
        is_open: False once either side has closed; `on_close` tells the service.
        pending: number of bytes that the peer has still to read.
        patient: never close because the peer does not read. For services that send only when nothing is `pending`, to
            clients that connect only to write.
    """

    def __init__(self, peer_socket: socket.socket, peer: str, clock: Callable[[], float]) -> None:
        self.peer = peer
        self.is_open = True
        self.patient = False
        self._socket = peer_socket
        self._clock = clock
        self._buffer = bytearray()
        self._progress_s = 0.0

    @property
    def pending(self) -> int:
        return len(self._buffer)

    @property
    def host(self) -> str:
        """Address of the peer without its port."""
        return self.peer.rsplit(":", 1)[0]

    def send(self, data: bytes) -> None:
        """Send, or keep for later the bytes that the peer does not take now; no effect once closed.

        A connection with more than `MAX_PENDING_BYTES` waiting is closed. A stream of states should skip rather than
        queue: check `pending` first.
        """
        if not self.is_open:
            return
        if self._buffer:
            if len(self._buffer) + len(data) > MAX_PENDING_BYTES:
                self.close()
            else:
                self._buffer += data
            return
        sent = self._send(data)
        if sent < len(data):
            self._progress_s = self._clock()
            self._buffer += data[sent:]

    def close(self) -> None:
        """Close after the present round of the loop. Bytes that `send` passed to the network still arrive."""
        self.is_open = False

    def flush(self) -> None:
        """Send waiting bytes; close if the peer has taken none for `DRAIN_TIMEOUT_S`, unless `patient`."""
        sent = self._send(self._buffer)
        if sent:
            del self._buffer[:sent]
            self._progress_s = self._clock()
        elif not self.patient and self._clock() - self._progress_s > DRAIN_TIMEOUT_S:
            self.close()

    def read(self) -> bytes:
        """Return the bytes that have arrived, at most `READ_BYTES`; empty, and closed, if the peer has gone."""
        try:
            data = self._socket.recv(READ_BYTES)
        except (BlockingIOError, InterruptedError):
            return b""
        except OSError:
            data = b""
        if not data:
            self.close()
        return data

    def fileno(self) -> int:
        return self._socket.fileno()

    def shut(self) -> None:
        """Release the socket."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_WR)
        self._socket.close()

    def _send(self, data: bytes | bytearray) -> int:
        try:
            return self._socket.send(data)
        except (BlockingIOError, InterruptedError):
            return 0
        except OSError:
            self.close()
            return 0


class Service(Protocol):
    """A TCP service. Every method runs on the loop's thread and must return within a fraction of a tick.

    A method that raises ends the controller, so a service handles every error of a peer with `send` or `close`. A
    connection closed within one of these methods is reported to `on_close` after the method has returned.
    """

    def on_connect(self, connection: Connection) -> None:
        """Handle a new connection."""
        ...

    def on_data(self, connection: Connection, data: bytes) -> None:
        """Handle bytes, cut anywhere; never empty."""
        ...

    def on_close(self, connection: Connection) -> None:
        """Handle the end of a connection, closed by either side; called once."""
        ...

    def publish(self) -> None:
        """Handle the end of a tick."""
        ...


class _Port:
    """A listening socket and the connections of its service."""

    def __init__(self, listening: socket.socket, service: Service) -> None:
        self.listening = listening
        self.service = service
        self.connections: list[Connection] = []


class Listener:
    """Serves any number of services from the thread that calls `poll` and `publish`."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Start with no service.

        Args:
            clock: returns monotonic time, s, for `DRAIN_TIMEOUT_S`.
        """
        self._clock = clock
        self._selector = selectors.DefaultSelector()
        self._ports: list[_Port] = []

    def serve(self, service: Service, host: str, port: int) -> int:
        """Listen for a service.

        Args:
            service: receives connections and ticks from now on.
            host: address or name of this machine.
            port: 0 for a free one.

        Returns:
            The port in use.

        Raises:
            ListenError: the address is taken, or does not belong to this machine.
        """
        listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)  # accepted sockets inherit it
            listening.bind((host, port))
            listening.listen(_BACKLOG)
        except OSError as error:
            listening.close()
            raise ListenError(f"cannot listen at {host}:{port}: {error.strerror or error}") from error
        listening.setblocking(False)
        entry = _Port(listening, service)
        self._ports.append(entry)
        self._selector.register(listening, selectors.EVENT_READ, entry)
        return int(listening.getsockname()[1])

    def poll(self) -> None:
        """Accept, read and pass on everything that has arrived, and send waiting bytes; never blocks."""
        for key, _ in self._selector.select(0):
            if isinstance(key.data, _Port):
                self._accept(key.data)
            else:
                port, connection = key.data
                data = connection.read() if connection.is_open else b""
                if data:
                    port.service.on_data(connection, data)
        self._reap(flush=True)

    def publish(self) -> None:
        """Tell every service that a tick has passed."""
        for port in self._ports:
            port.service.publish()
        self._reap(flush=False)

    def close(self) -> None:
        """Close every connection and stop listening."""
        for port in self._ports:
            for connection in port.connections:
                connection.close()
        self._reap(flush=False)
        for port in self._ports:
            self._selector.unregister(port.listening)
            port.listening.close()
        self._ports.clear()
        self._selector.close()

    def _accept(self, port: _Port) -> None:
        try:
            accepted, address = port.listening.accept()
        except OSError:  # the peer gave up while waiting
            return
        if len(port.connections) >= MAX_CONNECTIONS:
            accepted.close()
            return
        accepted.setblocking(False)
        accepted.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        accepted.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in _KEEPALIVE.items():
            if hasattr(socket, name):
                accepted.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
        connection = Connection(accepted, f"{address[0]}:{address[1]}", self._clock)
        port.connections.append(connection)
        data: tuple[_Port, Connection] = (port, connection)
        self._selector.register(accepted, selectors.EVENT_READ, data)
        port.service.on_connect(connection)

    def _reap(self, *, flush: bool) -> None:
        for port in self._ports:
            gone: list[Connection] = []
            for connection in port.connections:
                if flush and connection.pending and connection.is_open:
                    connection.flush()
                if not connection.is_open:
                    gone.append(connection)
            for connection in gone:
                port.connections.remove(connection)
                self._selector.unregister(connection)
                connection.shut()
                port.service.on_close(connection)
