"""A served API as a process of its own, and the commands run against it in this process."""

import os
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
from click.testing import Result
from typer.testing import CliRunner

from cli.__main__ import app
from service.program import command


def run(*arguments: str) -> Result:
    """Run the command in this process; its two outputs are apart."""
    return CliRunner().invoke(app, arguments)


@contextmanager
def served(config_path: Path, port: int) -> Iterator[subprocess.Popen[str]]:
    """`dsl-assembly serve`, once its port answers."""
    process = subprocess.Popen(
        command("serve", "--config", str(config_path), "--port", str(port)),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    try:
        while True:
            assert process.poll() is None, process.communicate()[0]
            try:
                httpx.get(f"http://127.0.0.1:{port}/status", trust_env=False, timeout=30)
                break
            except httpx.TransportError:
                time.sleep(0.05)
        yield process
    finally:
        process.kill()
        process.communicate()


def wait_for_state(url: str, state: str) -> None:
    """Wait until the API says this state."""
    while httpx.get(f"{url}/status", trust_env=False, timeout=30).json()["state"] != state:
        time.sleep(0.02)
