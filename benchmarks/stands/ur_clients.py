"""Clients that keep an emulated controller busy until SIGTERM; a client that cannot continue ends by itself.

`python -m benchmarks.stands.ur_clients readers HOST COUNT` takes packages at 500 Hz on COUNT connections and ignores
them. `… ur_rtde HOST` runs ur_rtde's own program there, idle. `… driver` keeps the cell's control program engaged at
the host of the configuration in the environment.
"""

import asyncio
import importlib
import selectors
import socket
import sys
import time

from benchmarks.harness.processes import READY
from benchmarks.stands.rtde_connection import RATE_HZ, READ_BYTES, started
from benchmarks.stands.rtde_readers import WARM_UP_S
from benchmarks.stands.ur_cell import plan_first
from service.config import load
from service.drivers.base import PoseTarget, Sample
from service.drivers.ur.driver import UrDriver
from service.drivers.ur.samples import OUTPUTS
from service.faults import FaultCode
from wire.records import Program

TARGET_S = 0.1
"""Time between two targets, as from a policy, s."""


def readers(host: str, count: int) -> None:
    """Take the driver's packages on each connection and discard them."""
    with selectors.DefaultSelector() as selector:
        for _ in range(count):
            selector.register(started(host, OUTPUTS)[0], selectors.EVENT_READ)
        print(READY, flush=True)
        while True:
            for key, _ in selector.select():
                reading = key.fileobj
                if not isinstance(reading, socket.socket) or not reading.recv(READ_BYTES):
                    raise SystemExit("the controller has closed a connection")


def ur_rtde(host: str) -> None:
    """Let `RTDEControlInterface` send its program; its thread takes packages at 500 Hz."""
    control = importlib.import_module("rtde_control").RTDEControlInterface(host, RATE_HZ)
    print(READY, flush=True)
    while control.isConnected():
        time.sleep(TARGET_S)
    raise SystemExit("ur_rtde has lost its connection")


class _Newest:
    """Sink that keeps a driver's newest sample."""

    def __init__(self) -> None:
        self.sample: Sample | None = None

    def overloads(self, load: object) -> bool:
        return False

    def on_sample(self, sample: Sample) -> None:
        self.sample = sample

    def on_link_fault(self, code: FaultCode, text: str) -> None:
        raise SystemExit(f"{code}: {text}")

    def on_notice(self, text: str) -> None: ...


async def driver() -> None:
    """Engage the control program at the arm's present pose, and keep sending it that pose as the target."""
    config = load()
    plan = plan_first(config)
    newest = _Newest()
    arm = UrDriver(config)
    await arm.connect(newest)
    await arm.prepare(None)
    arm.zero_ft()
    await asyncio.sleep(WARM_UP_S)
    arm.engage(plan.law, plan.limits)
    assert newest.sample is not None  # noqa: S101  # the driver is connected
    target = PoseTarget(newest.sample.tcp_position, newest.sample.tcp_rotvec)
    arm.send_target(target)
    await asyncio.sleep(TARGET_S)
    print(READY, flush=True)
    while newest.sample.program is Program.ENGAGED:
        arm.send_target(target)
        await asyncio.sleep(TARGET_S)
    raise SystemExit(f"the control program has stopped: {newest.sample.stop_reason.name}")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["readers", host, count]:
            readers(host, int(count))
        case ["ur_rtde", host]:
            ur_rtde(host)
        case ["driver"]:
            asyncio.run(driver())
        case _:
            raise SystemExit(__doc__)
