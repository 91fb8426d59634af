"""Start and end of the other side of a measurement as a process of its own, on loopback."""

import socket
import subprocess
import sys
import threading
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path

from benchmarks.harness.result import UnavailableError

ROOT = Path(__file__).resolve().parents[2]
READY = "ready"
START_TIMEOUT_S = 90.0


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def running(
    *arguments: str,
    ready: str = READY,
    environment: Mapping[str, str] | None = None,
    lines: list[str] | None = None,
) -> Generator[subprocess.Popen[str]]:
    """Run `python -m <arguments>` until the block ends.

    Args:
        *arguments: module and its options.
        ready: text of an output line that reports readiness.
        environment: environment of the process instead of the present one.
        lines: receives the output.

    Yields:
        The process, after it has reported readiness.

    Raises:
        UnavailableError: the process ended, or was silent for too long; the text contains its last lines.
    """
    process = subprocess.Popen(
        [sys.executable, "-m", *arguments],
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    lines = [] if lines is None else lines
    seen = threading.Event()

    def read() -> None:
        assert process.stdout is not None  # noqa: S101  # a pipe was requested
        with process.stdout:
            for line in process.stdout:
                lines.append(line)
                if ready in line:
                    seen.set()
        seen.set()

    reader = threading.Thread(target=read, name="output", daemon=True)
    reader.start()
    try:
        if not seen.wait(START_TIMEOUT_S) or process.poll() is not None or not any(ready in line for line in lines):
            raise UnavailableError(f"`{' '.join(arguments)}` did not start: {''.join(lines[-5:]).strip() or 'silent'}")
        yield process
    finally:
        process.terminate()
        try:
            process.wait(5)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        reader.join(1)
