"""Which changes of a source are prose, and which are code."""

import io
import tokenize

import pytest

from training.evaluation import provenance
from training.evaluation.source_code import without_prose

SOURCE = '''
"""A module."""

import math  # for pi

LIMIT_N = 30.0
"""Where an episode ends."""
TEXT = """First line.

    # not a comment   
"""  # a comment


class Nothing(Exception):
    """It has a docstring alone."""


def area(radius: float) -> float:
    """Return the area, µm²."""
    # the usual formula

    name = f"{radius!r} # {'a'}"
    return math.pi * radius**2 if name else 0.0  # nosec
'''


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("A module.", "Another text.\n\nIn several lines.\n"),
        ("# the usual formula", "# Archimedes"),
        ("    # the usual formula\n\n", ""),
        ("# for pi", ""),
        ("  # for pi", ""),
        ("Where an episode ends.", "Newtons."),
        ('"""Where an episode ends."""\n', ""),
        ("It has a docstring alone.", "It says something else."),
        ("µm²", "m²"),
        ("# a comment", "# another"),
        ("\n\n\ndef", "\ndef"),
    ],
)
def test_prose_does_not_count(old: str, new: str) -> None:
    assert SOURCE.count(old) == 1
    assert without_prose(SOURCE.replace(old, new)) == without_prose(SOURCE)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("30.0", "30.1"),
        ("radius**2", "radius**3"),
        ("# not a comment   ", "# not a comment"),
        ("First line.\n\n", "First line.\n"),
        ("# {'a'}", "#{'a'}"),
        ("import math", "import cmath as math"),
    ],
)
def test_code_counts(old: str, new: str) -> None:
    assert SOURCE.count(old) == 1
    assert without_prose(SOURCE.replace(old, new)) != without_prose(SOURCE)


def words(text: str) -> list[str]:
    """Names, numbers, operators and strings of a source, without the strings that are statements."""
    layout = (tokenize.COMMENT, tokenize.NL, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
    tokens = [token for token in tokenize.generate_tokens(io.StringIO(text).readline) if token.type not in layout]
    ends = [tokenize.NEWLINE, *(token.type for token in tokens), tokenize.NEWLINE]
    return [
        token.string
        for token, before, after in zip(tokens, ends, ends[2:], strict=False)
        if token.type != tokenize.NEWLINE
        and not (token.type == tokenize.STRING and before == after == tokenize.NEWLINE)
    ]


def test_what_is_left_of_the_whole_project_is_its_code() -> None:
    for package in provenance.CODE:
        for path in provenance.ROOT.glob(f"{package}/**/*.py"):
            text = path.read_text()
            left = without_prose(text)
            assert words(left) == words(text), path
            assert all(line.strip() for line in left.splitlines()) or '"""' in left, path
