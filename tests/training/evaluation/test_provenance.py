"""Provenance of a figure: commit, and digests of the sources that decide it."""

import ast
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from training.evaluation import provenance

PACKAGES = provenance.CODE
OTHERWISE = {
    "training/environment/design.py",
    "training/files.py",
    "training/evaluation/results.py",
    "wire/arrays.py",
    "wire/modes.py",
}
"""Modules that load with what plays an episode and decide nothing: the contract comes with its policy."""
COMPILED = ("sim_backend/world/compiled", "service/policy/compiled")
"""Packages of which all files decide an episode: sources of an extension, and what loads it."""


def imported(source: Path) -> Iterator[Path]:
    """Files of this project that a module imports."""
    for node in ast.walk(ast.parse(source.read_text())):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        else:
            continue
        for name in names:
            file = provenance.ROOT.joinpath(*name.split(".")).with_suffix(".py")
            if name.split(".")[0] in PACKAGES and file.is_file():
                yield file


def test_all_that_plays_an_episode_counts_as_deciding_it() -> None:
    found: set[Path] = set()
    ahead = [provenance.ROOT / "training/evaluation/evaluate.py"]
    ahead += [provenance.ROOT / folder / "__init__.py" for folder in COMPILED]
    while ahead:
        file = ahead.pop()
        if file not in found:
            found.add(file)
            ahead += imported(file)
    found |= {*(provenance.ROOT / "wire").glob("*.h")}  # which all extensions include
    for folder in COMPILED:
        found |= {file for file in (provenance.ROOT / folder).iterdir() if file.suffix in {".c", ".h", ".py"}}
    assert {file.relative_to(provenance.ROOT).as_posix() for file in found} - OTHERWISE == set(provenance.DECIDING)


def test_a_change_of_what_decides_an_episode_shows_and_where_it_lies_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = provenance.sources.__wrapped__()
    for name in provenance.DECIDING:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes((provenance.ROOT / name).read_bytes())
    monkeypatch.setattr(provenance, "ROOT", tmp_path)
    assert provenance.sources.__wrapped__() == here
    with (tmp_path / "sim_backend/world/arm.py").open("a") as file:
        file.write("CHANGED = 1\n")
    assert provenance.sources.__wrapped__() != here


def test_prose_leaves_the_digests_and_a_number_alters_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for package in provenance.CODE:
        shutil.copytree(provenance.ROOT / package, tmp_path / package)
    monkeypatch.setattr(provenance, "ROOT", tmp_path)

    def digests() -> tuple[str, str]:
        return provenance.sources.__wrapped__(), provenance.deployed_sources()

    before = digests()
    module = tmp_path / "training/environment/insertion.py"
    text = module.read_text()
    docstring = text[: text.index("\n")]
    assert docstring.startswith('"""')
    number = "SUCCESS_DEPTH_M = 2.5e-3"
    assert number in text
    module.write_text(text.replace(docstring, '"""Other words."""  # a comment\n\n"""\nMore.\n'))
    assert digests() == before
    module.write_text(text.replace(number, "SUCCESS_DEPTH_M = 2.6e-3"))
    assert all(now != old for now, old in zip(digests(), before, strict=True))


def test_a_change_of_the_service_shows_where_it_was_played_through(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    environment, deployed = provenance.sources.__wrapped__(), provenance.deployed_sources()
    assert deployed != environment
    for package in provenance.CODE:
        shutil.copytree(provenance.ROOT / package, tmp_path / package)
    monkeypatch.setattr(provenance, "ROOT", tmp_path)
    assert provenance.deployed_sources() == deployed
    for name in ("service/cell/cell.py", "service/drivers/sim_wire.py", "service/drivers/ur/control_program.urscript"):
        with (tmp_path / name).open("a") as file:
            file.write("CHANGED = 1\n")
        changed = provenance.deployed_sources()
        assert changed != deployed
        deployed = changed
    assert provenance.sources.__wrapped__() == environment


def test_a_commit_is_marked_where_code_differs_and_not_where_results_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def git(*arguments: str) -> None:
        identity = ["-c", "user.name=nobody", "-c", "user.email=nobody@localhost"]
        subprocess.run(["git", *identity, *arguments], cwd=tmp_path, check=True, capture_output=True)  # noqa: S607

    monkeypatch.setattr(provenance, "ROOT", tmp_path)
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert provenance.commit() is None
    for name in ("service/a.py", "training/b.py", "sim_backend/c.py", "results/r.json"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("as committed")
    git("init")
    assert provenance.commit() is None
    git("add", ".")
    git("commit", "-m", "all")
    (tmp_path / "results/r.json").write_text("more episodes")
    clean = provenance.commit()
    assert clean is not None
    assert len(clean) == 40
    (tmp_path / "training/b.py").write_text("another criterion")
    assert provenance.commit() == clean + provenance.DIRTY
