"""The table of faults with the tests of each row. As a program it writes docs/reference/fault-table.md."""

import ast
import re
import tomllib
from collections import defaultdict
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ROWS = ROOT / "tests/faults.toml"
DOCUMENT = ROOT / "docs/reference/fault-table.md"
NUMBERED = re.compile(r"test_(\d\d)_\w+")

HEAD = """\
# Fault table

Each row is a fault that the tests inject, and the outcome that they observe in the motion and the record.
The name of a row's test begins with its number. `python -m tests.fault_table` writes this page from
`tests/faults.toml` and from the tests; a test keeps it up to date.

**LATCH(code)** means: the first stop command leaves within one monitor tick (2 ms) of simulated time, 10 ms at the
99.9th percentile in a real process. No motion command follows. The cell stays latched, across a restart too, until
an explicit reset. A reset never moves the robot and never resumes the old run. A start is answered 409 with the code.
The run's row has the cause and the peak force. The recording is readable to within 0.5 s of the trip.
[Fault codes](faults.md) explains the codes; [Safety](../explanation/safety.md) says what is promised.

| row | injected | expected | tests |
|---|---|---|---|
"""


@dataclass(frozen=True)
class Row:
    """One fault.

    Attributes:
        untested: the reason why the row has no test; None where it must have one.
    """

    number: int
    inject: str
    expected: str
    untested: str | None = None


def rows() -> list[Row]:
    """The rows in their order."""
    return [Row(**row) for row in tomllib.loads(ROWS.read_text())["row"]]


@cache
def tests_by_row() -> dict[int, list[tuple[str, Path]]]:
    """The tests of each row, by name and file."""
    found: dict[int, list[tuple[str, Path]]] = defaultdict(list)
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and (name := NUMBERED.fullmatch(node.name)):
                found[int(name[1])].append((node.name, path.relative_to(ROOT)))
    return found


def text() -> str:
    """The document."""
    found = tests_by_row()
    lines = [
        f"| {row.number} | {row.inject} | {row.expected} | {_tests(row, found.get(row.number, []))} |" for row in rows()
    ]
    return HEAD + "\n".join(lines) + "\n"


def _tests(row: Row, tests: list[tuple[str, Path]]) -> str:
    if row.untested is not None:
        return f"none: {row.untested}"
    return "<br>".join(f"[`{name.removeprefix('test_')}`](../../{path})" for name, path in sorted(set(tests)))


if __name__ == "__main__":
    DOCUMENT.write_text(text())
