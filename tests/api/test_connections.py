"""Many connections, slow ones and idle ones: none of them holds a stop up."""

import asyncio
import resource
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from api.connections import MOST_CONNECTIONS, most_connections, most_waiting
from service.messages import CellState
from service.program import command
from tests.api.wire_cell import RECIPE, Api, WireCell, free_port
from tests.cli.serving import wait_for_state

STOP_S = 1.0
"""Bound of a stop's answer."""


@contextmanager
def served_with_few_handles(config_path: Path, port: int, handles: int) -> Iterator[str]:
    """`dsl-assembly serve`, which may not open more files than this."""
    process = subprocess.Popen(
        command("serve", "--config", str(config_path), "--port", str(port)),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (256, handles)),
    )
    url = f"http://127.0.0.1:{port}"
    try:
        while True:
            assert process.poll() is None
            try:
                wait_for_state(url, "READY")
                break
            except httpx.TransportError:
                time.sleep(0.05)
        yield url
    finally:
        process.kill()
        process.wait()


def timed_stop(url: str) -> float:
    """Stop over a connection of its own; return the time that the answer took, s."""
    began = time.monotonic()
    answer = httpx.post(f"{url}/stop", trust_env=False, timeout=30).json()
    took_s = time.monotonic() - began
    assert answer["confirmed"] is True
    return took_s


def connect(port: int, first: bytes = b"") -> socket.socket:
    client = socket.create_connection(("127.0.0.1", port), timeout=30)
    client.sendall(first)
    return client


def test_74_idle_and_slow_connections_exhaust_nothing(config_path: Path, cell: WireCell) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    port = free_port()
    heads = (b"", b"POST /sto", b"GET /status HTTP/1.1\r\nHost: localhost\r\n", b"POST /start HTTP/1.1\r\nContent-Le")
    stream = b"GET /events?frames=true HTTP/1.1\r\nHost: localhost\r\n\r\n"
    opened: list[socket.socket] = []
    try:
        with served_with_few_handles(config_path, port, handles=1024) as url:
            alone_s = timed_stop(url)
            opened += [connect(port, stream) for _ in range(100)]  # they never read
            for number in range(1500):
                opened.append(connect(port, heads[number % len(heads)]))
            wait_for_state(url, "READY")  # the server has taken them all
            assert timed_stop(url) < STOP_S + alone_s
            assert cell.stops
            assert httpx.get(f"{url}/status", trust_env=False, timeout=30).json()["state"] == "READY"
    finally:
        for client in opened:
            client.close()
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


async def test_74_the_oldest_idle_connection_makes_room_and_an_answered_stream_stays(api: Api) -> None:
    streaming = await asyncio.open_connection("127.0.0.1", api.port)
    streaming[1].write(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")
    await streaming[0].readuntil(b"event: status")
    idle = [await asyncio.open_connection("127.0.0.1", api.port) for _ in range(most_connections() + 20)]
    async with asyncio.timeout(30):
        assert await idle[0][0].read() == b"", "the oldest is closed"
    assert len(api.server.server_state.connections) <= MOST_CONNECTIONS
    await streaming[0].readuntil(b"event: status")
    assert api.subscribers == 1
    for _, writer in (*idle, streaming):
        writer.close()


def test_40_a_stop_passes_500_slow_requests(config_path: Path, cell: WireCell) -> None:
    port = free_port()
    body = f'{{"recipe": "{RECIPE}"}}'.encode()
    head = b"POST /start HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: %d\r\n\r\n"
    slow: list[socket.socket] = []
    with served_with_few_handles(config_path, port, handles=4096) as url:
        try:
            alone_s = timed_stop(url)
            httpx.post(f"{url}/start", json={"recipe": RECIPE}, trust_env=False, timeout=30)
            cell.hold_starts = True
            for number in range(500):  # a fifth of them wait for the cell, the others for the rest of their body
                slow.append(connect(port, head % len(body) + (body if number % 5 == 0 else body[:5])))
            while len(cell.held) < 50:
                time.sleep(0.02)
            wait_for_state(url, "RUNNING")
            assert timed_stop(url) < STOP_S + alone_s
            assert cell.state is CellState.LATCHED
        finally:
            cell.release()
            for client in slow:
                client.close()


@pytest.mark.parametrize("handles", [400, 1024, 20_000])
def test_74_the_handles_are_divided_with_some_to_spare(handles: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("api.connections.raise_handle_limit", lambda: handles)
    assert 0 < most_connections() <= MOST_CONNECTIONS
    assert most_connections() + most_waiting() < handles - 100
