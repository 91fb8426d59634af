import json
import os
import signal
import socket
import subprocess
import time
from pathlib import Path

import httpx
import pytest

from service.program import command
from tests.api.wire_cell import WireCell, free_port
from tests.cli.serving import served, wait_for_state
from tests.service.test_logs import full_pipe


def serve(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command("serve", *arguments), capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_it_serves_until_it_is_told_to_end(config_path: Path, cell: WireCell, number: signal.Signals) -> None:
    port = free_port()
    with served(config_path, port) as process:
        wait_for_state(f"http://127.0.0.1:{port}", "READY")
        process.send_signal(number)
        output, _ = process.communicate(timeout=20)
    assert process.returncode == 0, output
    assert output.startswith(f"cell cell-test: page on http://127.0.0.1:{port}")
    assert "Traceback" not in output


def test_a_port_in_use_is_one_line_and_starts_nothing(config_path: Path) -> None:
    config_path.write_text(config_path.read_text().replace("autostart = false", "autostart = true"))
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        done = serve("--config", str(config_path), "--port", str(taken.getsockname()[1]))
    assert done.returncode == 3
    assert "another --port" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (config_path.parent / "var").exists()


def test_76_a_stop_is_answered_although_nobody_reads_the_log(config_path: Path, cell: WireCell) -> None:
    port = free_port()
    read, write = full_pipe()
    process = subprocess.Popen(command("serve", "--config", str(config_path), "--port", str(port)), stderr=write)
    try:
        with httpx.Client(base_url=f"http://127.0.0.1:{port}", trust_env=False, timeout=5) as http:
            deadline = time.monotonic() + 60
            while True:
                assert time.monotonic() < deadline, "it serves"
                try:
                    if http.get("/status").json()["state"] == "READY":
                        break
                except httpx.ConnectError:
                    pass
                time.sleep(0.05)
            for _ in range(50):
                assert http.get("/runs").status_code == 200
            assert http.post("/stop").status_code == 200
        process.send_signal(signal.SIGTERM)
        assert process.wait(20) == 0
    finally:
        process.kill()
        process.wait()
        os.close(read)
        os.close(write)


def test_a_configuration_that_cannot_be_used_names_the_field(config_path: Path) -> None:
    config_path.write_text(config_path.read_text().replace("force_ceiling_n = 30.0", "force_ceiling_n = 300.0"))
    done = serve("--config", str(config_path))
    assert done.returncode == 2
    assert "limits.force_ceiling_n" in done.stderr
    assert "Traceback" not in done.stderr


def test_an_open_host_is_refused_without_the_setting_that_allows_it(config_path: Path) -> None:
    done = serve("--config", str(config_path), "--host", "192.0.2.7")
    assert done.returncode == 2
    assert "api.allow_remote" in done.stderr


def test_without_any_configuration_it_says_how_to_write_one(tmp_path: Path) -> None:
    done = subprocess.run(command("serve"), cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert "dsl-assembly config new FOLDER" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_a_second_ctrl_c_leaves_no_control_process_behind(config_path: Path) -> None:
    config_path.write_text(config_path.read_text().replace("autostart = false", "autostart = true"))
    port = free_port()
    with served(config_path, port) as process:
        log = config_path.parent / "var/logs/control-process.log"
        while not log.exists():
            time.sleep(0.02)
        with httpx.stream("GET", f"http://127.0.0.1:{port}/events", trust_env=False, timeout=30) as stream:
            next(stream.iter_lines())
            process.send_signal(signal.SIGINT)
            time.sleep(0.05)
            process.send_signal(signal.SIGINT)
            output, _ = process.communicate(timeout=20)
    assert process.returncode == 0, output
    assert '"name": "control process"' in output
    (ended,) = [line for line in output.splitlines() if '"event": "ended"' in line]
    pid = json.loads(ended)["pid"]
    assert not Path(f"/proc/{pid}").exists()
