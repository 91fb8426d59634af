"""Away from the checkout: a wheel of this project in a fresh environment, and a cell that works there."""

import os
import shutil
import subprocess
import sys
import sysconfig
import time
import tomllib
import venv
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.api.wire_cell import free_port

ROOT = Path(__file__).parents[2]
ENVIRONMENT = {
    name: value for name, value in os.environ.items() if name != "PYTHONPATH" and not name.startswith("DSL_ASSEMBLY")
}


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The console script of an environment that has the wheel, and this one's libraries, but not this checkout."""
    folder = tmp_path_factory.mktemp("away")
    source, environment = folder / "source", folder / "environment"
    source.mkdir()
    for path in ROOT.iterdir():  # a build leaves its traces beside the source
        if path.is_file() and not path.is_symlink():
            shutil.copy(path, source)
        elif (path / "__init__.py").exists() or path.name in {"config", "models"}:
            shutil.copytree(path, source / path.name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    venv.create(environment, with_pip=False)
    python = environment / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    for command in (
        [*pip, "wheel", "--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", folder, source],
        [*pip, "--python", python, "install", "--no-deps", "--no-index", "--find-links", folder, "dsl-assembly"],
    ):
        done = subprocess.run(command, capture_output=True, text=True, env=ENVIRONMENT)
        assert done.returncode == 0, done.stderr
    here = Path(sysconfig.get_path("purelib", vars={"base": str(environment)}))
    # A path line alone: the links to this checkout in that folder are not followed.
    (here / "libraries.pth").write_text(f"{sysconfig.get_path('purelib')}\n{sysconfig.get_path('platlib')}\n")
    return environment / "bin" / "dsl-assembly"


def run(installed: Path, *arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([installed, *arguments], cwd=cwd, env=ENVIRONMENT, capture_output=True, text=True, timeout=90)


@pytest.fixture
def cell(installed: Path, tmp_path: Path) -> Path:
    """A new cell's folder on ports of its own."""
    done = run(installed, "config", "new", "cell", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    file = tmp_path / "cell" / "cell.toml"
    text = file.read_text()
    for old, new in {
        "127.0.0.1:7447": f"127.0.0.1:{free_port()}",
        "127.0.0.1:7448": f"127.0.0.1:{free_port()}",
        "port = 8000": f"port = {free_port()}",
        # What a loaded test machine does to its clock is not what these tests are about.
        "sample_age_s = 0.08": "sample_age_s = 0.5\ntarget_age_s = 1.0\npolicy_deadline_s = 0.5",
    }.items():
        assert old in text, old
        text = text.replace(old, new)
    file.write_text(text)
    return file.parent


@contextmanager
def serving(installed: Path, cell: Path) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen([installed, "serve"], cwd=cell, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.terminate()
        process.communicate()


def test_neither_the_command_nor_its_packages_come_from_the_checkout(installed: Path, tmp_path: Path) -> None:
    packages = ("api", "benchmarks", "cli", "service", "sim_backend", "training", "wire")
    program = f"import importlib\nfor name in {packages}: print(importlib.import_module(name).__file__)"
    python = installed.with_name("python")
    found = subprocess.run([python, "-c", program], cwd=tmp_path, env=ENVIRONMENT, capture_output=True, text=True)
    assert found.returncode == 0, found.stderr
    files = [Path(line) for line in found.stdout.splitlines()]
    assert len(files) == len(packages)
    assert all(file.is_relative_to(installed.parents[1]) for file in files), files


def test_what_is_read_beside_the_code_is_in_the_wheel(installed: Path) -> None:
    here = Path(sysconfig.get_path("purelib", vars={"base": str(installed.parents[1])}))
    kinds = {".css", ".html", ".js", ".lark", ".onnx", ".svg", ".toml", ".urscript"}
    for package in ("api", "service", "sim_backend", "training", "wire"):
        for file in (ROOT / package).rglob("*"):
            assert file.suffix not in kinds or (here / file.relative_to(ROOT)).is_file(), file
    for folder in ("config", "models"):
        for file in (ROOT / folder).iterdir():
            assert (here / "cli/shipped" / folder / file.name).read_bytes() == file.read_bytes()


def test_the_help_and_every_command_s_are_there(installed: Path, tmp_path: Path) -> None:
    assert "serve" in run(installed, "--help", cwd=tmp_path).stdout
    for command in ("serve", "control", "sim", "train", "evaluate", "bench"):
        done = run(installed, command, "--help", cwd=tmp_path)
        assert done.returncode == 0, done.stderr


@pytest.mark.timeout(300)
def test_a_new_cell_is_served_inserts_stops_and_is_reset(installed: Path, cell: Path) -> None:
    port = tomllib.loads((cell / "cell.toml").read_text())["api"]["port"]
    url = ("--url", f"http://127.0.0.1:{port}")
    assert run(installed, "config", "check", cwd=cell).returncode == 0
    assert run(installed, "config", "new", ".", cwd=cell).returncode == 2
    with serving(installed, cell) as process:
        deadline = time.monotonic() + 60
        while "READY" not in run(installed, "status", *url, cwd=cell).stdout:
            assert process.poll() is None
            assert time.monotonic() < deadline
        inserted = run(installed, "start", "--seed", "3", "--wait", *url, cwd=cell)
        assert inserted.returncode == 0, inserted.stdout + inserted.stderr
        assert "the peg is in" in inserted.stdout
        assert run(installed, "start", *url, cwd=cell).returncode == 0
        stopped = run(installed, "stop", *url, cwd=cell)
        assert stopped.returncode == 0, stopped.stderr
        refused = run(installed, "start", *url, cwd=cell)
        assert refused.returncode == 5
        assert "OPERATOR_STOP" in refused.stderr
        assert run(installed, "reset", "--operator", "test", *url, cwd=cell).returncode == 0
        assert "SUCCEEDED" in run(installed, "runs", *url, cwd=cell).stdout
        process.terminate()
        assert process.wait(30) == 0
    assert run(installed, "status", *url, cwd=cell).returncode == 4
    assert run(installed, "stop", *url, cwd=cell).returncode == 4


@pytest.mark.timeout(300)
def test_the_demonstration_inserts_a_peg_there(installed: Path, cell: Path) -> None:
    done = run(installed, "demo", "--once", cwd=cell)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "the peg is in" in done.stdout
    assert (cell / "state" / "logs" / "simulator.log").is_file()
