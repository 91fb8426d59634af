"""The commands that documents show exist, with the options that they show."""

import importlib
import json
import re
import shlex
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from training.learning import experiment

ROOT = Path(__file__).parents[2]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^ *```sh\n(.*?)^ *```", re.MULTILINE | re.DOTALL)
INLINE = re.compile(r"(?<!`)`((?:dsl-assembly|make|curl) [^`]+)`(?!`)")
TARGET = re.compile(r"^([a-z-]+):", re.MULTILINE)
ASSIGNMENT = re.compile(r"^[A-Z_]+=")
NOT_OURS = {
    ".": "puts the virtual environment on the path",
    "python3.11": "makes a virtual environment to throw away",
    "var/peers/bin/pip": "installs the peers of a benchmark there",
}
"""First words of the other lines in shell blocks, and what they are for."""


def commands(document: Path) -> Iterator[list[str]]:
    text = document.read_text()
    lines = [line for block in BLOCK.findall(text) for line in block.replace("\\\n", " ").splitlines() if line.strip()]
    for line in [*lines, *INLINE.findall(text)]:
        words = [word for word in shlex.split(line, comments=True) if word not in {"…", "..."}]
        yield words[next(i for i, word in enumerate(words) if not ASSIGNMENT.match(word)) :]


def shown(program: str) -> list[Any]:
    found = [(document, words) for document in DOCUMENTS for words in commands(document) if words[0] == program]
    return [pytest.param(words, id=f"{document.relative_to(ROOT)}: {' '.join(words)}") for document, words in found]


def options(arguments: list[str]) -> set[str]:
    return {word.split("=")[0] for word in arguments if word.startswith("--")}


def test_shell_blocks_hold_nothing_that_is_not_checked() -> None:
    first = {words[0] for document in DOCUMENTS for words in commands(document)}
    assert first - NOT_OURS.keys() <= {"make", "dsl-assembly", "curl"}


@pytest.mark.parametrize("words", shown("make"))
def test_make_targets_exist(words: list[str]) -> None:
    assert words[1] in TARGET.findall((ROOT / "Makefile").read_text())


@pytest.mark.parametrize("words", shown("curl"))
def test_requests_name_paths_of_the_api(words: list[str]) -> None:
    (url,) = (re.sub(r"^(http://)?[a-z0-9.]+:8000", "", word) for word in words if ":8000" in word)
    method = words[words.index("-X") + 1].lower() if "-X" in words else "get"
    assert method in json.loads((ROOT / "tests/api/openapi.json").read_text())["paths"][url]


def test_the_experiment_of_the_reference_is_one(tmp_path: Path) -> None:
    page = (ROOT / "docs/reference/experiment-file.md").read_text()
    (text,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    (tmp_path / "shown.toml").write_text(text)
    assert experiment.load(str(tmp_path / "shown.toml")).title == "Generalist over clearances"


@pytest.mark.parametrize("words", shown("dsl-assembly"))
def test_the_command_has_what_documents_show(words: list[str]) -> None:
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    module, _, attribute = scripts["dsl-assembly"].partition(":")
    command: Any = typer.main.get_command(getattr(importlib.import_module(module), attribute))
    left = [word for word in words[1:] if not word.isupper()]
    while hasattr(command, "resolve_command") and left and not left[0].startswith("-"):
        context = command.make_context(words[0], [], resilient_parsing=True)
        _, command, left = command.resolve_command(context, left)
    known = {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)} | {"--help"}
    assert options(left) <= known
