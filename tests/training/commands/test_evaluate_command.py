"""`dsl-assembly evaluate`, in this process: what it keeps, what it plays again, what it refuses."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

pytest.importorskip("torch", reason="needs the extra `training`: pip install -e '.[training]'")

from cli.__main__ import app
from service.policy.model import Policy
from training.evaluation import evaluate as evaluation
from training.evaluation import panel, provenance, through_service
from training.evaluation.baseline import scripted_search
from training.evaluation.results import EpisodeResult, Results, exclusive
from training.learning.export import export

EASY = ["--clearance", "3", "--conditions", "easy", "--workers", "1"]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, model_path: Path) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "model.onnx").write_bytes(model_path.read_bytes())
    return tmp_path


@pytest.fixture
def played(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Seeds that are really played."""
    seeds: list[int] = []
    run = evaluation.play

    def watched(actor: object, insertions: object, tasks: list[object], **rest: object) -> object:
        seeds.extend(task.seed - evaluation.FIRST_TEST_SEED for task in tasks)  # type: ignore[attr-defined]
        return run(actor, insertions, tasks, **rest)  # type: ignore[arg-type]

    monkeypatch.setattr(evaluation, "play", watched)
    return seeds


def run(*arguments: str) -> str:
    result = CliRunner().invoke(app, ["evaluate", *arguments])
    assert result.exit_code == 0, result.output
    return result.output


def refused(*arguments: str) -> str:
    result = CliRunner().invoke(app, ["evaluate", *arguments])
    assert result.exit_code == 2
    return result.output


def test_what_was_played_is_kept_and_only_what_is_missing_is_played_again(here: Path, played: list[int]) -> None:
    run("model.onnx", *EASY, "--episodes", "2")
    first = Results.load(here / "results" / "model.json")
    assert played == [0, 1]
    said = run("model.onnx", *EASY, "--episodes", "3")
    assert played == [0, 1, 2]
    (block,) = Results.load(here / "results" / "model.json").blocks
    assert block.episodes[:2] == first.blocks[0].episodes
    assert [session.episodes for session in block.sessions] == [2, 1]
    assert all(session.wall_s > 0 for session in block.sessions)
    assert "/3 = " in said
    assert "/2 = " in run("model.onnx", *EASY, "--episodes", "2")
    assert played == [0, 1, 2]


