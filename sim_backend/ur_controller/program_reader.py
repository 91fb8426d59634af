"""Cuts the bytes of a script port into programs, which arrive in pieces, joined, and among single lines."""

import re
from collections.abc import Iterator

LIMIT = 1 << 20
"""Largest program accepted, bytes."""

_TOKEN = re.compile(r'"[^"]*"|#.*|(?<!\.)\b(?:def|sec|thread|if|while|end)\b')
"""Tokens that matter for blocks. A keyword after a dot names a field, as in `time().sec`."""
_BLOCK = frozenset(("def", "sec", "thread", "if", "while"))


class ProgramTooLongError(ValueError):
    """More than `LIMIT` bytes came without the end of a program."""


class ProgramReader:
    """Yields complete programs: a block with its `end`, or a line that opens no block.

    Comments and blank lines between programs are dropped, so line 1 of a program is the line that begins it.
    """

    def __init__(self) -> None:
        self._line = bytearray()
        self._program: list[str] = []
        self._depth = 0
        self._size = 0

    def feed(self, data: bytes) -> Iterator[str]:
        """Take bytes, cut anywhere, and yield the programs that they complete.

        Raises:
            ProgramTooLongError: the bytes cannot be a program; nothing more can be read.
        """
        self._size += len(data)
        *lines, rest = (self._line + data).split(b"\n")
        self._line = bytearray(rest)
        for line in lines:
            yield from self._take(line.decode("utf-8", "replace") + "\n")
        if self._size > LIMIT:
            raise ProgramTooLongError(f"{self._size} bytes without the end of a program; at most {LIMIT} are taken")

    def finish(self) -> Iterator[str]:
        """Yield the last program after the client has closed, even if its `end` has no end of line."""
        inside = self._depth > 0
        for program in self._take(self._line.decode("utf-8", "replace")):
            if inside:
                yield program
            inside = False

    def _take(self, line: str) -> Iterator[str]:
        start = 0
        for token in _TOKEN.finditer(line):
            word = token[0]
            if word in _BLOCK:
                self._depth += 1
            elif word == "end" and self._depth > 0:
                self._depth -= 1
                if self._depth == 0:
                    self._program.append(line[start : token.end()])
                    start = token.end()
                    yield self._complete()
        rest = line[start:]
        if self._depth > 0:
            self._program.append(rest)
        elif rest.partition("#")[0].strip():
            self._program.append(rest)
            yield self._complete()
        else:
            self._size = len(self._line)

    def _complete(self) -> str:
        program = "".join(self._program)
        self._program.clear()
        self._size = len(self._line)
        return program
