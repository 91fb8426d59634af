"""Starts the control process if none answers, and ends only the process that it started, by process id.

A control process that is already running is joined and left running. A started one lives in a session of its own, so
neither Ctrl-C in the API's terminal nor the API's death reaches it: a run continues without the API, and a new API
joins it. The control process starts and ends its simulator itself.
"""

import asyncio
from pathlib import Path

import structlog

from service.config import CellConfig
from service.program import PROGRAM, Child
from wire.endpoints import has_listener

_log = structlog.get_logger("api.control_process")

JOIN_S = 1.0
"""Time in which a running control process must be heard, s."""
OTHER_S = 40.0
"""Time in which one that listens must be heard, s. It waits for its simulator and its policies first."""
POLL_S = 0.05
END_S = 6.0
"""Time in which it must stop its arm and end its simulator before it is killed, s."""


class ControlProcess:
    """The control process that this API started, if any.

    Args:
        config: configuration of the cell.
        path: path of the configuration file, passed to the control process.

    Attributes:
        child: the started process; None if it was joined or if this API starts nothing.
        note: explanation for people while the control process is silent.
    """

    def __init__(self, config: CellConfig, path: Path) -> None:
        self._config = config
        self._path = path
        self._is_ending = False
        self.child: Child | None = None
        self.note: str | None = None

    async def may_be_joined(self) -> bool:
        """Return whether a control process may be there; False only where this API may start one and none listens."""
        if not self._config.api.autostart:
            return True
        return await asyncio.to_thread(has_listener, self._config.cell.endpoint) is not False

    async def is_starting(self) -> bool:
        """Return whether another control process may be starting; it listens before it is heard.

        False where this API starts none anyway.
        """
        found = self._config.api.autostart and await asyncio.to_thread(has_listener, self._config.cell.endpoint) is True
        if found:
            self.note = f"Something listens at {self._config.cell.endpoint} and is not heard yet."
        return found

    def start(self) -> None:
        """Start the control process, unless `api.autostart` is off or this API is told to end."""
        if self._is_ending:
            return
        if not self._config.api.autostart:
            self.note = f"Nothing is started here (api.autostart is off): run `{PROGRAM} control`."
            return
        self.note = "It is being started."
        log = self._config.cell.state_dir / "logs" / "control-process.log"
        try:
            self.child = Child.start("control process", ("control", "--config", str(self._path)), log)
        except OSError as error:
            self.note = f"It could not be started: {error}"
            _log.error("start", error=str(error))
            return
        if self._is_ending:  # the signal came while it was started
            self.child.process.terminate()
        _log.info("started", name=self.child.name, pid=self.child.process.pid, log=str(log))

    def end_soon(self) -> None:
        """Ask the started process to end, and start none from now on. A signal handler may call this at any moment."""
        self._is_ending = True
        if self.child is not None:
            self.child.process.terminate()

    async def end(self) -> None:
        """End the started process: ask by SIGTERM, and kill it if it does not end within `END_S`."""
        self.end_soon()
        if self.child is None:
            return
        name, process = self.child.name, self.child.process
        if not await asyncio.to_thread(self.child.end, END_S):
            _log.error("killed", name=name, pid=process.pid, waited_s=END_S)
        _log.info("ended", name=name, pid=process.pid, status=process.returncode)

    async def watch(self) -> None:
        """Wait until the started process ends by itself, note it and return. Runs until then or until cancelled."""
        if self.child is None:
            return
        while (ending := self.child.ending()) is None:
            await asyncio.sleep(POLL_S)
        if self._is_ending:
            return
        self.note = f"{ending[0].upper()}{ending[1:]}. Nothing restarts it."
        _log.error("process ended", note=self.note)
