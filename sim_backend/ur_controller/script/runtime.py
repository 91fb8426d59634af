"""Execution of a compiled script, one tick at a time.

From UR's script manual, "Threads" and "Thread scheduling": every runnable thread is scheduled once in each frame of 2
ms, until it uses time or its slice is spent; `join` waits for the end of a thread, `kill` ends a thread and those that
it has run. The end of the main program ends all threads.

Not in the manual: a critical section keeps other threads from running only between two of its statements. A thread that
waits inside a section lets them run, also in their own sections. UR's client requires this: its trajectory thread moves
inside a section while the main thread, inside another, waits for the network and may cancel the motion.
"""

import enum
import re
import resource
from collections.abc import Generator
from itertools import islice
from types import CodeType, TracebackType
from typing import Any, Final, TypeAlias

from .budget import BUDGET, EXHAUSTED
from .compiler import FILE_NAME, MAIN, Compiled
from .errors import Halt, ScriptRuntimeError
from .values import Value, integer

STEP_LIMIT: Final = 10_000
"""Operations of all threads in one tick: half a millisecond, a whole one if most of them are builtins."""
LEAST_SHARE: Final = 500
"""Operations of a thread in a tick in which earlier threads have used up the limit."""
MOST_THREADS: Final = 50
"""Threads of a program, including those that have ended in the same tick."""
DEEPEST_CALL: Final = 60
MOST_MEMORY_KIB: Final = 512 * 1024
"""Growth of the process allowed while a program runs; each value is bounded, the number of values is not."""

Code: TypeAlias = Generator[int | None, None, Value]


class State(enum.Enum):
    """State of an execution."""

    RUNNING = enum.auto()
    FINISHED = enum.auto()
    FAILED = enum.auto()


class ScriptThread:
    """One thread of a running script; the main program's handle is 0.

    Attributes:
        handle, name: identification in the script.
        parent: thread that has run it.
    """

    __slots__ = ("_code", "critical", "depth", "handle", "name", "parent")

    def __init__(self, handle: int, name: str, code: Code, parent: "ScriptThread | None" = None) -> None:
        self.handle, self.name, self.parent = handle, name, parent
        self._code: Code | None = code
        self.critical = False
        self.depth = 0

    @property
    def alive(self) -> bool:
        """The thread has neither ended nor been killed."""
        return self._code is not None

    def step(self) -> int | None:
        """Continue to the next wait; raise `StopIteration` at the end."""
        return None if self._code is None else self._code.send(None)

    def close(self) -> None:
        """End the thread where it waits."""
        code, self._code, self.parent = self._code, None, None
        if code is not None:
            code.close()


class _Killed(BaseException):
    """A thread has killed itself."""


