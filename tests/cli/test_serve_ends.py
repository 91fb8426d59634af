"""SIGTERM to `serve` with real processes behind it: at every moment of its start, and in the middle of a run."""

import os
import re
import signal
import socket
import sqlite3
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import httpx
import pytest
import zenoh

from cli.serve import END_S
from service.program import command
from tests.api.wire_cell import free_port
from tests.service.sim_server import sim_process
from tests.test_end_to_end import RECIPE, config_path
from wire import keys, records
from wire.session import open_session

__all__ = ["config_path"]

EXIT_S = 2.0
"""Bound of the exit with an event stream open."""


class Served:
    """`serve`, and what can be seen of it from outside."""

    def __init__(self, config: Path, program: str = "serve") -> None:
        self.config, self.port, self.log = config, free_port(), config.with_name("serve.log")
        with self.log.open("wb") as output:
            self.process = subprocess.Popen(
                command(program, "--config", str(config), "--port", str(self.port)), stdout=output, stderr=output
            )
        self.http = httpx.Client(base_url=f"http://127.0.0.1:{self.port}", trust_env=False, timeout=15)

    def says(self, *texts: str) -> bool:
        said = self.log.read_text()
        return all(text in said for text in texts)

    def logs(self, name: str, text: str = "") -> bool:
        path = self.config.with_name("state") / "logs" / f"{name}.log"
        return path.exists() and text in path.read_text()

    def is_in(self, state: str) -> bool:
        try:
            return self.http.get("/status").json()["state"] == state
        except httpx.TransportError:
            return False

    def wait(self, condition: Callable[[], bool]) -> None:
        while not condition():
            assert self.process.poll() is None, self.log.read_text()
            time.sleep(0.005)

    def descendants(self) -> list[int]:
        """Return the processes that run for this configuration or its endpoints, this server included."""
        endpoints = re.findall(r'"(tcp/[^"]+)"', self.config.read_text())
        found: list[int] = []
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                line = (folder / "cmdline").read_bytes().split(b"\0")
            except OSError:
                continue
            words = {word.decode(errors="replace") for word in line}
            if words & {str(self.config), *endpoints} and words & {"serve", "control", "sim"}:
                found.append(int(folder.name))
        return found


@contextmanager
def serving(config: Path, program: str = "serve") -> Iterator[Served]:
    served = Served(config, program)
    try:
        yield served
    finally:
        served.http.close()
        for pid in [served.process.pid, *served.descendants()]:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        served.process.wait()


MOMENTS: dict[str, Callable[[Served], bool]] = {
    "nothing said yet": lambda _served: True,
    "page named": lambda served: served.says("page on http"),
    "application starts": lambda served: served.says("Waiting for application startup"),
    "application started": lambda served: served.says("Application startup complete"),
    "half a second later": lambda served: served.says("Application startup complete") and time.sleep(0.5) is None,
    "control process about to start": lambda served: (
        served.says("Application startup complete") and time.sleep(0.95) is None
    ),
    "control process started": lambda served: served.says('"event": "started"'),
    "simulator started": lambda served: served.logs("simulator"),
    "simulator ready": lambda served: served.logs("simulator", "ready"),
    "control process serves": lambda served: served.logs("control-process", "serving"),
    "ready": lambda served: served.is_in("READY"),
}


@pytest.mark.parametrize("moment", MOMENTS)
def test_77_sigterm_ends_the_start_and_nothing_starts_after_it(config_path: Path, moment: str) -> None:
    with serving(config_path) as served:
        served.wait(lambda: MOMENTS[moment](served))
        served.process.terminate()
        served.process.wait(END_S)
        assert served.process.returncode in {0, -signal.SIGTERM}, served.log.read_text()
        assert "Traceback" not in served.log.read_text()
        assert not served.descendants()
        time.sleep(1.5)  # longer than the server waits before it starts a control process
        assert not served.descendants()


@pytest.mark.parametrize(
    "moment",
    {
        "server started": lambda served: served.logs("api"),
        "page named": lambda served: served.logs("api", "page on http"),
        "control process started": lambda served: served.logs("control-process"),
        "ready": lambda served: served.is_in("READY"),
    }.items(),
    ids=lambda moment: moment[0],
)
def test_a_demonstration_that_is_killed_leaves_nothing_behind(
    config_path: Path, moment: tuple[str, Callable[[Served], bool]]
) -> None:
    with serving(config_path, "demo") as served:
        served.wait(lambda: moment[1](served))
        served.process.kill()
        served.process.wait()
        end = time.monotonic() + END_S
        while served.descendants():
            assert time.monotonic() < end, served.descendants()
            time.sleep(0.05)


def test_77_sigterm_ends_a_start_that_waits_for_a_locked_history(config_path: Path) -> None:
    (config_path.parent / "state").mkdir()
    with sqlite3.connect(config_path.parent / "state" / "runs.sqlite") as database, serving(config_path) as served:
        database.execute("BEGIN EXCLUSIVE")
        served.wait(lambda: served.says("Waiting for application startup"))
        served.process.terminate()
        served.process.wait(END_S)
        assert not served.descendants()
        assert not served.says('"event": "started"')


def test_48_sigterm_with_streams_open_stops_the_arm_and_exits_in_two_seconds(config_path: Path) -> None:
    text = config_path.read_text()
    endpoint = re.search(r'\[sim\].*?endpoint = "(tcp/[^"]+)"', text, re.DOTALL)
    assert endpoint is not None
    speeds: list[float] = []

    def on_state(sample: zenoh.Sample) -> None:
        state = records.decode(sample.payload.to_bytes(), records.STATE)[0]
        speeds.append(float(abs(state["qd"]).max()))

    with (
        sim_process(endpoint[1]),
        serving(config_path) as served,
        closing(open_session(connect=[endpoint[1]])) as session,
    ):
        session.declare_subscriber(keys.STATE.format(world="world-1"), on_state)
        served.wait(lambda: served.is_in("READY"))
        started = served.http.post("/start", json={"recipe": RECIPE, "seed": 7})
        assert started.status_code == 202, started.text
        with socket.create_connection(("127.0.0.1", served.port)) as unread:
            unread.sendall(b"GET /events?frames=true HTTP/1.1\r\nHost: localhost\r\n\r\n")
            with served.http.stream("GET", "/events") as events:
                next(events.iter_lines())
                served.wait(lambda: any(speed > 0.05 for speed in speeds[-5:]))
                began = time.monotonic()
                served.process.terminate()
                served.process.wait(END_S)
                took_s = time.monotonic() - began
        time.sleep(0.2)
        assert took_s < EXIT_S
        assert max(speeds[-50:]) < 1e-3, "the arm stands in a world that goes on"
        ledger = (config_path.parent / "state" / "ledger.jsonl").read_text()
        assert f'"{started.json()["id"]}"' in ledger
        assert '"INTERRUPTED"' in ledger
