"""Readers of one controller's packages at 500 Hz, each in a process of its own; prints packages and CPU time as JSON.

Run `python -m benchmarks.stands.ur_readers READER HOST SECONDS`; the environment gives the driver's configuration.
"""

import asyncio
import importlib
import json
import sys
import time
from collections.abc import Callable
from typing import Any, cast

import uvloop

from benchmarks.stands.rtde_readers import WARM_UP_S
from service.config import load
from service.drivers.base import Sample
from service.drivers.ur.driver import UrDriver
from service.drivers.ur.rtde import RtdeClient
from service.drivers.ur.samples import OUTPUTS
from service.faults import FaultCode
from wire.records import TICK_S
from wire.rtde.codec import Decoded
from wire.rtde.errors import RtdeError

RATE_HZ = 500.0
_GETTERS = (
    *("getActualQ", "getActualQd", "getActualTCPPose", "getActualTCPSpeed", "getActualTCPForce", "getFtRawWrench"),
    *("getRobotMode", "getSafetyMode", "getRuntimeState", "getTargetSpeedFraction", "getPayload", "getPayloadCog"),
)
"""Getters of ur_rtde for the variables in `OUTPUTS`, except the timestamp."""


class _Seen:
    """Packages by their timestamps, and CPU time of all threads of this process, from `begin` on."""

    def __init__(self) -> None:
        self.count = 0
        self.stamp = self._first = self._cpu_s = 0.0

    def take(self, stamp: float) -> None:
        """Count a package unless it was already counted."""
        if stamp != self.stamp:
            self.stamp = stamp
            self.count += 1

    def begin(self) -> None:
        self.count, self._first, self._cpu_s = 0, self.stamp, time.process_time()

    def end(self) -> str:
        cpu_s, sent = time.process_time() - self._cpu_s, round((self.stamp - self._first) / TICK_S)
        return json.dumps({"seen": self.count, "sent": sent, "cpu_s": cpu_s})


async def _client(host: str, seconds: float) -> str:
    """Run the client alone; each package is decoded."""
    seen = _Seen()

    def lose(error: RtdeError) -> None:
        raise SystemExit(str(error))

    def take(values: tuple[Decoded, ...], _arrival_s: float) -> None:
        seen.take(cast("float", values[0]))

    client = RtdeClient(host, clock=time.monotonic, on_package=take, on_lost=lose)
    await client.connect()
    await client.setup(OUTPUTS, RATE_HZ)
    await client.start()
    return await _watched(seen, seconds)


async def _driver(seconds: float) -> str:
    """Run the driver; each package becomes a sample, and every fifth is answered with the sign of life."""
    seen = _Seen()

    class Sink:
        def overloads(self, load: object) -> bool:
            return False

        def on_sample(self, sample: Sample) -> None:
            seen.take(sample.time_s)

        def on_link_fault(self, code: FaultCode, text: str) -> None:
            raise SystemExit(f"{code}: {text}")

        def on_notice(self, text: str) -> None: ...

    await UrDriver(load()).connect(Sink())
    return await _watched(seen, seconds)


async def _watched(seen: _Seen, seconds: float) -> str:
    await asyncio.sleep(WARM_UP_S)
    seen.begin()
    await asyncio.sleep(seconds)
    return seen.end()


def _receive(host: str) -> Any:
    return importlib.import_module("rtde_receive").RTDEReceiveInterface(host, RATE_HZ, list(OUTPUTS))


def ur_rtde(host: str, seconds: float) -> str:
    """Run ur_rtde's thread alone; no values are requested."""
    client, seen = _receive(host), _Seen()
    time.sleep(WARM_UP_S)
    seen.take(client.getTimestamp())
    seen.begin()
    time.sleep(seconds)
    seen.take(client.getTimestamp())
    return seen.end()


def ur_rtde_asked(host: str, seconds: float) -> str:
    """Poll ur_rtde every 2 ms for the newest package's values; it has no callback for arrivals."""
    client, seen = _receive(host), _Seen()
    getters = [getattr(client, name) for name in _GETTERS]
    time.sleep(WARM_UP_S)
    seen.take(client.getTimestamp())
    seen.begin()
    begin_s = time.monotonic()
    for beat in range(round(seconds / TICK_S)):
        time.sleep(max(0.0, begin_s + beat * TICK_S - time.monotonic()))
        seen.take(client.getTimestamp())
        for get in getters:
            get()
    return seen.end()


def client_on_asyncio(host: str, seconds: float) -> str:
    """Run the client on asyncio's own loop."""
    return asyncio.run(_client(host, seconds))


def client_on_uvloop(host: str, seconds: float) -> str:
    """Run the client on uvloop."""
    return uvloop.run(_client(host, seconds))


def driver(_host: str, seconds: float) -> str:
    """Run the driver on uvloop, as in the control process."""
    return uvloop.run(_driver(seconds))


READERS: dict[str, Callable[[str, float], str]] = {
    "client_asyncio": client_on_asyncio,
    "client_uvloop": client_on_uvloop,
    "driver": driver,
    "ur_rtde": ur_rtde,
    "ur_rtde_asked": ur_rtde_asked,
}

if __name__ == "__main__":
    print(READERS[sys.argv[1]](sys.argv[2], float(sys.argv[3])))
