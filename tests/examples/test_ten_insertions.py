"""The client of the examples against a served API and its simulated cell."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.config import PATH_VARIABLE
from tests.api.wire_cell import free_port

ROOT = Path(__file__).parents[2]
STARTED = re.compile(r'"pid": (\d+).*"event": "started"')


@pytest.fixture(scope="module")
def http(tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """A client of the shipped cell, served on ports of its own."""
    folder = tmp_path_factory.mktemp("cell")
    text = (ROOT / "config/cell.toml").read_text()
    for old, new in {
        r"tcp/127\.0\.0\.1:7447": f"tcp/127.0.0.1:{free_port()}",
        r"tcp/127\.0\.0\.1:7448": f"tcp/127.0.0.1:{free_port()}",
        r"state_dir = .*": 'state_dir = "state"',
        r'policy = "\.\./models/': f'policy = "{ROOT}/models/',
        # These tests are about the client, not about a loaded machine's clock.
        r"sample_age_s = .*": "sample_age_s = 0.5\ntarget_age_s = 1.0\npolicy_deadline_s = 0.5",
    }.items():
        text, count = re.subn(old, new, text)
        assert count == 1, old
    (folder / "cell.toml").write_text(text)
    port, log = free_port(), folder / "api.log"
    with log.open("wb") as output:
        server = subprocess.Popen(
            [sys.executable, "-m", "uvicorn", "api.app:app", "--port", str(port)],
            cwd=ROOT,
            env=os.environ | {PATH_VARIABLE: str(folder / "cell.toml")},
            stdout=output,
            stderr=output,
        )
    with httpx.Client(base_url=f"http://127.0.0.1:{port}", trust_env=False, timeout=15) as client:
        try:
            wait(lambda: client.get("/status").json()["state"] == "READY", log)
            yield client
        finally:
            server.terminate()
            try:
                server.wait(20)
            except subprocess.TimeoutExpired:
                server.kill()
                for pid in STARTED.findall(log.read_text()):
                    os.kill(int(pid), signal.SIGKILL)


def wait(condition: Callable[[], Any], log: Path | None = None) -> None:
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        try:
            if condition():
                return
        except httpx.TransportError:
            pass
        time.sleep(0.05)
    raise AssertionError("waited in vain\n" + (log.read_text()[-3000:] if log else ""))


def client(http: httpx.Client, *arguments: str) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "examples/ten_insertions.py", "--url", str(http.base_url), *arguments],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_two_insertions_make_a_table_of_two_rows(http: httpx.Client) -> None:
    process = client(http, "--count", "2")
    told, error = process.communicate(timeout=100)
    head, *rows, summary = told.splitlines()
    assert not error
    assert head.split() == ["seed", "outcome", "depth", "peak", "force", "steps", "time"]
    runs = {run["seed"]: run for run in http.get("/runs").json()["runs"]}
    assert [int(row.split()[0]) for row in rows] == [0, 1]
    for row in rows:
        run = runs[int(row.split()[0])]
        assert row.split()[1] == (run["code"] or run["state"])
        assert f"{run['peak_force_n']:.1f} N" in row
    inserted = sum(run["state"] == "SUCCEEDED" for run in runs.values())
    assert summary == f"{inserted} of 2 pegs are in"
    assert process.returncode == (0 if inserted == 2 else 1)


def test_a_recipe_that_the_cell_does_not_have_is_refused_with_those_that_it_has(http: httpx.Client) -> None:
    process = client(http, "--recipe", "unheard-of")
    error = process.communicate(timeout=60)[1]
    assert process.returncode == 2
    assert "UNKNOWN_RECIPE" in error
    assert "triangle-2mm" in error


def test_a_latched_cell_ends_the_work_and_is_left_to_a_person(http: httpx.Client) -> None:
    working = client(http, "--count", "3")
    wait(lambda: http.get("/status").json()["state"] == "RUNNING")
    http.post("/stop")
    told, error = working.communicate(timeout=60)
    assert working.returncode == 2
    assert "OPERATOR_STOP" in told.splitlines()[-1], "the run that was stopped is in the table"
    assert "LATCHED by OPERATOR_STOP" in error

    again = client(http, "--count", "1")
    told, error = again.communicate(timeout=60)
    assert again.returncode == 2
    assert not told
    assert "LATCHED by OPERATOR_STOP" in error
    assert "POST /reset" in error
    assert http.get("/status").json()["state"] == "LATCHED"


def test_an_api_that_is_not_there_is_said_in_one_line() -> None:
    with httpx.Client(base_url=f"http://127.0.0.1:{free_port()}") as nobody:
        process = client(nobody)
    error = process.communicate(timeout=60)[1]
    assert process.returncode == 2
    assert len(error.splitlines()) == 1
    assert error.startswith("stopped: ")
