"""Readers of RTDE to be compared, each in a process of its own; prints packages read and CPU seconds used as JSON."""

import asyncio
import importlib
import json
import socket
import struct
import sys
import time
from collections.abc import Callable

import uvloop

from service.drivers.ur.rtde import RtdeClient
from wire.records import TICK_S
from wire.rtde.codec import HEADER_SIZE, PackageType, frame
from wire.rtde.errors import RtdeError
from wire.rtde.fields import OUTPUTS
from wire.rtde.messages import OutputsRequest, encode_version_request

VARIABLES = (
    *("timestamp", "actual_q", "actual_qd", "actual_TCP_pose", "actual_TCP_speed", "actual_TCP_force"),
    *("target_TCP_pose", "ft_raw_wrench", "payload", "payload_cog", "robot_mode", "safety_mode", "runtime_state"),
    *("safety_status_bits", "speed_scaling", "output_int_register_24", "output_int_register_25"),
    *("output_int_register_26", "output_int_register_27", "output_double_register_24"),
)
"""Approximately the variables that the driver of a UR arm reads; packages are counted by the timestamp, the first."""
WARM_UP_S = 0.5


class Count:
    """Packages by their timestamps, and CPU time of all threads of this process, from `begin` to `end`."""

    def __init__(self) -> None:
        self._stamp = self._cpu_s = 0.0

    def begin(self, stamp: float) -> None:
        self._stamp, self._cpu_s = stamp, time.process_time()

    def end(self, stamp: float) -> str:
        packages = round((stamp - self._stamp) / TICK_S)
        return json.dumps({"packages": packages, "cpu_s": time.process_time() - self._cpu_s})


def struct_loop(host: str, port: int, seconds: float) -> str:
    """Read with a blocking socket and one `unpack_from` per package, the minimum in Python."""
    layout = struct.Struct(">HBB" + "".join(f"{OUTPUTS[name].count}{OUTPUTS[name].letter}" for name in VARIABLES))
    count = Count()
    with socket.create_connection((host, port)) as server:
        for request in (
            encode_version_request(),
            OutputsRequest(VARIABLES, 500.0).encode(),
            frame(PackageType.START),
        ):
            server.sendall(request)
            _skip_one(server)
        begin = time.monotonic()
        warm = False
        held = b""
        stamp = 0.0
        while (elapsed := time.monotonic() - begin) < WARM_UP_S + seconds:
            if not warm and elapsed > WARM_UP_S:
                warm = True
                count.begin(stamp)
            data = held + server.recv(1 << 18)
            whole = len(data) - len(data) % layout.size
            for at in range(0, whole, layout.size):
                stamp = layout.unpack_from(data, at)[3]
            held = data[whole:]
    return count.end(stamp)


def _skip_one(server: socket.socket) -> None:
    size, _ = struct.unpack(">HB", server.recv(HEADER_SIZE, socket.MSG_WAITALL))
    server.recv(size - HEADER_SIZE, socket.MSG_WAITALL)


async def _our_client(host: str, port: int, seconds: float) -> str:
    newest: list[float] = [0.0]
    lost: list[RtdeError] = []

    def on_package(values: tuple[object, ...], _arrival_s: float) -> None:
        newest[0] = values[0]  # type: ignore[assignment]

    client = RtdeClient(host, port, clock=time.monotonic, on_package=on_package, on_lost=lost.append)
    await client.connect()
    await client.setup(VARIABLES, 500.0)
    await client.start()
    await asyncio.sleep(WARM_UP_S)
    count = Count()
    count.begin(newest[0])
    await asyncio.sleep(seconds)
    result = count.end(newest[0])
    if lost or client.skipped or client.out_of_order:
        raise SystemExit(f"{client.skipped} skipped, {client.out_of_order} out of order, lost: {lost}")
    return result


def on_asyncio(host: str, port: int, seconds: float) -> str:
    """Read with the driver's client on asyncio's own loop."""
    return asyncio.run(_our_client(host, port, seconds))


def on_uvloop(host: str, port: int, seconds: float) -> str:
    """Read with the driver's client on uvloop."""
    return uvloop.run(_our_client(host, port, seconds))


def ur_rtde(host: str, _port: int, seconds: float) -> str:
    """Read with `RTDEReceiveInterface` of ur_rtde, C++ with a thread of its own, at the standard port."""
    client = importlib.import_module("rtde_receive").RTDEReceiveInterface(host, 500.0, list(VARIABLES))
    time.sleep(WARM_UP_S)
    count = Count()
    count.begin(client.getTimestamp())
    time.sleep(seconds)
    return count.end(client.getTimestamp())


READERS: dict[str, Callable[[str, int, float], str]] = {
    "struct_loop": struct_loop,
    "on_asyncio": on_asyncio,
    "on_uvloop": on_uvloop,
    "ur_rtde": ur_rtde,
}

if __name__ == "__main__":
    print(READERS[sys.argv[1]](sys.argv[2], int(sys.argv[3]), float(sys.argv[4])))
