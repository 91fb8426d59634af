"""Scripts at work without a robot: what they print, and in which tick."""

from collections.abc import Generator

from sim_backend.ur_controller.builtins.mathematics import MATHEMATICS
from sim_backend.ur_controller.builtins.poses import POSES
from sim_backend.ur_controller.builtins.strings import STRINGS
from sim_backend.ur_controller.script import Builtin, Execution, State, Value, compile_source
from sim_backend.ur_controller.script.values import integer


class Run:
    """A script, the values that it prints with `out`, and the tick of each."""

    def __init__(self, text: str, *, step_limit: int = 10_000) -> None:
        self.printed: list[Value] = []
        self.ticks: list[int] = []
        self.threads: list[str] = []
        self.tick = 0
        self.closed: list[str] = []
        table = {
            **MATHEMATICS,
            **STRINGS,
            **POSES,
            "out": Builtin.of(self.out),
            "move": Builtin.of(self.move),
            "stop": Builtin.of(self.stop),
            "fault": Builtin.of(self.fault),
        }
        self.execution = Execution(compile_source(text, table), step_limit=step_limit)

    def out(self, value: Value) -> None:
        self.printed.append(value)
        self.ticks.append(self.tick)
        assert self.execution.current_thread is not None
        self.threads.append(self.execution.current_thread.name)

    def move(self, ticks: Value = 3, name: Value = "") -> Generator[None, None, Value]:
        count = integer(ticks, "ticks")
        try:
            for _ in range(count):
                yield
        finally:
            self.closed.append(name)
        return count * 10

    def stop(self) -> None:
        self.execution.kill()

    def fault(self) -> None:
        raise KeyError("mistake")

    def step(self, ticks: int = 1) -> "Run":
        for _ in range(ticks):
            self.tick += 1
            self.execution.step()
        return self

    def to_end(self, most: int = 1000) -> "Run":
        """Step until the script ends, which it must do without an error."""
        for _ in range(most):
            if self.execution.state is not State.RUNNING:
                break
            self.step()
        assert self.execution.state is State.FINISHED, self.execution.error
        return self


def printed(text: str) -> list[Value]:
    """Return what a script prints that runs to its end."""
    return Run(text).to_end().printed


def value(expression: str) -> Value:
    """The value of one expression."""
    (result,) = printed(f"out({expression})")
    return result


def error(text: str, most: int = 100) -> tuple[int, int, str]:
    """Line, column and text of the run-time error that ends a script."""
    run = Run(text)
    for _ in range(most):
        run.step()
        if run.execution.state is not State.RUNNING:
            break
    assert run.execution.state is State.FAILED
    failure = run.execution.error
    assert failure is not None
    return failure.line, failure.column, failure.text
