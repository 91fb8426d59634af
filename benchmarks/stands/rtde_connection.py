"""A plain connection to a controller's RTDE service, with a blocking socket."""

import socket
from collections.abc import Sequence

from wire.rtde.codec import FrameReader, PackageType, frame
from wire.rtde.messages import PORT, OutputsRequest, encode_version_request

RATE_HZ = 500.0
READ_BYTES = 1 << 16


def started(host: str, outputs: Sequence[str]) -> tuple[socket.socket, FrameReader]:
    """Connect and start the data at 500 Hz; return the socket and the reader of what follows.

    Raises:
        OSError: the controller cannot be reached.
        SystemExit: it sends no data.
    """
    connection = socket.create_connection((host, PORT))
    requests = encode_version_request(), OutputsRequest(tuple(outputs), RATE_HZ).encode(), frame(PackageType.START)
    connection.sendall(b"".join(requests))
    reader = FrameReader()
    while data := connection.recv(READ_BYTES):
        if any(kind == PackageType.DATA for kind, _ in reader.feed(data)):
            return connection, reader
    raise SystemExit("the controller sends no data")
