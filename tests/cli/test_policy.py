import json
from pathlib import Path

import pytest

from cli import shipped
from tests.cli.serving import run

CELL = str(shipped.EXAMPLES / "cell.toml")
UR3E = str(shipped.EXAMPLES / "ur3e.toml")
VFTM = str(shipped.MODELS / "vftm-dsl.onnx")


@pytest.mark.parametrize("file", sorted(shipped.MODELS.glob("*.onnx")), ids=lambda path: path.stem)
def test_every_shipped_policy_can_be_inspected(file: Path) -> None:
    done = run("policy", "inspect", str(file))
    assert done.exit_code == 0, done.output
    assert file.stem in done.stdout
    assert json.loads(run("policy", "inspect", str(file), "--json").stdout)["schema_version"] == 1


def test_a_policy_that_fits_a_recipe_is_said_to() -> None:
    done = run("policy", "check", VFTM, "--recipe", "triangle-2mm", "--config", CELL)
    assert done.exit_code == 0, done.output
    assert "fits" in done.stdout


def test_every_reason_against_a_policy_is_said(tmp_path: Path) -> None:
    config = tmp_path / "cell.toml"
    text = (
        Path(UR3E)
        .read_text()
        .replace('part = "tr"', 'part = "square"')
        .replace("max_speed", "max_press_m = 1e-4\nmax_speed")
    )
    config.write_text(text)
    done = run("policy", "check", VFTM, "--recipe", "triangle-2mm", "--config", str(config))
    assert done.exit_code == 1
    for reason in ("square", "camera", "press_m"):
        assert reason in done.stderr


@pytest.mark.parametrize(
    ("file", "recipe", "status", "word"),
    [
        (CELL, "triangle-2mm", 1, "not an ONNX model"),
        ("missing.onnx", "triangle-2mm", 1, "missing.onnx"),
        (VFTM, "cube", 2, "triangle-2mm"),
    ],
)
def test_what_cannot_be_checked_is_one_line(file: str, recipe: str, status: int, word: str) -> None:
    done = run("policy", "check", file, "--recipe", recipe, "--config", CELL)
    assert done.exit_code == status
    assert word in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_a_file_that_is_no_policy_is_not_inspected() -> None:
    assert run("policy", "inspect", CELL).exit_code == 2
