"""What a controller reports to whoever listens, and how it says no."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from wire.rtde.modes import SafetyMode


class Refused(Exception):  # noqa: N818 (the command is at fault, not the controller)
    """A command that the controller does not carry out; the text is the one that the real controller gives."""


@dataclass(frozen=True, slots=True)
class ProgramStarted:
    """A program runs; `name` is that of its `def`."""

    name: str


@dataclass(frozen=True, slots=True)
class ProgramStopped:
    """A program has ended, by itself or not."""

    name: str


@dataclass(frozen=True, slots=True)
class CompileFailed:
    """A script that was sent does not run; `line` and `column` count from 1, 0 where the error has no place."""

    line: int
    column: int
    text: str


@dataclass(frozen=True, slots=True)
class RuntimeFailed:
    """A program could not go on and was stopped; place as in `CompileFailed`, `thread` is that thread's name."""

    line: int
    column: int
    thread: str
    text: str


@dataclass(frozen=True, slots=True)
class Text:
    """A line for the log, as `textmsg` writes it."""

    text: str


@dataclass(frozen=True, slots=True)
class SafetyChanged:
    """The safety mode has changed, and why."""

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
