"""Relay between a driver and an emulated controller; on request it falsifies the force once and times the stop.

`python -m benchmarks.stands.lying_relay HOST PORT UPSTREAM_PORT ENDPOINT` relays RTDE from PORT to UPSTREAM_PORT of
HOST. A query on `bench/trip` at the Zenoh ENDPOINT is answered once the stop has arrived here, with the seconds from
the package's departure to the stop's arrival. The arm itself is not affected and measures the true force.
"""

import contextlib
import selectors
import socket
import struct
import sys
import time

import zenoh

from benchmarks.harness.processes import READY
from benchmarks.stands.tripping_world import FORCE_N, TRIP
from service.drivers.ur.registers import Command
from service.drivers.ur.samples import OUTPUTS
from wire.realtime import request_realtime
from wire.rtde import fields
from wire.rtde.codec import FrameReader, PackageType, Recipe, frame
from wire.session import close_session, open_session

READ_BYTES = 1 << 16
_FORCE = OUTPUTS.index("actual_TCP_force")
_ORDER = struct.Struct(">Bii")
"""Recipe, sequence and command, which begin the driver's inputs."""


class LyingRelay:
    """Relays one connection after another."""

    def __init__(self) -> None:
        self._query: zenoh.Query | None = None
        self._sent_s: float | None = None
        self._recipe = Recipe(OUTPUTS, [fields.OUTPUTS[name] for name in OUTPUTS], 1)

    def trip(self, query: zenoh.Query) -> None:
        """Falsify the next package; called on Zenoh's thread."""
        self._sent_s, self._query = None, query

    def relay(self, client: socket.socket, controller: socket.socket) -> None:
        """Relay until either side closes; raise OSError if one of them resets."""
        data, orders = FrameReader(), FrameReader()
        with selectors.DefaultSelector() as selector:
            for side in (client, controller):
                side.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                selector.register(side, selectors.EVENT_READ)
            while True:
                for key, _ in selector.select():
                    side = client if key.fileobj is client else controller
                    received = side.recv(READ_BYTES)
                    arrived_s = time.perf_counter()
                    if not received:
                        return
                    if side is controller:
                        self._pass_on(client, data, received)
                    else:
                        self._look_for_stop(orders, received, arrived_s)
                        controller.sendall(received)

    def _pass_on(self, client: socket.socket, data: FrameReader, received: bytes) -> None:
        for kind, payload in data.feed(received):
            if kind == PackageType.DATA and self._query is not None and self._sent_s is None:
                values = list(self._recipe.decode(payload))
                values[_FORCE] = (0.0, 0.0, FORCE_N, 0.0, 0.0, 0.0)
                lie = self._recipe.encode(values)
                self._sent_s = time.perf_counter()
                client.sendall(lie)
            else:
                client.sendall(frame(kind, payload))

    def _look_for_stop(self, orders: FrameReader, received: bytes, arrived_s: float) -> None:
        for kind, payload in orders.feed(received):
            if kind != PackageType.DATA or self._query is None or self._sent_s is None:
                continue
            _, _, command = _ORDER.unpack_from(payload)
            if command == Command.STOP:
                query, self._query = self._query, None
                with query:
                    query.reply(TRIP, repr(arrived_s - self._sent_s), express=True)


def main(host: str, port: int, upstream_port: int, endpoint: str) -> None:
    request_realtime()
    relay = LyingRelay()
    session = open_session(listen=[endpoint])
    try:
        session.declare_queryable(TRIP, relay.trip)
        with socket.create_server((host, port)) as listening:
            print(READY, flush=True)
            while True:
                client, _ = listening.accept()
                with (
                    client,
                    contextlib.suppress(OSError),
                    socket.create_connection((host, upstream_port)) as controller,
                ):
                    relay.relay(client, controller)
    finally:
        close_session(session)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4])
