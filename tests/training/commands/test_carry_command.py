"""`dsl-assembly carry`, on a repository of its own: what it carries over, and what it refuses."""

import re
import shutil
import signal
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

pytest.importorskip("onnx", reason="needs the extra `training`: pip install -e '.[training]'")

from cli.__main__ import app
from service.policy.model import Policy
from training.evaluation import evaluate as evaluation
from training.evaluation import provenance, through_service
from training.evaluation.baseline import scripted_search
from training.evaluation.results import Block, MeasuringSession, Results, Setting, Through

SENSOR = "sim_backend/world/sensor.py"
pytestmark = pytest.mark.timeout(300)


def git(repository: Path, *arguments: str) -> str:
    identity = ["-c", "user.name=nobody", "-c", "user.email=nobody@localhost"]
    done = subprocess.run(["git", *identity, *arguments], cwd=repository, check=True, capture_output=True, text=True)  # noqa: S607
    return done.stdout


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository with this project's code as its only commit, and a policy; the working folder."""
    root = tmp_path / "repository"
    for package in provenance.CODE:
        shutil.copytree(provenance.ROOT / package, root / package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(provenance.ROOT / ".gitignore", root)
    git(tmp_path, "init", str(root))
    git(root, "add", ".")
    git(root, "commit", "-m", "before")
    (root / "models").mkdir()
    (root / "models/search.onnx").write_bytes(scripted_search(max_steps=12))
    monkeypatch.setattr(provenance, "ROOT", root)
    monkeypatch.chdir(root)
    return root


@pytest.fixture(autouse=True)
def _signals() -> Iterator[None]:
    kept = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, kept)


def measured(repository: Path, *, through: Through = "environment", **changes: Any) -> Path:
    """Two episodes of the policy, as `evaluate` keeps them."""
    model = repository / "models/search.onnx"
    policy = Policy.load(model)
    contract = policy.contract
    setting = Setting(
        part="tr", clearance_m=3e-3, conditions="easy", lock="sliding", through=through, first_seed=2_000_000
    )
    jobs = evaluation.jobs_of(model, policy.sha256, Block(setting=setting), 2)
    if through == "environment":
        played = [episode for _, episodes in evaluation.measure(jobs, 1) for episode in episodes]
    else:
        played = [episode for _, episode in through_service.measure(jobs, 1)]
    results = Results(
        policy=contract.name,
        sha256=policy.sha256,
        sources=provenance.sources.__wrapped__(),
        deployed_sources=None if through == "environment" else provenance.deployed_sources(),
        mode=contract.mode,
        lock=contract.dsl.mode,
        period_s=contract.period_s,
        max_steps=contract.max_steps,
        stiffness=contract.compliance.stiffness,
        press_m=contract.dsl.press_m,
        seek_step_m=contract.dsl.seek_step_m,
        provenance={},
        blocks=(Block(setting=setting, episodes=tuple(played)),),
    )
    path = repository / "results/search.json"
    results.model_copy(update=changes).save(path)
    return path


def change(repository: Path, name: str, old: str, new: str) -> None:
    """Replace `old`, a regular expression, in a file of the repository, and commit that."""
    file = repository / name
    text, count = re.subn(old, new, file.read_text())
    assert count
    file.write_text(text)
    git(repository, "commit", "-am", "after")


def carry(code: int, *arguments: str) -> str:
    result = CliRunner().invoke(app, ["carry", "HEAD~1", "--results", "results", *arguments])
    assert result.exit_code == code, result.output
    return result.output


def refused(path: Path, *arguments: str) -> str:
    before = path.read_bytes()
    said = carry(1, *arguments)
    assert path.read_bytes() == before
    assert "nothing is changed" in said
    return said


def rename_a_variable(repository: Path) -> None:
    change(repository, SENSOR, r"\b_slot\b", "_place")


