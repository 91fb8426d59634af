"""The simulator's process, for tests that kill it, freeze it or run several of it."""

import socket
import subprocess
from collections.abc import Generator
from contextlib import contextmanager

from service.program import command


def free_endpoint() -> str:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{taken.getsockname()[1]}"


@contextmanager
def sim_process(endpoint: str, mode: str = "real-time", world: str = "world-1") -> Generator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [
            *command("sim", "serve"),
            *("--world", world, "--mode", mode, "--listen", endpoint, "--realtime"),
        ],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        assert line.startswith("ready"), line
        yield process
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
