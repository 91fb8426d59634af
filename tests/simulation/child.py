"""The control process that an API starts, as the API holds it."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from tests.simulation import clock

if TYPE_CHECKING:
    from tests.simulation.universe import Universe

POLL_S = 0.01


class Child:
    """Stands in for `service.program.Child`, and for the process in it.

    A second control process finds the state directory locked, and ends.
    """

    pid = 4711

    def __init__(self, universe: "Universe", name: str, _arguments: tuple[str, ...], log: Path) -> None:
        self.name, self.log, self.process = name, log, self
        present = universe.processes.get("control")
        self._started: clock.Process | None = None
        if present is None or not present.alive:
            universe.start_control()
            self._started = universe.processes["control"]
        universe.note(f"the api starts a {name}")
        universe.starts.append((clock.here().process, universe.loop.time()))

    @property
    def returncode(self) -> int | None:
        return None if self._started is not None and self._started.alive else 1

    def terminate(self) -> None:
        if self._started is not None:
            self._started.signal(15)

    def kill(self) -> None:
        if self._started is not None:
            self._started.kill()

    def end(self, timeout_s: float) -> bool:
        self.terminate()
        loop = clock.here().process.loop
        deadline = loop.time() + timeout_s
        while self.returncode is None and loop.time() < deadline:
            clock.sleep(POLL_S)
        if self.returncode is None:
            self.kill()
            return False
        return True

    def ending(self) -> str | None:
        return None if self.returncode is None else f"the {self.name} ended"


def started_by(universe: "Universe") -> Any:
    """Return what stands in for the class `Child` in one universe."""

    class Starter:
        @staticmethod
        def start(name: str, arguments: tuple[str, ...], log: Path) -> Child:
            return Child(universe, name, arguments, log)

    return Starter
