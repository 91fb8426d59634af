"""Starts the processes that the API's cell needs, where none answers, and ends exactly those, by process id.

A process that was there before is joined and left running. Started ones live in sessions of their own, so that neither
Ctrl-C in the API's terminal nor its death reaches them: a run goes on without the API, and a new API joins it.
"""

import asyncio
import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import structlog

from service.config import CellConfig

_log = structlog.get_logger("api.processes")

JOIN_S = 1.0
"""How long a control process that is already there may take to be heard."""
SIM_START_S = 30.0
POLL_S = 0.05
END_S = 5.0
"""How long a process may take to end by itself before it is killed."""


@dataclass(frozen=True, slots=True)
class Started:
    """One process of ours.

    Attributes:
        name: for people.
        process: to signal it.
        log: its standard output and error.
    """

    name: str
    process: subprocess.Popen[bytes]
    log: Path

    def failure(self) -> str | None:
        """Say how it ended, with the last line of its log; None while it runs."""
        if self.process.poll() is None:
            return None
        lines = self.log.read_text(errors="replace").strip().splitlines()
        status = self.process.returncode
        # one that was killed had no time to say why
        last = f": {lines[-1][:300]}" if lines and status != -signal.SIGKILL else ""
        return f"The {self.name} (pid {self.process.pid}) ended with status {status}{last}. Nothing restarts it."


class CellProcesses:
    """The processes that this API started, if any.

    Args:
        config: of the cell.
        path: of its file, handed on to the control process.
    """

    def __init__(self, config: CellConfig, path: Path) -> None:
        self._config = config
        self._path = path
        self._started: list[Started] = []
        self.joined = False
        self.note: str | None = None
        """What people should know while the control process is silent."""

    @property
    def started(self) -> Sequence[Started]:
        return tuple(self._started)

    async def start(self) -> None:
        """Start the simulator, where the driver needs one and none listens, then the control process."""
        if not self._config.api.autostart:
            self.note = "Nothing is started here (api.autostart is off): run `python -m service run`."
            return
        self.note = "It is being started."
        try:
            if (arguments := self._config.simulator_arguments) is not None:
                await self._start_sim(arguments)
            self._spawn("control process", "service", ["run", "--config", str(self._path)])
        except TimeoutError:
            self.note = f"The simulator does not listen at {self._config.sim.endpoint} after {SIM_START_S} s."
            _log.error("start", error=self.note)
        except OSError as error:
            self.note = f"It could not be started: {error}"
            _log.error("start", error=str(error))

    async def end(self) -> None:
        """End what was started, the last one first: asked by SIGTERM, killed if it does not."""
        for started in reversed(self._started):
            process = started.process
            process.terminate()
            for _ in range(int(END_S / POLL_S)):
                if process.poll() is not None:
                    break
                await asyncio.sleep(POLL_S)
            else:
                _log.error("killed", name=started.name, pid=process.pid, waited_s=END_S)
                process.kill()
                process.wait()
            _log.info("ended", name=started.name, pid=process.pid, status=process.returncode)

    async def watch(self) -> None:
        """Note when one of them ends by itself, until cancelled."""
        running = list(self._started)
        while running:
            for started in running:
                if (failure := started.failure()) is not None:
                    self.note = failure
                    _log.error("process ended", note=failure)
            running = [started for started in running if started.process.returncode is None]
            await asyncio.sleep(POLL_S)

    async def _start_sim(self, arguments: Sequence[str]) -> None:
        sim = self._config.sim
        if await _listens(sim.endpoint):
            return
        started = self._spawn("simulator", "sim_backend", arguments)
        async with asyncio.timeout(SIM_START_S):
            while not await _listens(sim.endpoint):
                if (failure := started.failure()) is not None:
                    raise OSError(failure)
                await asyncio.sleep(POLL_S)

    def _spawn(self, name: str, module: str, arguments: Sequence[str]) -> Started:
        folder = self._config.cell.state_dir / "logs"
        folder.mkdir(parents=True, exist_ok=True)
        log = folder / f"{module}.log"
        # The control process must not start a second simulator beside the one that is ended here.
        environment = os.environ | {"DSL_ASSEMBLY__SIM__AUTOSTART": "false"}
        with log.open("wb") as output:
            # Not asyncio's: made without an await, so that no cancellation can lose a process that is already there.
            process = subprocess.Popen(
                [sys.executable, "-m", module, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                start_new_session=True,
                env=environment,
            )
        started = Started(name, process, log)
        self._started.append(started)
        _log.info("started", name=name, pid=process.pid, log=str(log))
        return started


async def _listens(endpoint: str) -> bool:
    """Return whether something accepts connections at a `tcp/host:port` endpoint."""
    host, _, port = endpoint.removeprefix("tcp/").rpartition(":")
    try:
        _, writer = await asyncio.wait_for(asyncio.open_connection(host.strip("[]"), int(port)), 1.0)
    except (OSError, TimeoutError):
        return False
    writer.close()
    with contextlib.suppress(OSError):
        await writer.wait_closed()
    return True
