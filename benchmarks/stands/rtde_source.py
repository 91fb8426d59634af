"""An RTDE service that sends data at a rate, or as fast as they are read; the far end of `benchmarks.cases.rtde`."""

import contextlib
import socket
import sys
import time

import numpy as np

from benchmarks.harness.processes import READY
from wire.records import TICK_S
from wire.rtde.codec import FrameReader, PackageType, Recipe
from wire.rtde.fields import OUTPUTS
from wire.rtde.messages import ControllerVersion, OutputsRequest, SetupReply, encode_accepted

BLOCK = 4000
"""Packages passed to the system at once when sending as fast as possible."""
FIRST_TIMESTAMP_S = 60.0


def serve(host: str, port: int, rate_hz: float) -> None:
    """Serve one client after another; a rate of 0 sends as fast as the client reads."""
    with socket.create_server((host, port)) as listening:
        print(READY, flush=True)
        while True:
            client, _ = listening.accept()
            with client, contextlib.suppress(OSError):
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                _send(client, _agree(client), rate_hz)


def _agree(client: socket.socket) -> Recipe:
    """Answer until the client starts its data; raise OSError if it leaves."""
    reader = FrameReader()
    recipe: Recipe | None = None
    while data := client.recv(4096):
        for number, payload in reader.feed(data):
            kind = PackageType(number)
            if kind is PackageType.CONTROLLER_VERSION:
                client.sendall(ControllerVersion(5, 21, 3, 0).encode())
            elif kind is PackageType.SETUP_OUTPUTS:
                names = OutputsRequest.decode(payload).names
                reply = SetupReply(tuple(OUTPUTS[name].name for name in names), 1)
                recipe = reply.recipe(names)
                client.sendall(reply.encode(kind))
            else:
                client.sendall(encode_accepted(kind, True))
            if kind is PackageType.START and recipe is not None:
                return recipe
    raise ConnectionResetError


def _send(client: socket.socket, recipe: Recipe, rate_hz: float) -> None:
    at = recipe.names.index("timestamp")
    offset = 4 + sum(np.dtype(kind.letter).itemsize * kind.count for kind in recipe.types[:at])
    values = [0.25 if kind.letter == "d" else 1 for kind in recipe.types]
    package = recipe.encode(
        [value if kind.count == 1 else [value] * kind.count for value, kind in zip(values, recipe.types, strict=True)]
    )
    count = BLOCK if rate_hz == 0 else 1
    block = np.tile(np.frombuffer(package, np.uint8), (count, 1))
    stamps = np.ndarray((count,), ">f8", block, offset, (len(package),))
    begin, sent = time.monotonic(), 0
    while True:
        stamps[:] = FIRST_TIMESTAMP_S + TICK_S * np.arange(sent, sent + count)
        client.sendall(block.data)
        sent += count
        if rate_hz:
            time.sleep(max(0.0, begin + sent / rate_hz - time.monotonic()))


if __name__ == "__main__":
    serve(sys.argv[1], int(sys.argv[2]), float(sys.argv[3]))
