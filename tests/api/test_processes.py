import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from api import application
from api.control_process import ControlProcess
from api.history import RunHistory
from service.config import PATH_VARIABLE
from service.messages import CellState
from tests.api.wire_cell import WireCell, free_port, serving, until, write_config

ROOT = Path(__file__).parents[2]


@contextmanager
def uvicorn(config_path: Path, port: int) -> Iterator[subprocess.Popen[str]]:
    """`uvicorn api.app:app` as a process of its own."""
    process = subprocess.Popen(
        [sys.executable, "-m", "uvicorn", "api.app:app", "--port", str(port)],
        cwd=ROOT,
        env=os.environ | {PATH_VARIABLE: str(config_path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def wait_for_state(process: subprocess.Popen[str], http: httpx.Client, state: CellState) -> None:
    while True:
        assert process.poll() is None, process.communicate()[0]
        try:
            if http.get("/status").json()["state"] == state:
                return
        except httpx.TransportError:
            pass
        time.sleep(0.05)


def test_sigterm_ends_the_server_although_streams_are_open(config_path: Path, cell: WireCell) -> None:
    port = free_port()
    with (
        uvicorn(config_path, port) as process,
        httpx.Client(base_url=f"http://127.0.0.1:{port}", trust_env=False, timeout=15) as http,
    ):
        wait_for_state(process, http, CellState.READY)
        with http.stream("GET", "/events") as events, http.stream("GET", "/telemetry") as frames:
            next(events.iter_lines())
            next(frames.iter_lines())
            process.send_signal(signal.SIGTERM)
            output, _ = process.communicate(timeout=10)
    assert process.returncode in {0, -signal.SIGTERM}, output
    assert "Traceback" not in output


async def test_a_control_process_that_is_there_is_joined_and_left_running(tmp_path: Path, cell_port: int) -> None:
    path = write_config(tmp_path, cell_port, autostart=True)
    with WireCell(f"tcp/127.0.0.1:{cell_port}") as cell:
        async with serving(path) as api:
            await api.wait_for_state(CellState.READY)
            await asyncio.sleep(1.2)  # past the time that it waits before it would start one
            assert api.runtime.control_process.child is None
        before = cell.seq
        await asyncio.sleep(0.2)
        assert cell.seq > before


async def test_a_control_process_is_started_at_once_where_nothing_listens(
    tmp_path: Path, cell_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(application, "JOIN_S", 3600.0)
    async with serving(write_config(tmp_path, cell_port, autostart=True)) as api:
        await until(lambda: api.runtime.control_process.child is not None)


async def test_a_control_process_is_started_before_the_server_opens_anything(
    tmp_path: Path, cell_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = asyncio.Event()
    open_history = RunHistory.open

    async def held_up(history: RunHistory) -> None:
        await opened.wait()
        await open_history(history)

    monkeypatch.setattr(RunHistory, "open", held_up)
    started: list[ControlProcess] = []
    start = ControlProcess.start

    def noted(control_process: ControlProcess) -> None:
        start(control_process)
        started.append(control_process)
        opened.set()

    monkeypatch.setattr(ControlProcess, "start", noted)
    async with asyncio.timeout(20), serving(write_config(tmp_path, cell_port, autostart=True)) as api:
        assert started == [api.runtime.control_process]


async def test_a_control_process_that_listens_is_given_time_to_be_heard(
    tmp_path: Path, cell_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(application, "JOIN_S", 3600.0)
    path = write_config(tmp_path, cell_port, autostart=True)
    with socket.create_server(("127.0.0.1", cell_port)) as silent:
        async with serving(path) as api:
            silent.accept()[0].close()
            await asyncio.sleep(0.2)
            assert api.runtime.control_process.child is None


async def test_none_is_started_beside_one_that_listens_and_is_not_heard_yet(
    tmp_path: Path, cell_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(application, "JOIN_S", 0.1)
    path = write_config(tmp_path, cell_port, autostart=True)
    with socket.create_server(("127.0.0.1", cell_port)) as starting:
        async with serving(path) as api:
            await until(lambda: f"listens at tcp/127.0.0.1:{cell_port}" in str(api.runtime.control_process.note))
            await asyncio.sleep(0.5)
            assert api.runtime.control_process.child is None
            starting.close()
            await until(lambda: api.runtime.control_process.child is not None)


def test_a_missing_configuration_is_one_line(tmp_path: Path) -> None:
    with uvicorn(tmp_path / "none.toml", free_port()) as process:
        output, _ = process.communicate(timeout=30)
    assert process.returncode == 1
    assert "none.toml" in output
    assert "Traceback" not in output


def test_a_configuration_with_a_wrong_limit_names_the_field(config_path: Path) -> None:
    config_path.write_text(config_path.read_text().replace("force_ceiling_n = 30.0", "force_ceiling_n = 300.0"))
    with uvicorn(config_path, free_port()) as process:
        output, _ = process.communicate(timeout=30)
    assert process.returncode == 1
    assert "limits.force_ceiling_n" in output
    assert "Traceback" not in output


def test_an_open_host_is_refused_without_the_setting_that_allows_it(config_path: Path) -> None:
    config_path.write_text(config_path.read_text().replace("[api]", '[api]\nhost = "192.0.2.7"'))
    with uvicorn(config_path, free_port()) as process:
        output, _ = process.communicate(timeout=30)
    assert process.returncode == 1
    assert "api.allow_remote" in output
    assert "Traceback" not in output


def test_a_port_in_use_is_said_without_a_trace(config_path: Path, cell: WireCell) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with uvicorn(config_path, taken.getsockname()[1]) as process:
            output, _ = process.communicate(timeout=30)
    assert process.returncode != 0
    assert "address already in use" in output
    assert "Traceback" not in output


def test_its_log_lines_are_json_and_requests_have_ids(config_path: Path, cell: WireCell) -> None:
    port = free_port()
    with uvicorn(config_path, port) as process:
        with httpx.Client(base_url=f"http://127.0.0.1:{port}", trust_env=False, timeout=15) as http:
            wait_for_state(process, http, CellState.READY)
            http.post("/stop")
        process.send_signal(signal.SIGTERM)
        output, _ = process.communicate(timeout=10)
    # What uvicorn says before it has loaded the application is not ours to shape.
    lines = [json.loads(line) for line in output.splitlines() if line.startswith("{")]
    requests = [line for line in lines if line["event"] == "request"]
    assert requests
    assert all(len(line["request_id"]) == 16 for line in requests)
    assert all({"level", "timestamp", "logger"} <= set(line) for line in lines)
