import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from service.faults import FaultCode
from service.program import command
from tests.api.wire_cell import WireCell, free_port
from tests.cli.serving import run, served, wait_for_state


@contextmanager
def watching(url: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        command("watch", "--url", url),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def read_until(process: subprocess.Popen[str], word: str) -> str:
    assert process.stdout is not None
    said = ""
    for line in process.stdout:
        said += line
        if word in line:
            return said
    raise AssertionError(f"it ended without {word}: {said}")


def test_each_change_of_state_and_each_end_of_a_run_is_a_line_until_ctrl_c(url: str, cell: WireCell) -> None:
    with watching(url) as process:
        read_until(process, "READY")
        assert run("start", "--url", url).exit_code == 0
        read_until(process, "RUNNING")
        cell.succeed()
        assert cell.runs[0].id in read_until(process, "the peg is in")
        cell.fault(FaultCode.STALE)
        read_until(process, "LATCHED")
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=20)
        assert process.returncode == 0, output
        assert "Traceback" not in output


def test_a_connection_that_is_lost_is_said_and_taken_up_again(config_path: Path, cell: WireCell) -> None:
    port = free_port()
    url = f"http://127.0.0.1:{port}"
    with served(config_path, port) as first:
        wait_for_state(url, "READY")
        with watching(url) as process:
            read_until(process, "READY")
            first.kill()
            first.wait()
            read_until(process, "connection lost")
            with served(config_path, port):
                read_until(process, "READY")
