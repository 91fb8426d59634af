"""A client that does not read what it is sent holds up neither the control loop nor a stop."""

import asyncio
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Generator
from contextlib import closing, contextmanager
from pathlib import Path

from service import messages
from service.cell.control_plane import ControlPlane
from service.client import CellClient
from service.messages import Run, RunsRequest, RunState, StopRequest
from service.testing import RECIPE
from tests.service.cell.raced_cell import ready_cell
from tests.service.cell.test_process import configured, control_process
from tests.service.sim_server import free_endpoint
from wire.session import close_session, open_session, query

CELL = "under-test"
QUESTIONS = 400
LINKS = 8
LEASE_S = 10.0
"""Silence after which Zenoh gives a peer up, s."""
FROZEN = """
import os, signal, sys
from wire.session import open_session
sessions = [open_session((), [sys.argv[1]]) for _ in range(int(sys.argv[2]))]
listeners = [session.declare_subscriber("cell/**", lambda _: None) for session in sessions]
os.kill(os.getpid(), signal.SIGSTOP)
"""
HELD_UP_S = 1.5
"""Longest time for which a loaded test machine may hold the loop up, s. An answer that is not read held it for five."""


@contextmanager
def one_way(endpoint: str) -> Generator[tuple[str, threading.Event]]:
    """Yield the endpoint of a link to another one, and what makes the link carry nothing back from then on."""
    deaf, ended = threading.Event(), threading.Event()

    def carry(source: socket.socket, target: socket.socket, is_way_back: bool) -> None:
        source.settimeout(0.02)
        while not ended.is_set():
            if is_way_back and deaf.is_set():
                time.sleep(0.02)
                continue
            try:
                data = source.recv(65_536)
                target.sendall(data)
            except TimeoutError:
                continue
            except OSError:
                return
            if not data:
                return

    with socket.create_server(("127.0.0.1", 0)) as server, socket.socket() as onward:
        onward.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        threads: list[threading.Thread] = []

        def join() -> None:
            client, _ = server.accept()
            with closing(client):
                onward.connect(("127.0.0.1", int(endpoint.rpartition(":")[2])))
                ways = ((client, onward, False), (onward, client, True))
                threads.extend(threading.Thread(target=carry, args=way) for way in ways)
                for thread in threads:
                    thread.start()
                for thread in threads:
                    thread.join()

        joining = threading.Thread(target=join)
        joining.start()
        try:
            yield f"tcp/127.0.0.1:{server.getsockname()[1]}", deaf
        finally:
            ended.set()
            joining.join()


async def test_23_a_client_that_does_not_read_its_answers_holds_neither_the_loop_nor_a_stop_up(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    session = await asyncio.to_thread(open_session, [endpoint])
    key, payload = messages.QUERY_RUNS.format(cell=CELL), RunsRequest(limit=200).model_dump_json().encode()
    gaps: list[float] = []
    try:
        async with ready_cell(tmp_path) as (bench, _), CellClient(CELL, [endpoint]) as client, asyncio.timeout(60):
            ControlPlane(bench.cell, session)
            for number in range(1, 201):
                run = Run(id=f"r{number}", seq=number, recipe=RECIPE, state=RunState.FAILED, requested_at=0.0, seed=0)
                bench.cell.journal.record(run)
            with one_way(endpoint) as (link, deaf):
                other = await asyncio.to_thread(open_session, (), [link])
                while not await query(other, key, payload, 1.0):
                    await asyncio.sleep(0.02)
                deaf.set()
                for _ in range(QUESTIONS):
                    other.get(key, lambda _: None, payload=payload, timeout=30.0)
                    before = time.monotonic()
                    await asyncio.sleep(0.005)
                    gaps.append(time.monotonic() - before)
                await client.stop(StopRequest(reason="beside a deaf client"))
            await asyncio.to_thread(close_session, other)
    finally:
        await asyncio.to_thread(close_session, session)
    assert max(gaps) < HELD_UP_S


async def test_46_the_end_of_links_to_a_frozen_client_holds_no_stop_up(tmp_path: Path) -> None:
    path, endpoint = configured(tmp_path)
    async with control_process(path, endpoint) as (_, client):
        frozen = subprocess.Popen([sys.executable, "-c", FROZEN, endpoint, str(LINKS)])
        try:
            begun = time.monotonic()
            while time.monotonic() - begun < LEASE_S + 6.0:
                await client.stop(StopRequest(reason="beside a frozen client"), timeout_s=2.0)
                await asyncio.sleep(0.1)
        finally:
            frozen.kill()
            frozen.wait()
