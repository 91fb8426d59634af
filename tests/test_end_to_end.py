"""The whole path with real parts: simulator, control process and API as processes of their own, driven over HTTP."""

import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from service.config import PATH_VARIABLE
from tests.api.wire_cell import free_port
from tests.service.policy.model_files import contract, linear_model

ROOT = Path(__file__).parents[1]
RECIPE = "triangle-2mm"
POLICY_STEPS = 60


@pytest.fixture
def config_path(tmp_path: Path) -> Path:
    """The shipped configuration on ports of its own, with a policy that asks for nothing, so a run lasts a while."""
    text = (ROOT / "config" / "cell.toml").read_text()
    changes = {
        r"tcp/127\.0\.0\.1:7447": f"tcp/127.0.0.1:{free_port()}",
        r"tcp/127\.0\.0\.1:7448": f"tcp/127.0.0.1:{free_port()}",
        r"state_dir = .*": 'state_dir = "state"',
        r'policy = ".*\.onnx"': f'policy = "still.onnx"\nmax_steps = {POLICY_STEPS}',
        # What a loaded test machine does to its clock is not what these tests are about.
        r"sample_age_s = .*": "sample_age_s = 0.5\ntarget_age_s = 1.0\npolicy_deadline_s = 0.5",
    }
    for old, new in changes.items():
        text, count = re.subn(old, new, text)
        assert count == 1, old
    document = contract(max_steps=110)
    weights = np.zeros((document.observation_size, len(document.action)))
    (tmp_path / "still.onnx").write_bytes(linear_model(document, weights=weights).SerializeToString())
    path = tmp_path / "cell.toml"
    path.write_text(text)
    return path


@dataclass
class Server:
    """`uvicorn api.app:app` and a client of it."""

    process: subprocess.Popen[bytes]
    http: httpx.Client
    log: Path

    def status(self) -> dict[str, Any]:
        return self.http.get("/status").json()

    def wait(self, *states: str, seconds: float = 60) -> dict[str, Any]:
        """Return the first status whose state is one of `states`."""
        return wait_for(lambda: (status := self.status())["state"] in states and status, seconds, self.log)

    def wait_running(self, run_id: str) -> dict[str, Any]:
        """Return the first status in which this run is RUNNING."""

        def running() -> dict[str, Any] | None:
            status = self.status()
            run = status["run"]
            if run is not None and run["id"] == run_id:
                assert run["state"] == "ACTIVE", f"ended before it was RUNNING: {run}"
            return status if status["state"] == "RUNNING" else None

        return wait_for(running, 60, self.log)

    def started(self) -> dict[str, int]:
        """Return the process ids of what this API started, and of what that started."""
        found = re.findall(r'"name": "([a-z ]+)", "pid": (\d+).*"event": "started"', self.log.read_text())
        if found:
            log = self.log.with_name("state") / "logs" / "control-process.log"
            found += re.findall(r"started .* name=([a-z ]+) pid=(\d+)", log.read_text())
        return {name: int(pid) for name, pid in found}


def wait_for(condition: Callable[[], Any], seconds: float, log: Path) -> Any:
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        try:
            if found := condition():
                return found
        except httpx.TransportError:
            pass
        time.sleep(0.05)
    raise AssertionError(f"waited in vain\n{log.read_text()[-3000:]}")


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"


@contextmanager
def server(config_path: Path, name: str = "api") -> Iterator[Server]:
    port, log = free_port(), config_path.with_name(f"{name}.log")
    with log.open("wb") as output:
        process = subprocess.Popen(
            [sys.executable, "-m", "uvicorn", "api.app:app", "--port", str(port)],
            cwd=ROOT,
            env=os.environ | {PATH_VARIABLE: str(config_path)},
            stdout=output,
            stderr=output,
        )
    with httpx.Client(base_url=f"http://127.0.0.1:{port}", trust_env=False, timeout=15) as http:
        found = Server(process, http, log)
        try:
            yield found
        finally:
            process.terminate()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
            for pid in found.started().values():
                if alive(pid):
                    os.kill(pid, signal.SIGKILL)


def start(api: Server, **body: Any) -> str:
    response = api.http.post("/start", json={"recipe": RECIPE, "seed": 7} | body)
    assert response.status_code == 202, response.text
    return response.json()["id"]


def ended(api: Server, run_id: str) -> dict[str, Any]:
    return wait_for(lambda: (run := api.http.get(f"/runs/{run_id}").json())["state"] != "ACTIVE" and run, 60, api.log)


def read_events(api: Server, told: list[str]) -> None:
    with httpx.Client(base_url=api.http.base_url, trust_env=False, timeout=30) as http:
        try:
            with http.stream("GET", "/events") as response:
                told += (line for line in response.iter_lines() if line.startswith("data: "))
        except httpx.HTTPError:
            pass


