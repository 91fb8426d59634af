"""`python -m training`, in this process: what it writes and what it refuses."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

pytest.importorskip("torch", reason="needs the extra `training`: pip install -e '.[training]'")

from service.policy.model import Policy
from training.__main__ import app

TINY = [
    "--steps",
    "16",
    "--cells",
    "2",
    "--rollout",
    "8",
    "--batch",
    "16",
    "--epochs",
    "1",
    "--hidden",
    "16",
    "--threads",
    "1",
]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*arguments: str) -> str:
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    return result.output


def test_a_training_leaves_model_log_recipe_and_contract_and_its_model_becomes_a_policy_of_a_cell(here: Path) -> None:
    run("train", "first", *TINY, "--lock", "peck", "--clearance", "1.0", "2.0")
    directory = here / "var" / "training" / "first"
    assert {path.name for path in directory.iterdir()} == {"final.zip", "recipe.json", "contract.json"}
    recipe = json.loads((directory / "recipe.json").read_text())
    assert recipe["recipe"]["steps"] == 16
    assert recipe["tasks"]["clearance_m"] == [1e-3, 2e-3]
    run("export", str(directory / "final.zip"), "first.onnx")
    contract = Policy.load(here / "first.onnx").contract
    assert (contract.name, contract.dsl.mode) == ("first", "peck")
    assert contract.provenance["steps"] == 16
    assert contract.provenance["recipe"] == recipe["recipe"]
    run("train", "second", *TINY, "--lock", "peck", "--from", str(directory / "final.zip"))
    assert json.loads((here / "var/training/second/recipe.json").read_text())["continues"] == str(
        directory / "final.zip"
    )


def test_an_evaluation_prints_a_row_per_clearance_and_records_it_only_when_told(model_path: Path, here: Path) -> None:
    path = here / "model.onnx"
    path.write_bytes(model_path.read_bytes())
    said = run("evaluate", str(path), "--clearance", "3", "--clearance", "2", "--episodes", "2", "--conditions", "easy")
    rows = [line for line in said.splitlines() if line.startswith("| 3.00 |") or line.startswith("| 2.00 |")]
    assert len(rows) == 2
    assert path.read_bytes() == model_path.read_bytes()
    run("evaluate", str(path), "--clearance", "3", "--episodes", "2", "--conditions", "easy", "--record")
    (figure,) = Policy.load(path).contract.evaluation
    assert (figure.clearance_m, figure.conditions, figure.episodes) == (3e-3, "easy", 2)


def test_cells_that_do_not_divide_over_the_workers_are_rounded_down_and_it_says_so(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    said = run("train", "odd", *TINY, "--cells", "5", "--workers", "2")
    assert "5 cells do not divide evenly over 2 workers: training with 4" in said
    assert json.loads((here / "var/training/odd/recipe.json").read_text())["recipe"]["cells"] == 4


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["evaluate", "missing.onnx"], "cannot read missing.onnx"),
        (["train", "x", "--cells", "2", "--workers", "3"], "2 cells are too few for 3 workers"),
        (["train", "x", "--lock", "bolt"], "--lock must be one of"),
        (["train", "x", "--mode", "VM", "--lock", "paper"], "VM bypasses the lock"),
        (["train", "x", "--clearance", "0", "2"], "clearance_m must lie in"),
    ],
)
def test_what_cannot_be_done_is_refused_with_a_reason_and_leaves_nothing(
    arguments: list[str], text: str, here: Path
) -> None:
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert text in result.output
    assert not list(here.iterdir())


def test_a_finished_run_is_never_overwritten(here: Path) -> None:
    done = here / "var" / "training" / "done" / "final.zip"
    done.parent.mkdir(parents=True)
    done.write_bytes(b"precious")
    result = CliRunner().invoke(app, ["train", "done"])
    assert result.exit_code == 2
    assert "choose another name" in result.output
    assert done.read_bytes() == b"precious"