class Execution:
    """A run of a compiled script.

    Attributes:
        name: name of the program.
        state: RUNNING until `step` or `kill` ends it.
        error: error of a FAILED run.
        current_thread: thread that runs now; None between steps.
    """

    def __init__(self, compiled: Compiled, *, step_limit: int = STEP_LIMIT) -> None:
        self.name = compiled.name
        self.state = State.RUNNING
        self.error: ScriptRuntimeError | None = None
        self.current_thread: ScriptThread | None = None
        self._limit = self._left = step_limit
        self._handles = 0
        self._memory_kib = _peak_memory_kib()
        names: dict[str, Any] = compiled.names | {
            "_run": self._run,
            "_runs": self._runs,
            "_kill": self._kill,
            "_halt": self._halt,
            "_enter_critical": self._enter_critical,
            "_exit_critical": self._exit_critical,
            "_enter_call": self._enter_call,
            "_leave_call": self._leave_call,
        }
        exec(compiled.code, names)  # noqa: S102  # built from a syntax tree of this project, see `compiler`
        self._threads = [ScriptThread(0, compiled.name, names[MAIN]())]
        self._first: ScriptThread | None = None

    def step(self) -> None:
        """Run one tick: every thread continues until it waits for the next tick.

        In its turn a thread may use the rest of the step limit, or `LEAST_SHARE` if that is more.
        """
        if not all(thread.alive for thread in self._threads):
            self._threads = [thread for thread in self._threads if thread.alive]
        if _peak_memory_kib() - self._memory_kib > MOST_MEMORY_KIB:
            self.error = ScriptRuntimeError("The program needs too much memory", thread=self.name)
            self._end(State.FAILED)
        self._left = self._limit
        first, self._first = self._first, None
        if first is not None and not self._advance(first):
            return
        for thread in self._threads:  # grows when a thread runs another
            if thread is not first and not self._advance(thread):
                return

    def kill(self) -> None:
        """End the run at once; its state is FINISHED, unless it has failed.

        Called by a builtin, it ends the calling thread at that thread's next wait.
        """
        if self.state is State.RUNNING:
            self._end(State.FINISHED)

    def _advance(self, thread: ScriptThread) -> bool:
        """Run one thread; return False if no other may run in this tick."""
        if self.state is not State.RUNNING:
            return False
        BUDGET.left = share = max(self._left, LEAST_SHARE)
        self.current_thread = thread
        exhausted = False
        try:
            exhausted = thread.step() == EXHAUSTED
        except (StopIteration, _Killed):
            thread.close()
            if thread.handle == 0:
                self._end(State.FINISHED)
        except Halt:
            self._end(State.FINISHED)
        except Exception as error:  # an error in a builtin itself must not end the controller either
            self.error = _runtime_error(error, thread.name)
            self._end(State.FAILED)
        self.current_thread = None
        if self.state is not State.RUNNING:
            self._end(self.state)
            return False
        self._left -= share - BUDGET.left
        if exhausted and thread.critical:
            self._first = thread
            return False
        return True

    def _end(self, state: State) -> None:
        self.state = state
        for thread in self._threads:
            if thread is not self.current_thread:
                thread.close()
        if self.current_thread is None:
            self._threads = []
        BUDGET.left = -1

    # called by the compiled code

    def _run(self, name: str, code: Code) -> int:
        if len(self._threads) >= MOST_THREADS:
            raise ScriptRuntimeError(f"A program can have {MOST_THREADS} threads")
        self._handles += 1
        self._threads.append(ScriptThread(self._handles, name, code, self.current_thread))
        return self._handles

    def _find(self, handle: Value) -> ScriptThread | None:
        wanted = integer(handle, "A thread handle")
        return next((t for t in self._threads if t.handle == wanted and t.alive), None) if wanted else None

    def _runs(self, handle: Value) -> bool:
        return self._find(handle) is not None

    def _kill(self, handle: Value) -> None:
        thread = self._find(handle)
        if thread is None:
            return
        doomed = {thread}
        for other in self._threads:  # a child follows its parent
            if other.parent in doomed:
                doomed.add(other)
        for other in doomed - {self.current_thread}:
            other.close()
        if self.current_thread in doomed:
            raise _Killed

    def _halt(self) -> None:
        raise Halt

    def _enter_critical(self) -> None:
        if self.current_thread is not None:
            self.current_thread.critical = True

    def _exit_critical(self) -> None:
        if self.current_thread is not None:
            self.current_thread.critical = False

    def _enter_call(self) -> ScriptThread | None:
        thread = self.current_thread
        if thread is not None:
            if thread.depth >= DEEPEST_CALL:
                raise ScriptRuntimeError(f"Functions call each other more than {DEEPEST_CALL} deep")
            thread.depth += 1
        return thread

    def _leave_call(self, thread: ScriptThread) -> None:
        thread.depth -= 1


def _peak_memory_kib() -> int:
    """Return the largest memory that the process has ever used, KiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _runtime_error(error: Exception, thread: str) -> ScriptRuntimeError:
    """Return `error` as the script's own, with its place."""
    line, column = _place_of(error.__traceback__)
    match error:
        case ScriptRuntimeError():
            text = error.text
        case NameError():
            name = re.search(r"'[vg]_(\w+)'", str(error))
            text = f"Variable {name[1] if name else '?'} is used before it has a value"
        case ZeroDivisionError():
            text = "Division by zero"
        case RecursionError():
            text = "Functions call each other too deeply"
        case _:
            text = f"{type(error).__name__}: {error}"
    mapped = ScriptRuntimeError(text, line, column, thread)
    mapped.__cause__ = error
    return mapped


def _place_of(traceback: TracebackType | None) -> tuple[int, int]:
    """Return line and column, from 1, of the innermost call made by the script itself; zeros without one."""
    place = 0, 0
    while traceback is not None:
        code: CodeType = traceback.tb_frame.f_code
        if code.co_filename == FILE_NAME:
            line, _, column, _ = next(islice(code.co_positions(), traceback.tb_lasti // 2, None))
            place = line or 0, (column or 0) + 1
        traceback = traceback.tb_next
    return place
