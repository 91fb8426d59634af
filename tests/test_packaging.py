"""The package says one version, one licence, and that it is typed; the changelog and the hooks keep up with it."""

import re
import shlex
import shutil
import subprocess
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest

from api.application import build_routes
from api.version import UNINSTALLED, installed_version

ROOT = Path(__file__).resolve().parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT = PYPROJECT["project"]
SHIPPED = [pattern.removesuffix("*") for pattern in PYPROJECT["tool"]["setuptools"]["packages"]["find"]["include"]]
HOOKS = (ROOT / ".pre-commit-config.yaml").read_text()


def git(*arguments: str) -> str:
    tool = shutil.which("git")
    if tool is None:
        pytest.skip("git is not installed")
    return subprocess.run([tool, *arguments], cwd=ROOT, capture_output=True, text=True).stdout


def headings_of_the_changelog() -> list[str]:
    return re.findall(r"^## (.+)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)


def test_the_installed_package_and_the_api_say_the_version_of_the_project() -> None:
    assert version("dsl-assembly") == PROJECT["version"], "run `make setup-dev` after a change of the version"
    assert build_routes().version == PROJECT["version"]


def test_a_checkout_that_was_never_installed_still_has_a_version() -> None:
    assert installed_version("a-distribution-that-nobody-installed") == UNINSTALLED


def test_the_changelog_has_a_dated_section_for_the_version_below_the_unreleased_one() -> None:
    unreleased, latest, *_ = headings_of_the_changelog()
    assert unreleased == "[Unreleased]"
    assert re.fullmatch(rf"\[{re.escape(PROJECT['version'])}\] - \d{{4}}-\d\d-\d\d", latest)


def test_a_tag_on_this_commit_is_the_version() -> None:
    assert set(git("tag", "--points-at", "HEAD", "--list", "v*").split()) <= {f"v{PROJECT['version']}"}


def test_the_licence_is_the_one_that_the_package_names() -> None:
    assert (PROJECT["license"], PROJECT["license-files"]) == ("Apache-2.0", ["LICENSE"])
    text = (ROOT / "LICENSE").read_text()
    assert text.split()[:4] == ["Apache", "License", "Version", "2.0,"]
    assert "END OF TERMS AND CONDITIONS" in text


@pytest.mark.parametrize("package", SHIPPED)
def test_every_shipped_package_is_marked_as_typed(package: str) -> None:
    assert (ROOT / package / "py.typed").is_file()
    assert "py.typed" in PYPROJECT["tool"]["setuptools"]["package-data"]["*"]


def test_coverage_is_reported_for_every_shipped_package() -> None:
    named = re.search(r"^PACKAGES := (.+)$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert named is not None
    assert sorted(named[1].split()) == sorted(SHIPPED)


def test_the_pins_have_no_address_and_no_suffix_of_a_build() -> None:
    pins = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#")]
    assert not [pin for pin in pins if not re.fullmatch(r"[A-Za-z0-9._-]+==[A-Za-z0-9.]+", pin)]


def test_no_hook_is_downloaded() -> None:
    assert set(re.findall(r"repo: *(\S+)", HOOKS)) == {"local"}
    assert set(re.findall(r"language: *(\S+)", HOOKS)) == {"system"}
    assert len(re.findall(r"language:", HOOKS)) == len(re.findall(r"- id:", HOOKS))


def judged_by_size(*files: Path) -> subprocess.CompletedProcess[str]:
    entry = re.search(r"id: file-size\n.*\n +entry: (.+)", HOOKS)
    assert entry is not None
    return subprocess.run([*shlex.split(entry[1]), *map(str, files)], cwd=ROOT, capture_output=True, text=True)


def test_the_hook_refuses_a_large_file_and_names_it(tmp_path: Path) -> None:
    small, large = tmp_path / "small.bin", tmp_path / "large.bin"
    small.write_bytes(bytes(2 << 20))
    large.write_bytes(bytes((2 << 20) + 1))
    assert judged_by_size(small).returncode == 0
    refused = judged_by_size(small, large)
    assert refused.returncode == 1
    assert str(large) in refused.stdout
    assert str(small) not in refused.stdout


def test_no_committed_file_is_large() -> None:
    files = [ROOT / name for name in git("ls-files", "-z").split("\0") if name and (ROOT / name).is_file()]
    if not files:
        pytest.skip("not a git checkout")
    assert not judged_by_size(*files).stdout
