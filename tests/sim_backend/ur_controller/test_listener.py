"""Connections of the emulated controller: what a peer can do to them, and what it cannot."""

import contextlib
import socket
import struct
from collections.abc import Callable, Iterator

import pytest

from sim_backend.ur_controller import listener
from sim_backend.ur_controller.listener import Connection, Listener, ListenError

HOST = "127.0.0.22"
PATIENCE_S = 5.0


class Upper:
    """Answers in capitals; "close" closes, "flood n" sends n bytes."""

    def __init__(self) -> None:
        self.connections: list[Connection] = []
        self.heard: list[bytes] = []
        self.closed: list[Connection] = []
        self.ticks = 0

    def on_connect(self, connection: Connection) -> None:
        self.connections.append(connection)

    def on_data(self, connection: Connection, data: bytes) -> None:
        self.heard.append(data)
        word, _, argument = data.decode().partition(" ")
        if word == "close":
            connection.close()
            assert self.closed == []
        elif word == "flood":
            connection.send(bytes(int(argument)))
        else:
            connection.send(data.upper())

    def on_close(self, connection: Connection) -> None:
        assert not connection.is_open
        self.closed.append(connection)

    def publish(self) -> None:
        self.ticks += 1


class Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def loop(clock: Clock) -> Iterator[Listener]:
    loop = Listener(clock)
    yield loop
    loop.close()


def until(loop: Listener, condition: Callable[[], bool]) -> None:
    """Poll until a condition holds: loopback hands bytes over at once, though not within the same call."""
    for _ in range(20_000):
        if condition():
            return
        loop.poll()
    raise AssertionError("it never came about")


def connect(port: int, receive_buffer: int | None = None) -> socket.socket:
    peer = socket.socket()
    if receive_buffer is not None:
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
    peer.settimeout(PATIENCE_S)
    peer.connect((HOST, port))
    return peer


def test_each_peer_is_answered_on_its_own_connection(loop: Listener) -> None:
    service = Upper()
    port = loop.serve(service, HOST, 0)
    with connect(port) as one, connect(port) as two:
        one.sendall(b"first")
        two.sendall(b"second")
        until(loop, lambda: len(service.heard) == 2)
        assert (one.recv(64), two.recv(64)) == (b"FIRST", b"SECOND")
        for connection, peer in zip(service.connections, (one, two), strict=True):
            host, number = peer.getsockname()
            assert (connection.host, connection.peer) == (host, f"{host}:{number}")


def test_services_of_one_loop_do_not_hear_each_other(loop: Listener) -> None:
    left, right = Upper(), Upper()
    ports = [loop.serve(service, HOST, 0) for service in (left, right)]
    with connect(ports[1]) as peer:
        peer.sendall(b"to the right")
        until(loop, lambda: bool(right.heard))
    assert left.heard == []
    loop.publish()
    assert (left.ticks, right.ticks) == (1, 1)


def test_a_peer_that_leaves_is_reported_once(loop: Listener) -> None:
    service = Upper()
    port = loop.serve(service, HOST, 0)
    with connect(port) as peer:
        until(loop, lambda: bool(service.connections))
        peer.sendall(b"last words")
    until(loop, lambda: bool(service.closed))
    for _ in range(5):
        loop.poll()
        loop.publish()
    assert service.heard == [b"last words"]
    assert service.closed == service.connections


def test_a_peer_that_resets_its_connection_is_reported(loop: Listener) -> None:
    service = Upper()
    port = loop.serve(service, HOST, 0)
    peer = connect(port)
    until(loop, lambda: bool(service.connections))
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    peer.close()
    until(loop, lambda: bool(service.closed))
    service.connections[0].send(b"nobody is there")
    assert service.connections[0].pending == 0


def test_a_service_that_closes_hears_of_it_after_its_own_method(loop: Listener) -> None:
    service = Upper()
    port = loop.serve(service, HOST, 0)
    with connect(port) as peer:
        peer.sendall(b"close")
        until(loop, lambda: bool(service.closed))
        assert peer.recv(64) == b""


def test_nothing_is_heard_from_a_connection_that_the_service_has_closed(loop: Listener) -> None:
    class First(Upper):
        def on_data(self, connection: Connection, data: bytes) -> None:
            self.heard.append(data)
            for other in self.connections:
                other.close()

    service = First()
    port = loop.serve(service, HOST, 0)
    with connect(port) as one, connect(port) as two:
        until(loop, lambda: len(service.connections) == 2)
        one.sendall(b"one")
        two.sendall(b"two")
        until(loop, lambda: len(service.closed) == 2)
    assert service.heard in ([b"one"], [b"two"])