def test_results_are_carried_over_a_renamed_variable(repository: Path) -> None:
    path = measured(repository)
    before = Results.load(path)
    rename_a_variable(repository)
    said = carry(0, "--episodes", "2")
    after = Results.load(path)
    assert after.sources == provenance.sources.__wrapped__() != before.sources
    assert after.model_copy(update={"sources": before.sources, "carried": ()}) == before
    (carried,) = after.carried
    assert (carried.from_sources, carried.to_sources) == (before.sources, after.sources)
    assert carried.from_commit == git(repository, "rev-parse", "HEAD~1").strip()
    assert carried.to_commit == git(repository, "rev-parse", "HEAD").strip()
    (replay,) = carried.replays
    assert (replay.policy, replay.blocks, replay.episodes, replay.agreed) == ("search", 1, 2, 2)
    assert replay.as_on_file == 2
    assert "environment: 2 of 2 episodes of 1 blocks agree" in said
    assert git(repository, "worktree", "list").count("\n") == 1


def test_a_changed_number_is_refused_with_seed_and_step(repository: Path) -> None:
    path = measured(repository)
    change(repository, SENSOR, r"ZERO_TICKS = 100\b", "ZERO_TICKS = 101")
    said = refused(path)
    assert "seed 2000000: the trees differ: step " in said
    assert "observation" in said
    assert git(repository, "worktree", "list").count("\n") == 1


def test_results_that_are_not_of_the_revision_are_refused(repository: Path) -> None:
    path = measured(repository, sources="0" * 64)
    rename_a_variable(repository)
    assert "is not of the sources of" in refused(path)


@pytest.mark.parametrize("machine", ["this one", "another one"])
def test_episodes_that_differ_from_the_file_are_refused_only_on_the_machine_that_measured_them(
    repository: Path, machine: str
) -> None:
    path = measured(repository)
    results = Results.load(path)
    (block,) = results.blocks
    first, *others = block.episodes
    session = MeasuringSession(
        ended="2026-01-01",
        commit=None,
        machine=provenance.machine() if machine == "this one" else machine,
        versions=provenance.versions(),
        workers=1,
        episodes=2,
        wall_s=1.0,
    )
    wrong = (replace(first, steps=first.steps + 1), *others)
    results.with_block(block.model_copy(update={"episodes": wrong, "sessions": (session,)})).save(path)
    rename_a_variable(repository)
    if machine == "this one":
        said = refused(path, "--episodes", "2")
        assert f"not with the file: steps {first.steps} and {first.steps + 1}" in said
    else:
        carry(0, "--episodes", "2")
        (replay,) = Results.load(path).carried[0].replays
        assert (replay.agreed, replay.as_on_file) == (2, 1)


def test_another_policy_stands_in_for_one_that_is_not_at_hand(repository: Path) -> None:
    path = measured(repository, sha256="0" * 64, stiffness=(2000.0, 2000.0, 2500.0, 4.0, 4.0, 7.0), max_steps=7)
    rename_a_variable(repository)
    carry(0, "--episodes", "1")
    (replay,) = Results.load(path).carried[0].replays
    assert (replay.policy, replay.episodes, replay.agreed, replay.as_on_file) == ("search", 1, 1, None)
    (repository / "models/search.onnx").unlink()
    change(repository, SENSOR, r"\b_place\b", "_row")
    assert "no policy at hand observes VFTM" in refused(path)


def test_a_revision_that_cannot_be_checked_out_is_named(repository: Path) -> None:
    assert "worktree add" in refused(measured(repository))  # there is no HEAD~1


def test_episodes_through_the_service_are_played_again_in_lockstep(repository: Path) -> None:
    path = measured(repository, through="zenoh")
    before = Results.load(path)
    rename_a_variable(repository)
    said = carry(0, "--service-episodes", "1")
    after = Results.load(path)
    assert after.deployed_sources == provenance.deployed_sources() != before.deployed_sources
    (replay,) = after.carried[0].replays
    assert (replay.through, replay.compared, replay.agreed) == ("zenoh", "result, exactly", 1)
    assert "zenoh: 1 of 1 episodes" in said


def test_without_the_service_its_episodes_keep_their_sources(repository: Path) -> None:
    path = measured(repository, through="zenoh")
    before = Results.load(path)
    rename_a_variable(repository)
    carry(0, "--environment-only")
    after = Results.load(path)
    assert after.deployed_sources == before.deployed_sources
    assert after.sources != before.sources
    assert after.carried[0].to_deployed_sources is None
