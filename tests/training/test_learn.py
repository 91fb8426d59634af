"""Training that really learns, in little time: without a lock the policy itself must find out to go down."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the extra `training`: pip install -e '.[training]'")

from stable_baselines3 import PPO

from training import design
from training.episodes import TaskSource
from training.evaluate import evaluate
from training.export import export
from training.learn import Recipe, build, learn

CONTRACT = design.contract_for(lock="off", max_steps=40)
TASKS = TaskSource("tr", (3e-3, 3e-3), "easy", randomise_plant=False)
RECIPE = Recipe(
    steps=15_000,
    cells=64,
    workers=2,
    rollout=40,
    batch=640,
    epochs=10,
    hidden=(64, 64),
    learning_rate=1e-3,
    entropy=0.0,
    threads=1,
    torch_threads=1,
)


def returns(model: PPO, path: Path) -> np.ndarray:
    """Of 40 fresh episodes, by the deterministic exported policy."""
    report = evaluate(export(model, CONTRACT, path), 3e-3, 40, conditions="easy", cells=40, threads=1)
    return np.array([episode.episode_return for episode in report.episodes])


@pytest.mark.timeout(400)
def test_a_short_training_earns_clearly_more_on_seeds_it_has_never_seen(tmp_path: Path) -> None:
    untrained = build(CONTRACT, TASKS, RECIPE)
    before = returns(untrained, tmp_path / "untrained.onnx")
    environment = untrained.get_env()
    assert environment is not None
    environment.close()
    trained = learn(CONTRACT, TASKS, RECIPE, tmp_path)
    gain = returns(trained, tmp_path / "trained.onnx") - before
    assert gain.mean() > 0.3
    assert gain.mean() > 5 * gain.std() / np.sqrt(len(gain))
    assert "success" in (tmp_path / "log.txt").read_text()
    assert PPO.load(tmp_path / "final.zip", device="cpu").num_timesteps >= RECIPE.steps


def test_a_training_may_go_on_from_an_earlier_one_and_end_by_the_clock(tmp_path: Path) -> None:
    tiny = Recipe(steps=10**9, cells=2, workers=1, rollout=4, batch=8, epochs=1, hidden=(8,), threads=1)
    first = learn(CONTRACT, TASKS, tiny, tmp_path / "first", deadline_s=0.0)
    assert first.num_timesteps < 100
    second = learn(CONTRACT, TASKS, tiny, tmp_path / "second", tmp_path / "first" / "final.zip", deadline_s=0.0)
    for old, new in zip(first.policy.parameters(), second.policy.parameters(), strict=True):
        assert np.array_equal(old.detach().numpy(), new.detach().numpy())