def test_a_measurement_that_is_cut_off_keeps_the_episodes_that_had_ended(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(evaluation, "CELLS", 1)
    run_on, ended = evaluation.play, 0

    def cut_off(*arguments: object, **rest: object) -> object:
        nonlocal ended
        if ended == 2:
            raise KeyboardInterrupt
        ended += 1
        return run_on(*arguments, **rest)  # type: ignore[arg-type]

    monkeypatch.setattr(evaluation, "play", cut_off)
    CliRunner().invoke(app, ["evaluate", "model.onnx", *EASY, "--episodes", "4"])
    (block,) = Results.load(here / "results" / "model.json").blocks
    assert len(block.episodes) == 2


def test_a_plan_is_measured_cell_by_cell(here: Path, played: list[int]) -> None:
    run("model.onnx", "--plan", "table-2", "--episodes", "1", "--workers", "1")
    blocks = Results.load(here / "results" / "model.json").blocks
    assert [block.setting.part for block in blocks] == [
        "tr",
        "tr",
        "rtr",
        "trm",
        "trm",
        "cir",
        "b-trm",
        "b-trm",
        "b-rtr",
    ]
    assert {block.setting.conditions for block in blocks} == {"transfer"}
    assert played == [0] * 9


def test_several_processes_measure_what_one_does(here: Path) -> None:
    run("model.onnx", *EASY, "--episodes", "2", "--name", "one")
    run("model.onnx", *EASY[:-1], "2", "--episodes", "2", "--name", "two")
    one, two = (Results.load(here / "results" / f"{name}.json").blocks[0] for name in ("one", "two"))
    assert [(e.seed, e.success, e.steps) for e in one.episodes] == [(e.seed, e.success, e.steps) for e in two.episodes]


def test_a_policy_is_measured_under_another_lock_apart_from_its_own(here: Path) -> None:
    run("model.onnx", *EASY, "--episodes", "1")
    run("model.onnx", *EASY, "--episodes", "1", "--lock", "off")
    results = Results.load(here / "results" / "model.json")
    assert results.lock == "paper"
    assert [block.setting.lock for block in results.blocks] == ["paper", "off"]


def test_results_of_another_file_are_not_added_to(here: Path, untrained: object) -> None:
    run("model.onnx", *EASY, "--episodes", "1")
    before = (here / "results" / "model.json").read_bytes()
    contract = Policy.load(here / "model.onnx").contract
    export(untrained, contract.model_copy(update={"name": "another"}), here / "model.onnx")  # type: ignore[arg-type]
    said = " ".join(refused("model.onnx", *EASY, "--episodes", "1").split())
    assert "results of another file" in said
    assert (here / "results" / "model.json").read_bytes() == before
    run("model.onnx", *EASY, "--episodes", "1", "--anew")
    assert Results.load(here / "results" / "model.json").policy == "another"


def test_results_of_another_world_are_not_added_to(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run("model.onnx", *EASY, "--episodes", "1")
    before = (here / "results" / "model.json").read_bytes()
    monkeypatch.setattr(provenance, "sources", lambda: "another")
    said = " ".join(refused("model.onnx", *EASY, "--episodes", "2").split())
    assert "results of an earlier world, arm, lock or criterion" in said
    assert "--anew" in said
    assert (here / "results" / "model.json").read_bytes() == before
    run("model.onnx", *EASY, "--episodes", "1", "--anew")
    assert Results.load(here / "results" / "model.json").sources == "another"


def test_results_through_another_service_are_not_added_to_and_go_alone(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run("model.onnx", *EASY, "--episodes", "1")
    file = here / "results" / "model.json"
    earlier = Results.load(file)
    assert earlier.deployed_sources is None
    setting = replace(earlier.blocks[0].setting, through="zenoh")
    deployed = earlier.blocks[0].model_copy(update={"setting": setting})
    earlier.with_block(deployed).model_copy(update={"deployed_sources": "another"}).save(file)
    before = file.read_bytes()
    zenoh = (*EASY, "--episodes", "1", "--through", "zenoh")
    assert "results through an earlier service" in " ".join(refused("model.onnx", *zenoh).split())
    assert file.read_bytes() == before
    run("model.onnx", *EASY, "--episodes", "2")  # the environment does not depend on it
    assert Results.load(file).deployed_sources == "another"

    def nobody(*_: object, **__: object) -> None:
        raise through_service.ServiceError("nobody plays")

    monkeypatch.setattr(through_service, "play", nobody)
    assert "nobody plays" in refused("model.onnx", *zenoh, "--anew")
    episode = EpisodeResult(seed=setting.first_seed, success=True, fault=False, steps=33, peak_force_n=9.0)

    def somebody(*_: object, on_episode: Callable[[object], object], **__: object) -> None:
        on_episode(SimpleNamespace(result=episode))

    monkeypatch.setattr(through_service, "play", somebody)
    run("model.onnx", *zenoh, "--anew")
    found = Results.load(file)
    assert found.deployed_sources == provenance.deployed_sources()
    assert len(found.block(earlier.blocks[0].setting).episodes) == 2
    assert found.block(setting).episodes == (episode,)
    known = file.read_bytes()
    digests = iter([provenance.deployed_sources(), "edited meanwhile"])
    monkeypatch.setattr(provenance, "deployed_sources", lambda: next(digests))
    assert "changed while it was measured" in refused("model.onnx", *EASY, "--episodes", "2", "--through", "zenoh")
    assert file.read_bytes() == known


def test_results_that_another_process_adds_to_are_refused(here: Path, played: list[int]) -> None:
    with exclusive(here / "results" / "model.json"):
        assert "another process is measuring" in " ".join(refused("model.onnx", *EASY, "--episodes", "1").split())
    assert played == []


def test_what_the_lock_does_beyond_its_mode_is_kept(here: Path) -> None:
    run("model.onnx", *EASY, "--episodes", "1")
    lock = Policy.load(here / "model.onnx").contract.dsl
    results = Results.load(here / "results" / "model.json")
    assert (results.press_m, results.seek_step_m) == (lock.press_m, lock.seek_step_m)


def test_a_policy_without_a_camera_is_measured_only_where_the_hole_is_within_its_search(here: Path) -> None:
    (here / "ftm.onnx").write_bytes(scripted_search("FTM"))
    for conditions in ("standard", "transfer"):
        said = " ".join(refused("ftm.onnx", "--conditions", conditions, "--episodes", "1").split())
        assert "too far from the nominal centre" in said


def test_recorded_figures_change_the_file_and_its_results_go_with_it(here: Path, played: list[int]) -> None:
    run("model.onnx", *EASY, "--episodes", "2", "--record")
    policy = Policy.load(here / "model.onnx")
    (figure,) = policy.contract.evaluation
    assert (figure.clearance_m, figure.conditions, figure.episodes) == (3e-3, "easy", 2)
    assert Results.load(here / "results" / "model.json").sha256 == policy.sha256
    run("model.onnx", *EASY, "--episodes", "2")
    assert played == [0, 1]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["missing.onnx"], "cannot read missing.onnx"),
        (["model.onnx", "--clearance", "9"], "clearance_m must lie in"),
        (["model.onnx", "--force-ceiling", "60"], "less than or equal to"),
        (["model.onnx", "--lock", "bolt"], "--lock must be one of"),
        (["model.onnx", "--lock", "off", "--through", "zenoh"], "under its own lock"),
        (["model.onnx", "--lock", "off", "--record"], "--record is for 'tr' under the policy's own lock"),
        (["model.onnx", "--plan", "table-2", "--record"], "--record is for 'tr'"),
    ],
)
def test_what_cannot_be_measured_is_refused_with_a_reason_and_leaves_nothing(
    here: Path, arguments: list[str], text: str
) -> None:
    assert text in " ".join(refused(*arguments).split())
    assert not (here / "results").exists()


def test_the_panel_is_measured_line_by_line_on_the_same_seeds(here: Path, played: list[int]) -> None:
    said = run("model.onnx", "--panel", "plant", "--clearance", "1.33", "--episodes", "1", "--workers", "1")
    lines = panel.load("plant").lines
    blocks = Results.load(here / "results" / "panels" / "plant" / "model.json").blocks
    assert {block.setting.line: block.setting.plant for block in blocks} == lines
    assert played == [0] * len(lines)
    peaks = {block.setting.line: block.episodes[0].peak_force_n for block in blocks}
    assert len(set(peaks.values())) > len(lines) // 2
    assert all(f"| {line} | " in said for line in lines)
    again = run("model.onnx", "--panel", "plant", "--clearance", "1.33", "--episodes", "1", "--workers", "1")
    assert again.splitlines()[-1] == said.splitlines()[-1] == "kept in results/panels/plant/model.json"
    assert len(played) == len(lines)


@pytest.mark.parametrize("other", [["--plan", "table-1"], ["--record"]])
def test_a_panel_goes_alone(here: Path, other: list[str]) -> None:
    assert "--panel goes with neither" in refused("model.onnx", "--panel", "plant", *other)


def test_a_panel_that_there_is_not_is_refused(here: Path) -> None:
    assert "there is no panel plants" in refused("model.onnx", "--panel", "plants")
