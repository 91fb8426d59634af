"""Starts the simulator as a process of its own where nothing listens at its endpoint, and ends what was started."""

import subprocess
import sys
import time
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from socket import create_connection

START_S = 30.0
END_S = 1.0
POLL_S = 0.05


@contextmanager
def simulator(arguments: Sequence[str], endpoints: Sequence[str]) -> Generator[bool]:
    """Have a simulator while the context lasts.

    Args:
        arguments: of `python -m sim_backend`: `CellConfig.simulator_arguments`.
        endpoints: `tcp/host:port` of all that it must listen at; the first one tells whether it is there already.

    Yields:
        Whether it was started here; one that was there before is joined and left running.

    Raises:
        OSError: it ended at once, or does not listen in time.
    """
    if _listens(endpoints[0]):
        yield False
        return
    # Its own session: Ctrl-C reaches the control process alone, which stops the arm before it ends the world.
    process = subprocess.Popen(
        [sys.executable, "-m", "sim_backend", *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        for endpoint in endpoints:
            _await_listening(process, endpoint)
        yield True
    finally:
        process.terminate()
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _await_listening(process: subprocess.Popen[bytes], endpoint: str) -> None:
    deadline = time.monotonic() + START_S
    while not _listens(endpoint):
        if process.poll() is not None:
            raise OSError(f"the simulator ended with status {process.returncode}; its reason stands above")
        if time.monotonic() > deadline:
            raise OSError(f"the simulator does not listen at {endpoint} after {START_S:g} s")
        time.sleep(POLL_S)


def _listens(endpoint: str) -> bool:
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    try:
        with create_connection((host.strip("[]"), int(port)), timeout=1.0):
            return True
    except (OSError, ValueError):
        return False