def test_what_was_sent_before_a_close_arrives(loop: Listener) -> None:
    service = Upper()
    port = loop.serve(service, HOST, 0)
    with connect(port) as peer:
        until(loop, lambda: bool(service.connections))
        service.connections[0].send(b"goodbye")
        service.connections[0].close()
        until(loop, lambda: bool(service.closed))
        assert peer.recv(64) == b"goodbye"
        assert peer.recv(64) == b""


def test_what_a_slow_peer_does_not_take_at_once_comes_later_and_whole(loop: Listener) -> None:
    service = Upper()
    port = loop.serve(service, HOST, 0)
    with connect(port, receive_buffer=4096) as peer:
        peer.sendall(b"flood 900000")
        until(loop, lambda: bool(service.heard))
        assert service.connections[0].pending > 0
        peer.setblocking(False)
        received = 0

        def took_all() -> bool:
            nonlocal received
            with contextlib.suppress(BlockingIOError):
                received += len(peer.recv(65536))
            return received >= 900_000

        until(loop, took_all)
        assert received == 900_000
        assert service.connections[0].pending == 0


def test_a_peer_that_takes_nothing_for_ten_seconds_is_disconnected(loop: Listener, clock: Clock) -> None:
    clock.now_s = 1000.0
    service = Upper()
    port = loop.serve(service, HOST, 0)
    with connect(port, receive_buffer=4096) as peer:
        peer.sendall(b"flood 900000")
        until(loop, lambda: bool(service.heard))
        clock.now_s += listener.DRAIN_TIMEOUT_S
        loop.poll()
        assert service.connections[0].is_open
        clock.now_s += 0.1
        until(loop, lambda: bool(service.closed))


def test_a_patient_service_waits_for_such_a_peer(loop: Listener, clock: Clock) -> None:
    service = Upper()
    port = loop.serve(service, HOST, 0)
    with connect(port, receive_buffer=4096) as peer:
        until(loop, lambda: bool(service.connections))
        service.connections[0].patient = True
        peer.sendall(b"flood 900000")
        until(loop, lambda: bool(service.heard))
        clock.now_s += 3600.0
        for _ in range(10):
            loop.poll()
        assert service.closed == []
        peer.sendall(b"still here")
        until(loop, lambda: len(service.heard) == 2)


def test_no_more_is_kept_for_a_peer_than_the_limit(loop: Listener) -> None:
    service = Upper()
    port = loop.serve(service, HOST, 0)
    with connect(port, receive_buffer=4096) as peer:
        until(loop, lambda: bool(service.connections))
        connection = service.connections[0]
        for _ in range(3):
            connection.send(bytes(listener.MAX_PENDING_BYTES // 2))
            assert connection.pending <= listener.MAX_PENDING_BYTES
        assert not connection.is_open
        until(loop, lambda: bool(service.closed))
        assert peer.fileno() > 0


def test_a_flood_is_taken_in_portions(loop: Listener) -> None:
    service = Upper()
    port = loop.serve(service, HOST, 0)
    with connect(port) as peer:
        until(loop, lambda: bool(service.connections))
        peer.sendall(b"x" * (3 * listener.READ_BYTES))
        until(loop, lambda: sum(map(len, service.heard)) == 3 * listener.READ_BYTES)
    assert max(map(len, service.heard)) <= listener.READ_BYTES


def test_peers_beyond_the_limit_are_turned_away_and_the_others_stay(
    loop: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(listener, "MAX_CONNECTIONS", 2)
    service = Upper()
    port = loop.serve(service, HOST, 0)
    with connect(port) as one, connect(port) as two, connect(port) as three:
        until(loop, lambda: len(service.connections) == 2)
        for _ in range(10):
            loop.poll()
        assert three.recv(64) == b""
        for peer in (one, two):
            peer.sendall(b"here")
        until(loop, lambda: len(service.heard) == 2)
        assert (one.recv(64), two.recv(64)) == (b"HERE", b"HERE")


def test_an_address_in_use_is_named(loop: Listener) -> None:
    port = loop.serve(Upper(), HOST, 0)
    with pytest.raises(ListenError, match=f"cannot listen at {HOST}:{port}: Address already in use"):
        loop.serve(Upper(), HOST, port)


def test_an_address_of_another_machine_is_named(loop: Listener) -> None:
    with pytest.raises(ListenError, match=r"cannot listen at 192\.0\.2\.1:0"):
        loop.serve(Upper(), "192.0.2.1", 0)


def test_closing_the_loop_closes_peers_and_ports(clock: Clock) -> None:
    loop = Listener(clock)
    service = Upper()
    port = loop.serve(service, HOST, 0)
    with connect(port) as peer:
        until(loop, lambda: bool(service.connections))
        loop.close()
        assert peer.recv(64) == b""
    assert service.closed == service.connections
    with socket.socket() as late, pytest.raises(ConnectionRefusedError):
        late.connect((HOST, port))
