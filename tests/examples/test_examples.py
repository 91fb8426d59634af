"""The examples run as a reader runs them: programs of their own, from the checkout."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from service.policy.model import Policy

ROOT = Path(__file__).parents[2]


def program(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=ROOT,
        env=os.environ | {"PYTHONWARNINGS": "error", "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=280,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done


def test_the_driver_of_ones_own_inserts_finds_no_hole_and_stops_at_the_ceiling() -> None:
    cases = program("examples/own_driver/insert.py").stdout.split("\n\n")
    inserted, searched, stopped = (case.splitlines() for case in cases if case.strip())
    assert inserted[1].split(" → ")[2:] == ["PREFLIGHT", "APPROACH", "RUNNING", "RETRACT", "READY"]
    assert "contact at step" in inserted[2]
    assert "SUCCEEDED" in inserted[3]
    assert "contact at step" in searched[2]
    assert "SEARCH_LIMIT" in searched[3]
    assert stopped[1].endswith("STOPPING → LATCHED")
    assert "FORCE_CEILING" in stopped[-1]


@pytest.mark.timeout(300)
def test_the_policy_of_ones_own_passes_its_tests() -> None:
    assert "2 passed" in program("-m", "pytest", "-q", "examples/own_policy.py").stdout


def test_the_policy_of_ones_own_is_a_file_that_a_cell_loads(tmp_path: Path) -> None:
    program("examples/own_policy.py", tmp_path / "mine.onnx")
    assert Policy.load(tmp_path / "mine.onnx").contract.name == "towards the hole"


@pytest.mark.timeout(300)
def test_the_whole_way_from_training_to_a_cell() -> None:
    pytest.importorskip("torch")
    told = program("examples/train_export_deploy.py", "--steps", "500").stdout.splitlines()
    assert [line.split()[0] for line in told if line.split()[0] != "example"] == [
        "train",
        "export",
        "check",
        "deploy",
        "deploy",
    ]
    assert any("POLICY_REFUSED" in line and "0.1 mm" in line for line in told)


def test_every_example_is_in_the_list_and_is_taken_in_at_one_look() -> None:
    files = sorted((ROOT / "examples").rglob("*.py"))
    listed = (ROOT / "examples/README.md").read_text()
    commands = [str(path.relative_to(ROOT)) for path in files if "__main__" in path.read_text()]
    assert not [command for command in commands if f"python {command}" not in listed]
    lengths = {path.name: len(path.read_text().splitlines()) for path in files}
    assert not {name: length for name, length in lengths.items() if length > 120}
