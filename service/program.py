"""This project's command line by name: what a person types, and how one of its processes starts another."""

import ctypes
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Self

PROGRAM = "dsl-assembly"
"""Name of the console script."""
MODULE = "cli"
"""Package that runs it as `python -m`."""
_PR_SET_PDEATHSIG = 1
_LINE_LIMIT = 500


def command(*arguments: str) -> list[str]:
    """Return the command line that runs this project's program with this interpreter.

    The module is named, because a virtual environment that is not activated has the console script in no search path.
    `-P` keeps files of the working directory from taking the place of this project's modules.
    """
    return [sys.executable, "-P", "-m", MODULE, *arguments]


@dataclass(frozen=True, slots=True)
class Child:
    """A process of this program that another one has started.

    Attributes:
        name: for people.
        process: to signal it.
        log: its standard output and error.
    """

    name: str
    process: subprocess.Popen[bytes]
    log: Path

    @classmethod
    def start(
        cls, name: str, arguments: tuple[str, ...], log: Path, *, ends_with_parent: signal.Signals | None = None
    ) -> Self:
        """Start it in a session of its own, so that Ctrl-C in the parent's terminal does not reach it.

        Args:
            name: for people.
            arguments: of the program.
            log: file that its output is appended to; its folder is made.
            ends_with_parent: signal that the kernel sends it when this process ends in whatever way (Linux); None: it
                may outlive this process. Only for a thread that lives as long as this process.

        Raises:
            OSError: the log cannot be written, or no process can be made.
        """
        log.parent.mkdir(parents=True, exist_ok=True)
        with log.open("ab") as output:
            # Not asyncio's: made without an await, so that no cancellation can lose a process that is already there.
            process = subprocess.Popen(
                command(*arguments),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                start_new_session=True,
                preexec_fn=None if ends_with_parent is None else bound_to(os.getpid(), ends_with_parent),
            )
        return cls(name, process, log)

    def end(self, timeout_s: float) -> bool:
        """End it: ask by SIGTERM, and kill it if it does not end in time. Blocks until it has ended.

        Returns:
            True if it ended in time; False if it was killed.
        """
        self.process.terminate()
        try:
            self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            return False
        return True

    def ending(self) -> str | None:
        """Say how it ended, with the last line of its log; None while it runs."""
        if self.process.poll() is None:
            return None
        lines = self.log.read_text(errors="replace").strip().splitlines()
        status = self.process.returncode
        # one that was killed had no time to say why
        last = f": {lines[-1][:_LINE_LIMIT]}" if lines and status != -signal.SIGKILL else ""
        return f"the {self.name} (pid {self.process.pid}) ended with status {status}{last}"


def bound_to(parent: int, number: signal.Signals = signal.SIGKILL) -> Callable[[], None] | None:
    """Return what a new process does to have a signal when its parent ends; None where the kernel does not offer it."""
    if not sys.platform.startswith("linux"):
        return None
    libc = ctypes.CDLL(None)  # loaded before the fork: between fork and exec only the call itself is safe

    def bind() -> None:
        libc.prctl(_PR_SET_PDEATHSIG, number)
        if os.getppid() != parent:  # it ended before this process was bound to it
            os._exit(1)

    return bind
