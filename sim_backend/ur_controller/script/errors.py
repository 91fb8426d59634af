"""Errors of a script, found while compiling it or while it runs."""


class CompileError(Exception):
    """A script that the controller does not start.

    Attributes:
        line, column: place, both from 1; 0 if the error has no place.
        text: description of the error, without the place.
    """

    def __init__(self, line: int, column: int, text: str) -> None:
        super().__init__(f"line {line}, column {column}: {text}")
        self.line, self.column, self.text = line, column, text


class ScriptRuntimeError(Exception):
    """A running script that cannot continue; the program stops.

    A builtin raises it with its text alone; the runtime adds the place and the thread.

    Attributes:
        text: description of the error, without the place.
        line, column: place of the failed statement or call, from 1; 0 until the runtime fills it in.
        thread: name of the thread; the main thread has the program's name.
    """

    def __init__(self, text: str, line: int = 0, column: int = 0, thread: str = "") -> None:
        super().__init__(text)
        self.text, self.line, self.column, self.thread = text, line, column, thread

    def __str__(self) -> str:
        return f"line {self.line}, column {self.column}, in {self.thread}: {self.text}" if self.line else self.text


class Halt(BaseException):
    """`halt`: the whole program ends. This is no error, so no error handler catches it."""
