"""Events that a controller reports to its listeners, and its refusal of a command."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from wire.rtde.modes import SafetyMode


class Refused(Exception):  # noqa: N818 (the command is at fault, not the controller)
    """A command that the controller does not carry out; the text is the real controller's."""


@dataclass(frozen=True, slots=True)
class ProgramStarted:
    """A program has started; `name` is that of its `def`."""

    name: str


@dataclass(frozen=True, slots=True)
class ProgramStopped:
    """A program has ended, by itself or by a stop."""

    name: str


@dataclass(frozen=True, slots=True)
class CompileFailed:
    """A received script does not compile; `line` and `column` count from 1, 0 if the error has no place."""

    line: int
    column: int
    text: str


@dataclass(frozen=True, slots=True)
class RuntimeFailed:
    """A program failed and was stopped; place as in `CompileFailed`, `thread` is the name of the failed thread."""

    line: int
    column: int
    thread: str
    text: str


@dataclass(frozen=True, slots=True)
class Text:
    """A line for the log, written by `textmsg`."""

    text: str


@dataclass(frozen=True, slots=True)
class SafetyChanged:
    """The safety mode has changed for the given reason."""

    mode: SafetyMode
    reason: str


@dataclass(frozen=True, slots=True)
class Popup:
    """A program asks for a message on the screen; a `blocking` one waits for `Controller.close_popup`."""

    text: str
    title: str
    warning: bool
    error: bool
    blocking: bool


Event: TypeAlias = ProgramStarted | ProgramStopped | CompileFailed | RuntimeFailed | Text | SafetyChanged | Popup
Listener: TypeAlias = Callable[[Event], None]
