"""The examples of documents and docstrings run as they stand."""

import doctest
from pathlib import Path

import pytest
from sybil import Sybil
from sybil.document import PythonDocStringDocument
from sybil.parsers.markdown import PythonCodeBlockParser, SkipParser
from sybil.parsers.rest import DocTestParser

ROOT = Path(__file__).parents[2]
PACKAGES = ("wire", "service", "sim_backend", "api", "training", "benchmarks", "cli")
DOCUMENTS = [
    path for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))] if "```python" in path.read_text()
]
MODULES = [
    path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py")) if ">>> " in path.read_text()
]
IN_DOCUMENTS = Sybil(parsers=[PythonCodeBlockParser(), SkipParser()], path=str(ROOT))
IN_DOCSTRINGS = Sybil(
    parsers=[DocTestParser(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)],
    document_types={".py": PythonDocStringDocument},
    path=str(ROOT),
)


def name(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("path", DOCUMENTS, ids=name)
def test_examples_of_the_document_run(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)  # documents name `models/…` and `config/…`
    document = IN_DOCUMENTS.parse(path)
    document.namespace["tmp_path"] = tmp_path
    examples = list(document.examples())
    assert examples
    for example in examples:
        example.evaluate()


@pytest.mark.parametrize("path", MODULES, ids=name)
def test_examples_of_the_docstrings_run(path: Path) -> None:
    examples = list(IN_DOCSTRINGS.parse(path).examples())
    assert examples
    for example in examples:
        example.evaluate()
