import os
import signal
import socket
import subprocess
import threading
import time
from pathlib import Path

import pytest

from service.config import PATH_VARIABLE
from service.faults import FaultCode
from service.messages import CellState, RunState
from service.program import command
from tests.api.wire_cell import WireCell, free_port

ROOT = Path(__file__).parents[2]


def demo(config_path: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command("demo", "--once", *arguments),
        cwd=ROOT,
        env=os.environ | {PATH_VARIABLE: str(config_path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.fixture
def with_policy(config_path: Path) -> Path:
    config_path.with_name("tr.onnx").touch()
    return config_path


def end_the_run(cell: WireCell, code: FaultCode | None) -> None:
    while cell.run is None:
        time.sleep(0.02)
    time.sleep(0.3)
    cell.succeed() if code is None else cell.fault(code)


@pytest.mark.parametrize(
    ("code", "status", "word"), [(None, 0, "SUCCEEDED"), (FaultCode.FORCE_CEILING, 1, "FORCE_CEILING")]
)
def test_it_starts_a_run_over_http_and_tells_the_outcome(
    with_policy: Path, cell: WireCell, code: FaultCode | None, status: int, word: str
) -> None:
    ending = threading.Thread(target=end_the_run, args=(cell, code), daemon=True)
    ending.start()
    done = demo(with_policy, "--port", str(free_port()), "--seed", "7")
    assert done.returncode == status, done.stdout
    assert word in done.stdout
    assert cell.runs[0].seed == 7
    assert "Traceback" not in done.stdout


def test_a_latched_cell_is_not_started(with_policy: Path, cell: WireCell) -> None:
    cell.fault(FaultCode.FORCE_CEILING)
    done = demo(with_policy, "--port", str(free_port()))
    assert done.returncode == 2
    assert "FORCE_CEILING" in done.stdout
    assert not cell.runs


def test_a_port_in_use_is_one_clear_line(with_policy: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        done = demo(with_policy, "--port", str(port))
    assert done.returncode == 2
    assert f"port {port}" in done.stdout
    assert "Traceback" not in done.stdout


def test_a_missing_policy_is_one_clear_line(config_path: Path) -> None:
    done = demo(config_path, "--port", str(free_port()))
    assert done.returncode == 2
    assert "tr.onnx" in done.stdout
    assert len(done.stdout.strip().splitlines()) == 1


def test_a_missing_configuration_is_one_clear_line(tmp_path: Path) -> None:
    done = demo(tmp_path / "none.toml")
    assert done.returncode == 2
    assert "none.toml" in done.stdout
    assert "Traceback" not in done.stdout


def test_an_unknown_recipe_names_those_that_are_there(with_policy: Path) -> None:
    done = demo(with_policy, "--recipe", "cube")
    assert done.returncode == 2
    assert "tr-2mm" in done.stdout


def test_it_waits_for_a_reset_inserts_and_stays_up_until_ctrl_c(with_policy: Path, cell: WireCell) -> None:
    cell.fault(FaultCode.FORCE_CEILING)
    process = subprocess.Popen(
        command("demo", "--port", str(free_port())),
        cwd=ROOT,
        env=os.environ | {PATH_VARIABLE: str(with_policy)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith("LATCHED"):
                assert not cell.runs
                cell.latch, cell.state = None, CellState.READY
                threading.Thread(target=end_the_run, args=(cell, None), daemon=True).start()
            if "stays up" in line:
                break
        assert cell.runs[0].state is RunState.SUCCEEDED
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=30)
        assert "Traceback" not in output
        assert process.returncode == 0
    finally:
        process.kill()
        process.communicate()
