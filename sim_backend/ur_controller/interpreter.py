"""Programs of a controller: the main program, which may move the arm, and the secondary programs beside it."""

from collections.abc import Callable

from sim_backend.ur_controller.events import Event, ProgramStarted, ProgramStopped, Refused, RuntimeFailed
from sim_backend.ur_controller.motion import Motion
from sim_backend.ur_controller.script import Compiled, Execution, State
from wire.rtde.modes import RuntimeState

MOST_SECONDARIES = 16
"""Secondary programs that may run at a time; more are refused."""

_RUNS = (RuntimeState.PLAYING, RuntimeState.RESUMING)
_RESTS = (RuntimeState.PAUSING, RuntimeState.PAUSED)


class Interpreter:
    """Runs programs, each by one step per tick.

    Args:
        motion: commanded motion of the arm; it decelerates when the program ends.
        emit: receives the events of programs that start, end and fail.
        ended: called when the main program has ended, before `emit`.

    Attributes:
        state: state of the main program.
        execution: the main program, or the program whose builtin is being called; None without one.
        name: name of the main program, or of the last one.
    """

    def __init__(self, motion: Motion, emit: Callable[[Event], None], ended: Callable[[], None]) -> None:
        self.state = RuntimeState.STOPPED
        self.execution: Execution | None = None
        self.name = ""
        self._motion = motion
        self._emit = emit
        self._ended = ended
        self._main: Execution | None = None
        self._secondaries: list[Execution] = []
        self._waiting = False
        self._stepping = False

    @property
    def runs(self) -> bool:
        """A main program exists and is not paused."""
        return self.state in _RUNS

    @property
    def is_paused(self) -> bool:
        """A main program is paused, or about to be."""
        return self.state in _RESTS

    @property
    def is_busy(self) -> bool:
        """A main program exists."""
        return self._main is not None

    def start(self, compiled: Compiled) -> None:
        """Replace the main program, as soon as the arm has come to rest."""
        self.stop()
        self._main = self.execution = Execution(compiled)
        self._waiting = True
        self.name = compiled.name
        self.state = RuntimeState.PLAYING
        self._emit(ProgramStarted(compiled.name))

    def start_secondary(self, compiled: Compiled) -> None:
        """Run a secondary program beside the main one.

        Raises:
            Refused: too many secondary programs run.
        """
        if len(self._secondaries) >= MOST_SECONDARIES:
            raise Refused(f"{MOST_SECONDARIES} secondary programs run already; wait for one to end")
        self._secondaries.append(Execution(compiled))

    def pause(self, *, at_once: bool = False) -> None:
        """Bring the main program and its motion to rest; `at_once` if the arm already stands."""
        if self._main is not None and (at_once or self.runs):
            self.state = RuntimeState.PAUSED if at_once else RuntimeState.PAUSING

    def resume(self) -> None:
        """Resume a paused program."""
        if self.is_paused:
            self.state = RuntimeState.RESUMING

    def stop(self) -> None:
        """End the main program; the arm decelerates. A program that stops itself ends when its builtin has returned."""
        if self._main is None:
            return
        self._main.kill()
        if self._stepping:
            return
        self._main = self.execution = None
        self._motion.hold()
        self.state = RuntimeState.STOPPING
        self._ended()
        self._emit(ProgramStopped(self.name))

    def stop_all(self) -> None:
        """End the main program and the secondary programs."""
        self.stop()
        self.stop_secondaries()

    def stop_secondaries(self) -> None:
        """End the secondary programs; the main program goes on."""
        for secondary in self._secondaries:
            secondary.kill()

    def step(self) -> None:
        """Run one tick of every program."""
        if self._secondaries:
            self._step_secondaries()
        main = self._main
        if main is None or self.state not in _RUNS:
            return
        if self._waiting and self._motion.moving:
            return  # the previous program decelerates
        self._waiting = False
        self._stepping = True
        try:
            main.step()
        finally:
            self._stepping = False
        if main.state is not State.RUNNING:
            self._report(main)
            self.stop()

    def settle(self, slider: float) -> None:
        """Note the progress of the motion in this tick; `slider` is the requested fraction of its speed."""
        if self.state is RuntimeState.STOPPING:
            if not self._motion.moving:
                self.state = RuntimeState.STOPPED
        elif self.state is RuntimeState.PAUSING:
            if self._motion.speed_fraction == 0.0:
                self.state = RuntimeState.PAUSED
        elif self.state is RuntimeState.RESUMING and self._motion.speed_fraction == slider:
            self.state = RuntimeState.PLAYING

    def _step_secondaries(self) -> None:
        for secondary in self._secondaries.copy():
            self.execution = secondary
            secondary.step()
            if secondary.state is not State.RUNNING:
                self._secondaries.remove(secondary)
                self._report(secondary)
        self.execution = self._main

    def _report(self, execution: Execution) -> None:
        error = execution.error
        if error is not None:
            self._emit(RuntimeFailed(error.line, error.column, error.thread, error.text))
