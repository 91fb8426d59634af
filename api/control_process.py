"""Starts the control process where none answers, and ends exactly that one, by process id.

A control process that was there before is joined and left running. A started one lives in a session of its own, so
that neither Ctrl-C in the API's terminal nor the API's death reaches it: a run goes on without the API, and a new API
joins it. Its simulator is its own affair.
"""

import asyncio
from pathlib import Path

import structlog

from service.config import CellConfig
from service.program import PROGRAM, Child

_log = structlog.get_logger("api.control_process")

JOIN_S = 1.0
"""How long a control process that is already there may take to be heard."""
POLL_S = 0.05
END_S = 6.0
"""How long it may take to stop its arm and to end its simulator before it is killed."""


class ControlProcess:
    """The control process that this API started, if any.

    Args:
        config: of the cell.
        path: of its file, handed on to the control process.

    Attributes:
        child: the started process; None where it was joined, or nothing is started here.
        note: what people should know while the control process is silent.
    """

    def __init__(self, config: CellConfig, path: Path) -> None:
        self._config = config
        self._path = path
        self.child: Child | None = None
        self.note: str | None = None

    def start(self) -> None:
        """Start it, unless the configuration leaves that to others."""
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
        _log.info("started", name=self.child.name, pid=self.child.process.pid, log=str(log))

    async def end(self) -> None:
        """End the started one: asked by SIGTERM, killed if it does not end."""
        if self.child is None:
            return
        name, process = self.child.name, self.child.process
        process.terminate()
        for _ in range(int(END_S / POLL_S)):
            if process.poll() is not None:
                break
            await asyncio.sleep(POLL_S)
        else:
            _log.error("killed", name=name, pid=process.pid, waited_s=END_S)
            process.kill()
            process.wait()
        _log.info("ended", name=name, pid=process.pid, status=process.returncode)

    async def watch(self) -> None:
        """Note it when the started one ends by itself; returns then, else when cancelled."""
        if self.child is None:
            return
        while (ending := self.child.ending()) is None:
            await asyncio.sleep(POLL_S)
        self.note = f"{ending[0].upper()}{ending[1:]}. Nothing restarts it."
        _log.error("process ended", note=self.note)
