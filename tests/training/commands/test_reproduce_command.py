"""`dsl-assembly reproduce`, in this process: what the report says is measured again, and what differs is told."""

from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

pytest.importorskip("torch", reason="needs the extra `training`: pip install -e '.[training]'")

from cli.__main__ import app
from training.evaluation.evaluate import FIRST_TEST_SEED
from training.evaluation.results import Block, EpisodeResult, Results
from training.report.curves import Curve

CURVE = Curve(
    experiment="kept",
    seed=0,
    mode="VFTM",
    start_from=None,
    reward="paper",
    machine="one",
    commit=None,
    steps=1,
    elapsed_s=1.0,
    evaluations=(),
    rollouts=(),
)
ARGUMENTS = ("--episodes", "1", "--workers", "1")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, model_path: Path) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "models").mkdir()
    for name in ("paper-vftm-c133", "somebody-elses"):
        (tmp_path / "models" / f"{name}.onnx").write_bytes(model_path.read_bytes())
    return tmp_path


def earlier(here: Path, successes: int) -> None:
    """Put 500 episodes in the place of what `reproduce` is to compare with."""
    found = Results.load(here / "var/reproduced/paper-vftm-c133.json")
    (block,) = found.blocks
    episodes = tuple(EpisodeResult(FIRST_TEST_SEED + i, i < successes, False, 9, 9.0) for i in range(500))
    found.with_block(Block(setting=block.setting, episodes=episodes)).save(here / "results/paper-vftm-c133.json")


def test_what_the_report_says_is_measured_again_and_reported(here: Path) -> None:
    first = CliRunner().invoke(app, ["reproduce", *ARGUMENTS])
    assert first.exit_code == 0, first.output
    assert "new " in first.output
    assert "c = 1.33 mm" in (here / "var/reproduced/results.md").read_text()
    assert not (here / "var/reproduced/somebody-elses.json").exists()
    (block,) = Results.load(here / "var/reproduced/paper-vftm-c133.json").blocks
    (episode,) = block.episodes
    earlier(here, 500 * episode.success)
    again = CliRunner().invoke(app, ["reproduce", *ARGUMENTS])
    assert again.exit_code == 0, again.output
    assert "as before" in again.output


def test_the_report_has_the_curves_that_are_kept_beside_the_earlier_results(here: Path) -> None:
    for folder, experiment in (("results", "kept"), ("var/reproduced", "of-nobody")):
        (here / folder / "curves").mkdir(parents=True)
        curve = CURVE.model_copy(update={"experiment": experiment})
        (here / folder / "curves" / "c.json").write_text(curve.model_dump_json())
    result = CliRunner().invoke(app, ["reproduce", *ARGUMENTS])
    assert result.exit_code == 0, result.output
    text = (here / "var/reproduced/results.md").read_text()
    assert "`kept`" in text
    assert "of-nobody" not in text


def test_a_rate_outside_the_earlier_interval_is_told_and_fails(here: Path) -> None:
    CliRunner().invoke(app, ["reproduce", *ARGUMENTS])
    (episode,) = Results.load(here / "var/reproduced/paper-vftm-c133.json").blocks[0].episodes
    earlier(here, 500 * (not episode.success))
    result = CliRunner().invoke(app, ["reproduce", *ARGUMENTS])
    assert result.exit_code == 1
    assert "DIFFERENT" in result.output


def test_it_is_compared_with_the_earlier_figures_of_the_same_seeds(here: Path) -> None:
    CliRunner().invoke(app, ["reproduce", *ARGUMENTS])
    (episode,) = Results.load(here / "var/reproduced/paper-vftm-c133.json").blocks[0].episodes
    earlier(here, 500 if episode.success else 0)
    path = here / "results/paper-vftm-c133.json"
    found = Results.load(path)
    (block,) = found.blocks
    others = tuple(replace(e, success=not e.success) for e in block.episodes[1:])
    found.with_block(block.with_episodes(others)).save(path)
    result = CliRunner().invoke(app, ["reproduce", *ARGUMENTS])
    assert result.exit_code == 0, result.output
    assert f"before {100.0 * episode.success:.1f}%" in result.output


def test_earlier_results_of_another_file_are_told_and_fail(here: Path) -> None:
    CliRunner().invoke(app, ["reproduce", *ARGUMENTS])
    (episode,) = Results.load(here / "var/reproduced/paper-vftm-c133.json").blocks[0].episodes
    earlier(here, 500 * episode.success)
    path = here / "results/paper-vftm-c133.json"
    Results.load(path).model_copy(update={"sha256": "0" * 64, "sources": "1" * 64}).save(path)
    result = CliRunner().invoke(app, ["reproduce", *ARGUMENTS])
    assert result.exit_code == 1
    assert "of another file" in result.output
    assert "have changed since" in result.output


def test_a_report_is_refused_where_results_are_not_of_the_file_that_ships(here: Path) -> None:
    CliRunner().invoke(app, ["reproduce", *ARGUMENTS])
    arguments = ["report", "--results", "var/reproduced", "--out", "docs"]
    told = CliRunner().invoke(app, arguments)
    assert told.exit_code == 0, told.output
    path = here / "var/reproduced/paper-vftm-c133.json"
    Results.load(path).model_copy(update={"sha256": "0" * 64}).save(path)
    refused = CliRunner().invoke(app, arguments)
    assert refused.exit_code == 2
    assert "not of models/paper-vftm-c133.onnx" in refused.output
