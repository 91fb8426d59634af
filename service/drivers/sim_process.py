"""Starts the simulator as a process of its own if nothing listens at its endpoint, and ends what it started."""

import asyncio
import signal
import time
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path

import structlog

from service.program import Child
from wire.endpoints import has_listener

START_S = 30.0
END_S = 1.0
WATCH_S = 0.5

_log = structlog.get_logger("service.simulator")


class Simulator:
    """The simulator that a driver talks to.

    Args:
        child: the process that was started for it; None if it was already running or belongs to others.
        endpoints: every endpoint at which a started simulator must listen.
    """

    def __init__(self, child: Child | None = None, endpoints: Sequence[str] = ()) -> None:
        self.child = child
        self._awaited = list(endpoints)
        self._deadline_s = time.monotonic() + START_S

    def listens(self) -> bool:
        """Return whether a started simulator listens by now; True for one that was already running.

        An endpoint that cannot be asked is taken to listen: the driver finds out, and tries again.

        Raises:
            OSError: the simulator has ended or does not listen in time; the text says why.
        """
        if self.child is None:
            return True
        while self._awaited and has_listener(self._awaited[0]) is not False:
            self._awaited.pop(0)
        if not self._awaited:
            return True
        if (ending := self.child.ending()) is not None:
            raise OSError(ending)
        if time.monotonic() > self._deadline_s:
            where = self._awaited[0]
            raise OSError(f"the simulator does not listen at {where} after {START_S:g} s; its log is {self.child.log}")
        return False

    async def watch(self) -> None:
        """Wait until a started simulator ends by itself, log it and return. Runs until then or until cancelled."""
        if self.child is None:
            return
        while (ending := self.child.ending()) is None:
            await asyncio.sleep(WATCH_S)
        _log.error("process ended", why=ending)


@contextmanager
def simulator(arguments: Sequence[str], endpoints: Sequence[str], log: Path) -> Generator[Simulator]:
    """Keep a simulator running while the context lasts. A simulator that is already running is joined and left running.

    A started simulator does not outlive this process, however this process ends.

    Args:
        arguments: arguments of this project's program.
        endpoints: every endpoint at which it must listen. The first tells whether it is already running.
        log: file for the output of a started simulator.

    Yields:
        The simulator. Wait until it `listens` before using it.

    Raises:
        OSError: the simulator cannot be started.
    """
    if has_listener(endpoints[0]):
        yield Simulator()
        return
    # A session of its own: Ctrl-C reaches the control process alone, which stops the arm before it ends the world.
    child = Child.start("simulator", tuple(arguments), log, ends_with_parent=signal.SIGKILL)
    _log.info("started", name=child.name, pid=child.process.pid, log=str(log))
    try:
        yield Simulator(child, endpoints)
    finally:
        child.end(END_S)
        _log.info("ended", name=child.name, pid=child.process.pid, status=child.process.returncode)
