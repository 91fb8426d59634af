"""Python source without its prose: what is left decides what the code computes."""

import ast
import io
import tokenize
from collections.abc import Iterator

Position = tuple[int, int]
"""Line from 1, column from 0 in characters."""
Span = tuple[Position, Position]


def without_prose(text: str) -> str:
    """Return source text without docstrings, comments, blank lines and trailing spaces.

    Every statement that is nothing but a string counts as a docstring. All else stays as it is written, so the result
    does not depend on the version of Python that reads it.

    Raises:
        SyntaxError: the text is not Python.
    """
    lines = text.split("\n")
    comments, literals = _comments_and_literals(text)
    for (first, begin), (last, end) in sorted([*_docstrings(text, lines), *comments], reverse=True):
        lines[first - 1] = lines[first - 1][:begin] + lines[last - 1][end:]
        lines[first:last] = [""] * (last - first)
    untrimmed = {row for (first, _), (last, _) in literals for row in range(first, last)}
    inside = {row + 1 for row in untrimmed}
    kept = (
        line if row in untrimmed else line.rstrip()
        for row, line in enumerate(lines, 1)
        if row in inside or line.strip()
    )
    return "".join(f"{line}\n" for line in kept)


def _docstrings(text: str, lines: list[str]) -> list[Span]:
    def position(line: int, column_bytes: int) -> Position:
        return line, len(lines[line - 1].encode()[:column_bytes].decode())

    return [
        (position(node.lineno, node.col_offset), position(node.end_lineno or 0, node.end_col_offset or 0))
        for node in _string_statements(text)
    ]


def _string_statements(text: str) -> Iterator[ast.Expr]:
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node


def _comments_and_literals(text: str) -> tuple[list[Span], list[Span]]:
    """Find comments, and string literals that are no statements of their own; only these keep their spaces."""
    prose_rows = {node.lineno for node in _string_statements(text)}
    comments: list[Span] = []
    literals: list[Span] = []
    begun: list[Position] = []
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        match tokenize.tok_name[token.type]:
            case "COMMENT":
                comments.append((token.start, token.end))
            case "STRING" if token.start[0] not in prose_rows:
                literals.append((token.start, token.end))
            case "FSTRING_START" | "TSTRING_START":  # Python 3.12 and later; before, an f-string is one STRING
                begun.append(token.start)
            case "FSTRING_END" | "TSTRING_END":
                literals.append((begun.pop(), token.end))
            case _:
                pass
    return comments, literals
