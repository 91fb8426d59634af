from collections.abc import Callable
from typing import Any

import pytest

from sim_backend.ur_controller import events
from sim_backend.ur_controller.assembly import make_controller
from sim_backend.ur_controller.outputs import Outputs
from sim_backend.ur_controller.plant import Plant
from sim_backend.world.world import World


class Bench:
    """A controller with its arm, and all that it has reported."""

    def __init__(self) -> None:
        self.plant = Plant(World(1))
        self.controller = make_controller(self.plant)
        self.outputs = Outputs(self.controller)
        self.heard: list[events.Event] = []
        self.controller.events.append(self.heard.append)

    def run(self, ticks: int) -> None:
        for _ in range(ticks):
            self.controller.tick()

    def until(self, true: Callable[[], Any], ticks: int = 5000) -> int:
        """Ticks until something has become true; fails if it does not."""
        for passed in range(ticks):
            if true():
                return passed
            self.controller.tick()
        raise AssertionError(f"not within {ticks} ticks; heard {self.heard}")

    def program(self, body: str) -> None:
        """Start a program."""
        lines = "\n".join(f"  {line}" for line in body.strip().splitlines())
        self.controller.run_script(f"def tested():\n{lines}\nend\n")

    def finish(self, body: str, ticks: int = 5000) -> None:
        """Run a program to its end; it must not fail."""
        self.program(body)
        self.until(lambda: self.of(events.ProgramStopped), ticks)
        assert not self.of(events.RuntimeFailed, events.CompileFailed), self.heard

    def of(self, *kinds: type[events.Event]) -> list[Any]:
        """Return the events of some kinds, in order."""
        return [event for event in self.heard if isinstance(event, kinds)]

    def get(self, name: str) -> Any:
        """The present value of an RTDE output."""
        return self.outputs.getters[name]()


@pytest.fixture
def bench() -> Bench:
    return Bench()