def test_a_start_over_http_leads_to_an_outcome_and_the_cell_is_left_as_found(config_path: Path) -> None:
    with server(config_path) as api:
        ready = api.wait("READY")
        assert ready["measured"]["moving"] is False
        pids = api.started()
        assert set(pids) == {"simulator", "control process"}
        told: list[str] = []
        reader = threading.Thread(target=read_events, args=(api, told), daemon=True)
        reader.start()
        run_id = start(api)
        api.wait_running(run_id)
        refused = api.http.post("/start", json={"recipe": RECIPE})
        assert refused.status_code == 409
        run = ended(api, run_id)
        assert run["state"] in {"SUCCEEDED", "FAILED"}, run
        assert 0 < run["steps"] <= POLICY_STEPS
        assert run["peak_force_n"] > 0
        assert api.wait("READY")["measured"]["moving"] is False
        assert [item["id"] for item in api.http.get("/runs").json()["runs"]] == [run_id]
        api.process.terminate()
        api.process.wait(30)
        assert not [name for name, pid in pids.items() if alive(pid)]
        reader.join(10)
        assert any(run_id in line and '"kind":"RUN"' in line.replace(" ", "") for line in told)


def test_a_stop_in_mid_run_latches_until_it_is_acknowledged_and_moves_nothing(config_path: Path) -> None:
    with server(config_path) as api:
        api.wait("READY")
        run_id = start(api)
        api.wait_running(run_id)
        stopped = api.http.post("/stop")
        assert stopped.status_code == 200, stopped.text
        assert stopped.json()["confirmed"] is True
        run = ended(api, run_id)
        assert (run["state"], run["code"]) == ("STOPPED", "OPERATOR_STOP")
        refused = api.http.post("/start", json={"recipe": RECIPE})
        assert (refused.status_code, refused.json()["code"]) == (409, "OPERATOR_STOP")
        before = api.wait("LATCHED")["measured"]["tcp_position_m"]
        reset = api.http.post("/reset", json={"operator": "test", "acknowledge": "OPERATOR_STOP"})
        assert reset.status_code == 200, reset.text
        time.sleep(0.5)
        after = api.wait("READY")
        assert after["measured"]["moving"] is False
        assert np.allclose(before, after["measured"]["tcp_position_m"], atol=1e-4)
        assert api.http.get(f"/runs/{run_id}").json()["state"] == "STOPPED"


def test_an_api_that_dies_in_mid_run_ends_no_run_and_the_next_one_joins_and_stops(config_path: Path) -> None:
    with server(config_path, "first") as first:
        first.wait("READY")
        pids = first.started()
        run_id = start(first)
        first.wait_running(run_id)
        first.process.kill()
        first.process.wait()
        assert all(alive(pid) for pid in pids.values())
        with server(config_path, "second") as second:
            run = ended(second, run_id)
            assert run["state"] in {"SUCCEEDED", "FAILED"}, run
            second.wait("READY")
            again = start(second)
            second.wait_running(again)
            assert second.http.post("/stop").status_code == 200
            assert ended(second, again)["state"] == "STOPPED"
            assert not second.started()
        assert all(alive(pid) for pid in pids.values()), "what it only joined, it must leave running"


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGSTOP])
def test_46_where_the_loss_of_the_client_is_to_stop_a_run_a_dead_or_frozen_api_stops_it(
    config_path: Path, end: signal.Signals
) -> None:
    text = config_path.read_text().replace('policy = "continue"', 'policy = "stop"\nlimit_s = 0.5')
    assert "limit_s" in text
    config_path.write_text(text)
    with server(config_path, "first") as first:
        first.wait("READY")
        run_id = start(first)
        first.wait_running(run_id)
        first.process.send_signal(end)
        with server(config_path, "second") as second:
            status = second.wait("LATCHED")
            assert status["latch"]["code"] == "CLIENT_LOST"
            assert status["measured"]["moving"] is False
            assert ended(second, run_id)["state"] == "STOPPED"
        first.process.kill()


def test_a_dead_control_process_is_unknown_and_a_stop_says_that_it_reached_nobody(config_path: Path) -> None:
    with server(config_path) as api:
        api.wait("READY")
        api.wait_running(start(api))
        pids = api.started()
        os.kill(pids["control process"], signal.SIGKILL)
        status = api.wait("UNKNOWN")
        assert status["measured"] is None
        assert status["can_start"] is False
        stopped = api.http.post("/stop")
        assert (stopped.status_code, stopped.json()["reason"]) == (503, "STOP_NOT_DELIVERED")
        note = wait_for(lambda: "ended with status -9" in (why := api.status()["why_not"]) and why, 10, api.log)
        assert "control process" in note
        wait_for(lambda: not alive(pids["simulator"]), 10, api.log)


def test_a_port_that_is_taken_is_named_where_a_person_looks(config_path: Path) -> None:
    """The simulator cannot listen: its own reason reaches the status of the API, through the control process."""
    address = re.search(r"\[sim\].*?127\.0\.0\.1:(\d+)", config_path.read_text(), re.DOTALL)
    assert address is not None
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", int(address[1])))  # bound and not listening: nobody answers there
        with server(config_path) as api:
            why = wait_for(lambda: "ended with status" in (why := api.status()["why_not"]) and why, 60, api.log)
            assert f"127.0.0.1:{address[1]} is in use" in why
            assert "simulator" in why
            assert why.endswith("Nothing restarts it.")
            assert not alive(api.started()["simulator"])
