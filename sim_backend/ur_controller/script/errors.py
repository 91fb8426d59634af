"""What goes wrong with a script: found while compiling it, or while it runs."""


class CompileError(Exception):
    """A script that the controller does not start.

    Attributes:
        line, column: Where, both from 1; 0 when the error has no place.
        text: What is wrong, without the place.
    """

    def __init__(self, line: int, column: int, text: str) -> None:
        super().__init__(f"line {line}, column {column}: {text}")
        self.line, self.column, self.text = line, column, text


class ScriptRuntimeError(Exception):
    """A running script that cannot go on; the program stops.

    A builtin raises it with its text alone; the runtime adds the place and the thread.

    Attributes:
        text: What is wrong, without the place.
        line, column: Statement or call that failed, from 1; 0 until the runtime has filled them in.
        thread: Name of the thread, of the program itself for its main thread.
    """

    def __init__(self, text: str, line: int = 0, column: int = 0, thread: str = "") -> None:
        super().__init__(text)
        self.text, self.line, self.column, self.thread = text, line, column, thread

    def __str__(self) -> str:
        return f"line {self.line}, column {self.column}, in {self.thread}: {self.text}" if self.line else self.text


class Halt(BaseException):
    """`halt`: the whole program ends; no error, so that no handler of errors stops it."""
