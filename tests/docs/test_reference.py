"""Documents name modules and files that exist; the Python reference and the menu leave none out."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = ROOT / "docs/reference/python"
LISTED = {name for page in PAGES.glob("*.md") for name in re.findall(r"^::: (\S+)$", page.read_text(), re.MULTILINE)}
GENERATED = {"results.md", "models.md", "panels.md"}
WRITTEN = [path for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))] if path.name not in GENERATED]
FOLDERS = "api|benchmarks|cli|config|docs|models|service|sim_backend|tests|training|wire"
FILE = re.compile(rf"`((?:{FOLDERS})/[a-z0-9_./-]*)`")
INTERNAL = {"service.policy.onnx_file", "service.policy.window", "service.policy.worker"}


@pytest.mark.parametrize("package", ["service.safety", "service.policy", "training.environment"])
def test_every_public_module_of_the_package_stands_in_the_reference(package: str) -> None:
    files = (ROOT / package.replace(".", "/")).glob("*.py")
    modules = {f"{package}.{file.stem}" for file in files if not file.stem.startswith("_")}
    assert not modules - LISTED - INTERNAL, f"add '::: MODULE' to a page in {PAGES.relative_to(ROOT)}"


def test_listed_modules_exist() -> None:
    places = [ROOT / name.replace(".", "/") for name in LISTED]
    assert places
    assert not [at for at in places if not at.with_suffix(".py").is_file() and not (at / "__init__.py").is_file()]


def test_the_menu_lists_every_document() -> None:
    menu = (ROOT / "mkdocs.yml").read_text()
    documents = {str(path.relative_to(ROOT / "docs")) for path in (ROOT / "docs").rglob("*.md")}
    assert not [name for name in documents if not re.search(rf"[ :]{re.escape(name)}$", menu, re.MULTILINE)]


@pytest.mark.parametrize("document", WRITTEN, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_that_documents_name_exist(document: Path) -> None:
    named = {name.rstrip("/") for name in FILE.findall(document.read_text())}
    assert not [name for name in named if not (ROOT / name).exists()]
