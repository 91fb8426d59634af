"""The start of a control process: what waits for its simulator, and what does not."""

import asyncio
import os
import signal
import subprocess
from pathlib import Path

from service.cell.process import WATCHDOG_DEAF
from service.client import CellClient
from service.drivers.sim_process import Simulator
from service.messages import CellState
from service.program import Child
from tests.scheduling import children
from tests.service.cell.test_process import configured, control_process, started_control, until
from wire.endpoints import has_listener


async def child(process: subprocess.Popen[bytes], words: str) -> int:
    """Wait for a child of a process with these words in its command line; return its id."""
    found: list[int] = []

    def look() -> bool:
        found.extend(pid for pid, line in children(process.pid).items() if words in line)
        return bool(found)

    await until(look)
    return found[0]


async def test_policies_and_the_watchdog_load_and_clients_connect_while_the_simulator_starts(tmp_path: Path) -> None:
    path, endpoint = configured(tmp_path)
    with started_control(path) as process:
        simulator = await child(process, "sim serve")
        os.kill(simulator, signal.SIGSTOP)
        for other in ("policy.worker", "service.drivers.watchdog"):
            await child(process, other)
        await until(lambda: has_listener(endpoint))
        async with CellClient("cell-1", [endpoint]) as client:
            await asyncio.sleep(0.5)
            assert client.state is CellState.UNKNOWN, "nothing is served before the simulator listens"
            os.kill(simulator, signal.SIGCONT)
            await until(lambda: client.state is CellState.READY)


async def test_a_simulator_at_a_socket_in_the_file_system_is_waited_for(tmp_path: Path) -> None:
    path, endpoint = configured(tmp_path, **{"tcp/127.0.0.1:7448": f"unixsock-stream/{tmp_path}/sim"})
    async with control_process(path, endpoint) as (_, client):
        assert client.state is CellState.READY


async def test_nothing_is_served_before_the_watchdog_is_ready_and_a_late_one_is_told(tmp_path: Path) -> None:
    path, endpoint = configured(tmp_path)
    with started_control(path) as process:
        watchdog = await child(process, "service.drivers.watchdog")
        os.kill(watchdog, signal.SIGSTOP)
        for other in ("sim serve", "policy.worker"):
            await child(process, other)
        async with CellClient("cell-1", [endpoint]) as client:
            await until(lambda: has_listener(endpoint))
            await asyncio.sleep(2.0)
            assert client.state is CellState.UNKNOWN
            await until(lambda: client.state is CellState.READY)

            def told() -> bool:
                return client.last_status is not None and WATCHDOG_DEAF in client.last_status.degradations

            await until(told)
            os.kill(watchdog, signal.SIGCONT)
            await until(lambda: not told())
            assert client.state is CellState.READY


def test_a_simulator_whose_endpoint_cannot_be_asked_is_left_to_the_driver(tmp_path: Path) -> None:
    child = Child.start("simulator", ("--version",), tmp_path / "log")
    assert Simulator(child, ["quic/127.0.0.1:7448"]).listens()
    child.end(10.0)


async def test_a_control_process_that_waits_for_its_simulator_ends_when_told_to(tmp_path: Path) -> None:
    path, endpoint = configured(tmp_path)
    with started_control(path) as process:
        simulator = await child(process, "sim serve")
        os.kill(simulator, signal.SIGSTOP)
        await until(lambda: has_listener(endpoint))
        process.send_signal(signal.SIGTERM)
        assert await asyncio.to_thread(process.wait, 20) == 0
        assert not Path(f"/proc/{simulator}").exists()


async def test_a_simulator_that_ends_while_it_starts_ends_the_control_process(tmp_path: Path) -> None:
    path, _ = configured(tmp_path)
    with started_control(path, stderr=subprocess.PIPE) as process:
        simulator = await child(process, "sim serve")
        os.kill(simulator, signal.SIGKILL)
        _, said = await asyncio.to_thread(process.communicate, timeout=20)
        assert process.returncode == 3
        assert b"the control process cannot run: the simulator (pid " in said
        assert b"Traceback" not in said
