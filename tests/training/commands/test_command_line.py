"""`dsl-assembly train` and `export`, in this process: what they write and what they refuse."""

import os
import signal
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

torch = pytest.importorskip("torch", reason="needs the extra `training`: pip install -e '.[training]'")

from cli.__main__ import app  # noqa: E402
from service.policy.model import Policy  # noqa: E402
from training.learning.experiment import load  # noqa: E402
from training.learning.network import ActorCritic  # noqa: E402

SMALL = """
title = "Small"
seeds = [4, 5]
[task]
lock = "sliding"
clearance_mm = [1.0, 2.0]
max_steps = 5
[algorithm]
width = 8
hidden = 8
steps = 16
cells = 2
workers = 1
rollout = 8
epochs = 1
minibatches = 1
[evaluation]
every_steps = 16
episodes = 2
clearances_mm = [2.0]
"""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.toml").write_text(SMALL)
    return tmp_path


@pytest.fixture(autouse=True)
def _signals() -> Any:
    kept = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, kept)


def run(*arguments: str) -> str:
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    return result.output


def test_an_experiment_is_trained_for_each_of_its_seeds_and_becomes_a_policy_of_a_cell(here: Path) -> None:
    said = run("train", "small.toml")
    assert said.count("finished in var/training/small/seed-") == 2
    run("export", "small", "small.onnx", "--seed", "5")
    contract = Policy.load(here / "small.onnx").contract
    assert (contract.name, contract.dsl.mode, contract.hidden_size) == ("small", "sliding", 8)
    account: Any = contract.provenance
    assert account["seed"] == 5
    assert account["experiment"]["task"]["clearance_mm"] == [1.0, 2.0]
    assert account["steps"] in (0, 16)
    assert account["validation"][0]["episodes"] == 2
    assert account["sessions"][0]["versions"]["torch"]
    run("export", "small", "last.onnx", "--seed", "5", "--last", "--name", "the-last")
    last = Policy.load(here / "last.onnx").contract
    assert (last.name, last.provenance["steps"]) == ("the-last", 16)


def test_one_seed_alone_may_be_trained_and_the_same_command_goes_on(here: Path) -> None:
    assert "0 of 16 steps" in run("train", "small.toml", "--seed", "7", "--minutes", "1e-9")
    assert "finished" in run("train", "small.toml", "--seed", "7")
    assert [path.name for path in (here / "var/training/small").iterdir()] == ["seed-7"]


def test_the_time_is_that_of_all_seeds_together(here: Path) -> None:
    said = run("train", "small.toml", "--minutes", "1e-9")
    assert said.count("0 of 16 steps") == 1
    assert "goes on with seed 5" in said
    assert [path.name for path in (here / "var/training/small").iterdir()] == ["seed-4"]


def test_a_request_to_end_ends_the_training_and_says_how_to_go_on(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def ask_to_end(*_: Any) -> None:
        os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr("training.learning.ppo.update", ask_to_end)
    result = CliRunner().invoke(app, ["train", "small.toml"])
    assert result.exit_code == 130
    assert "the same command goes on" in result.output
    monkeypatch.undo()
    monkeypatch.chdir(here)
    assert "finished" in run("train", "small.toml")


def test_weights_without_a_contract_become_a_policy_of_the_experiment_that_is_named(here: Path) -> None:
    contract = load("small.toml").contract()
    torch.save({"net": ActorCritic(contract, 8, 8, 0.0).state_dict(), "steps": 123}, here / "bare.pt")
    result = CliRunner().invoke(app, ["export", "bare.pt", "bare.onnx"])
    assert result.exit_code == 2
    assert "name its --experiment" in result.output
    run("export", "bare.pt", "bare.onnx", "--experiment", "small.toml")
    assert Policy.load(here / "bare.onnx").contract.provenance == {"steps": 123}


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["train", "unheard-of"], "there is no experiment 'unheard-of'"),
        (["train", "small.toml", "--start-from", "missing.pt"], "cannot begin with missing.pt"),
        (["export", "small", "out.onnx"], "there is no var/training/small/seed-0/best.pt"),
        (["export", "small.toml", "out.onnx"], "there is no"),
    ],
)
def test_what_cannot_be_done_is_refused_with_a_reason_and_leaves_nothing(
    arguments: list[str], text: str, here: Path
) -> None:
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert text in result.output.replace("\n", " ")
    assert [path.name for path in here.iterdir()] == ["small.toml"]
