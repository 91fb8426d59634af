"""Arrival of every package of a controller at this host, for clients that cannot tell or are not to be believed.

Run `python -m benchmarks.stands.rtde_referee HOST OUTPUT`. At SIGTERM it writes one row per package to OUTPUT (`.npy`):
time stamp by the controller's clock and arrival by the host's monotonic clock, s.
"""

import signal
import struct
import sys
import time
from pathlib import Path
from types import FrameType

import numpy as np

from benchmarks.harness.processes import READY
from benchmarks.stands.rtde_connection import READ_BYTES, started
from wire.realtime import request_realtime, settle_interpreter
from wire.rtde.codec import PackageType

_STAMP = struct.Struct(">Bd")


def main(host: str, output: Path) -> None:
    settle_interpreter()
    request_realtime()
    signal.signal(signal.SIGTERM, _end)
    connection, reader = started(host, ("timestamp",))
    print(READY, flush=True)
    arrivals: list[tuple[float, float]] = []
    try:
        while data := connection.recv(READ_BYTES):
            now_s = time.monotonic()
            for kind, payload in reader.feed(data):
                if kind == PackageType.DATA:
                    arrivals.append((_STAMP.unpack(payload)[1], now_s))
    finally:
        np.save(output, np.array(arrivals))


def _end(_number: int, _frame: FrameType | None) -> None:
    sys.exit()


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
