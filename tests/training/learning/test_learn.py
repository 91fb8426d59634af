"""A training: that it really learns, goes on where it ended, and repeats itself."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra `training`: pip install -e '.[training]'")

from service.policy.contract import PolicyContract  # noqa: E402
from service.policy.model import Policy  # noqa: E402
from training.environment.vector import EndlessCells  # noqa: E402
from training.evaluation.evaluate import evaluate  # noqa: E402
from training.learning import ppo  # noqa: E402
from training.learning.experiment import Experiment, ExperimentError  # noqa: E402
from training.learning.export import to_onnx  # noqa: E402
from training.learning.learn import TrainingError, learn, untrained  # noqa: E402
from training.learning.run import CheckpointError, TrainingRun, read, save  # noqa: E402
from training.learning.validation import Validation, validate  # noqa: E402

EASY = {"clearance_mm": [3.0, 3.0], "lock": "off", "conditions": "easy", "randomise_plant": False, "max_steps": 80}
"""Without a lock the policy itself must find out to go down."""


def experiment(name: str = "mine", **sections: Any) -> Experiment:
    small = {
        "name": name,
        "title": "Small",
        "task": EASY | {"max_steps": 5},
        "algorithm": {
            "width": 8,
            "hidden": 8,
            "steps": 64,
            "cells": 4,
            "workers": 1,
            "rollout": 8,
            "epochs": 1,
            "minibatches": 1,
        },
        "evaluation": {"every_steps": 32, "episodes": 2, "clearances_mm": [3.0]},
    }
    return Experiment.model_validate(
        small | {key: small[key] | value if isinstance(value, dict) else value for key, value in sections.items()}
    )


def same(one: Any, other: Any) -> bool:
    return all(torch.equal(a, b) for a, b in zip(one.state_dict().values(), other.state_dict().values(), strict=True))


@pytest.mark.timeout(600)
def test_a_short_training_inserts_on_seeds_it_has_never_seen_what_an_untrained_policy_does_not(tmp_path: Path) -> None:
    asked = experiment(
        task=EASY,
        algorithm={
            "width": 64,
            "hidden": 64,
            "steps": 20_000,
            "cells": 48,
            "workers": 2,
            "rollout": 16,
            "learning_rate": 3e-3,
            "epochs": 8,
            "minibatches": 2,
            "gamma": 0.95,
            "gae_lambda": 0.8,
            "entropy": 0.0,
        },
        evaluation={"every_steps": 20_000, "episodes": 20},
    )

    def judged(network: Any) -> tuple[float, float]:
        policy = Policy(to_onnx(network, asked.contract()))
        episodes = evaluate(policy, 3e-3, 60, conditions="easy", cells=60, threads=1).episodes
        return float(np.mean([e.success for e in episodes])), float(np.mean([e.episode_return for e in episodes]))

    success, earned = judged(learn(TrainingRun(asked, 0, tmp_path)))
    success_before, earned_before = judged(untrained(asked, 0))
    assert success_before < 0.05
    assert success > 0.2
    assert earned > earned_before + 2.5


def test_a_training_leaves_its_account_its_progress_and_its_best_model(tmp_path: Path) -> None:
    asked = experiment(
        task={"parts": ["tr", "cir"]}, algorithm={"workers": 2}, evaluation={"clearances_mm": [3.0, 2.0]}
    )
    network = learn(TrainingRun(asked, 3, tmp_path))
    account = json.loads((tmp_path / "run.json").read_text())
    assert Experiment.model_validate(account["experiment"]) == asked
    assert account["seed"] == 3
    (session,) = account["sessions"]
    assert session["steps"] == 0
    assert {"began", "commit", "machine", "versions"} <= session.keys()
    records = TrainingRun(asked, 3, tmp_path).records()
    rollouts, evaluations = ([r for r in records if r["kind"] == kind] for kind in ("rollout", "evaluation"))
    assert [r["steps"] for r in rollouts] == [32, 64]
    assert rollouts[-1]["episodes"] > 0
    assert [(r["steps"], r["part"], r["clearance_m"]) for r in evaluations] == [
        (steps, part, clearance) for steps in (0, 32, 64) for part in ("tr", "cir") for clearance in (3e-3, 2e-3)
    ]
    assert {r["episodes"] for r in evaluations} == {2}
    assert list((tmp_path / "tensorboard").iterdir())
    latest, best = read(tmp_path / "checkpoint.pt"), read(tmp_path / "best.pt")
    assert latest["steps"] == 64
    assert torch.equal(latest["net"]["log_std"], network.log_std)
    returns = {steps: np.mean([r["return_mean"] for r in evaluations if r["steps"] == steps]) for steps in (0, 32, 64)}
    assert best["steps"] == max(returns, key=lambda steps: returns[steps])  # success is 0 throughout


def test_what_comes_of_a_training_is_the_running_average_of_its_weights_and_goes_on(tmp_path: Path) -> None:
    asked = experiment(algorithm={"averaging": 0.9, "steps": 32})
    before = untrained(asked, 0).state_dict()
    for steps in (32, 64):
        asked = asked.model_copy(update={"algorithm": asked.algorithm.model_copy(update={"steps": steps})})
        policy = learn(TrainingRun(asked, 0, tmp_path)).state_dict()
        found = read(tmp_path / "checkpoint.pt")
        for name, weights in policy.items():
            assert torch.equal(found["net"][name], weights)
            if not name.startswith("normalise"):
                torch.testing.assert_close(weights, 0.9 * before[name] + 0.1 * found["learning"][name])
        assert not torch.equal(policy["log_std"], found["learning"]["log_std"])
        before = policy


def test_the_average_is_what_an_evaluation_plays_and_the_best_is_chosen_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    played: list[bytes] = []

    def watched(asked: Experiment, model: bytes, cells: EndlessCells) -> list[Validation]:
        played.append(model)
        return validate(asked, model, cells)

    monkeypatch.setattr("training.learning.learn.validate", watched)
    asked = experiment(algorithm={"averaging": 0.9})
    policy = learn(TrainingRun(asked, 0, tmp_path))
    assert played[-1] == to_onnx(policy, asked.contract())
    assert len(set(played)) == len(played) == 3


def test_the_same_seed_trains_the_same_network_and_another_another(tmp_path: Path) -> None:
    asked = experiment(evaluation={"every_steps": 1000})
    first, again, other = (
        learn(TrainingRun(asked, seed, tmp_path / name)) for seed, name in ((0, "a"), (0, "b"), (1, "c"))
    )
    assert same(first, again)
    assert not same(first, other)


def test_a_training_goes_on_from_where_it_ended_and_counts_on(tmp_path: Path) -> None:
    half = learn(TrainingRun(experiment(algorithm={"steps": 32}), 0, tmp_path))
    with (tmp_path / "progress.jsonl").open("a") as progress:
        progress.write('{"kind": "rollout", "steps": 64}\n{"kind": "roll')  # killed there
    run = TrainingRun(experiment(), 0, tmp_path)
    went_on = learn(run)
    assert not same(half, went_on)
    assert run.steps == 64
    assert [r["steps"] for r in run.records()] == [0, 32, 32, 64, 64]
    assert [s["steps"] for s in json.loads((tmp_path / "run.json").read_text())["sessions"]] == [0, 32]
    assert read(run.checkpoint)["optimiser"]["state"][0]["step"] == 2
    assert [r["elapsed_s"] for r in run.records()] == sorted(r["elapsed_s"] for r in run.records())


def test_scores_of_another_evaluation_do_not_keep_better_weights_out(tmp_path: Path) -> None:
    half = experiment(algorithm={"steps": 32})
    for evaluation, kept in (({"every_steps": 16}, 32), ({"clearances_mm": [2.0]}, 64)):
        directory = tmp_path / str(kept)
        learn(TrainingRun(half, 0, directory))
        best = directory / "best.pt"
        save(best, read(best) | {"score": [2.0, 0.0], "steps": 32})  # beyond what any evaluation gives
        learn(TrainingRun(experiment(evaluation=evaluation), 0, directory))
        assert read(best)["steps"] == kept


def test_a_session_that_is_out_of_time_leaves_the_rest_to_the_next(tmp_path: Path) -> None:
    run = TrainingRun(experiment(), 0, tmp_path)
    learn(run, deadline_s=1e-9)
    assert run.steps == 0
    learn(run)
    assert run.steps == 64


def test_a_finished_training_stays_as_it_is(tmp_path: Path) -> None:
    run = TrainingRun(experiment(algorithm={"steps": 32}), 0, tmp_path)
    learn(run)
    before = (run.best.read_bytes(), run.checkpoint.read_bytes(), run.records())
    learn(run)
    assert before == (run.best.read_bytes(), run.checkpoint.read_bytes(), run.records())


def test_another_experiment_does_not_go_on_in_the_same_folder(tmp_path: Path) -> None:
    learn(TrainingRun(experiment(algorithm={"steps": 32}), 0, tmp_path))
    progress = (tmp_path / "progress.jsonl").read_text()
    with pytest.raises(ExperimentError, match=r"other settings \(algorithm\.gamma, task\.reward\)"):
        learn(TrainingRun(experiment(algorithm={"gamma": 0.9}, task={"reward": "paper"}), 0, tmp_path))
    assert (tmp_path / "progress.jsonl").read_text() == progress


def test_a_contract_that_the_code_has_changed_meanwhile_is_not_trained_on_under(tmp_path: Path) -> None:
    run = TrainingRun(experiment(algorithm={"steps": 32}), 0, tmp_path)
    learn(run)
    checkpoint = read(run.checkpoint)
    trained = PolicyContract.from_json(checkpoint["contract"])
    save(run.checkpoint, checkpoint | {"contract": trained.model_copy(update={"wrench_window_ticks": 7}).to_json()})
    before = run.records()
    with pytest.raises(ExperimentError, match="another contract"):
        learn(TrainingRun(experiment(), 0, tmp_path))
    assert run.records() == before
    save(run.checkpoint, checkpoint | {"contract": trained.model_copy(update={"clearance_m": (1e-3, 5e-3)}).to_json()})
    learn(TrainingRun(experiment(), 0, tmp_path))
    assert run.steps == 64


def test_a_training_that_diverges_says_so_and_keeps_the_weights_from_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = TrainingRun(experiment(), 0, tmp_path)
    learned = ppo.update

    def diverging(network: Any, optimiser: Any, rollout: Any, algorithm: Any) -> ppo.Losses:
        losses = learned(network, optimiser, rollout, algorithm)
        if run.steps:
            with torch.no_grad():
                network.log_std.fill_(float("nan"))
            return learned(network, optimiser, rollout, algorithm)
        return losses

    monkeypatch.setattr(ppo, "update", diverging)
    with pytest.raises(TrainingError, match="diverged at 32 steps"):
        learn(run)
    assert run.steps == 32
    assert read(run.checkpoint)["net"]["log_std"].isfinite().all()


def test_weights_that_are_no_numbers_are_not_kept_even_if_the_losses_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = TrainingRun(experiment(), 0, tmp_path)
    learned = ppo.update

    def spoiling(network: Any, optimiser: Any, rollout: Any, algorithm: Any) -> ppo.Losses:
        losses = learned(network, optimiser, rollout, algorithm)
        with torch.no_grad():
            network.critic[0].bias[0] = float("inf")
        return losses

    monkeypatch.setattr(ppo, "update", spoiling)
    with pytest.raises(TrainingError, match="diverged at 0 steps"):
        learn(run)
    assert not run.checkpoint.exists()


def test_a_training_may_begin_with_the_weights_of_another_and_explores_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    learn(TrainingRun(experiment("first", algorithm={"steps": 32}), 0))
    best = read(tmp_path / "var/training/first/seed-0/best.pt")["net"]
    bold = {"initial_log_std": -0.1}
    follower = experiment("second", start_from="first", algorithm=bold)
    other, start = experiment("third", algorithm=bold), Path("var/training/first/seed-0/best.pt")
    for network in (
        learn(TrainingRun(follower, 0), deadline_s=1e-9),
        learn(TrainingRun(other, 0), start, deadline_s=1e-9),
    ):
        weights = network.state_dict()
        torch.testing.assert_close(weights.pop("log_std"), torch.full((4,), -0.1))
        assert all(torch.equal(best[name], value) for name, value in weights.items())
    kept = read(start)["steps"]
    for name in ("second", "third"):
        (session,) = json.loads((tmp_path / f"var/training/{name}/seed-0/run.json").read_text())["sessions"]
        known = session["began_with"]
        assert (known["file"], known["experiment"], known["seed"], known["steps"]) == ("best.pt", "first", 0, kept)


def test_a_training_under_way_takes_no_other_weights_than_it_began_with(tmp_path: Path) -> None:
    for name in ("first", "other"):
        learn(TrainingRun(experiment(name, algorithm={"steps": 32}), len(name), tmp_path / name))
    run, start = TrainingRun(experiment(), 0, tmp_path / "mine"), tmp_path / "first/best.pt"
    learn(run, start, deadline_s=1e-9)
    learn(TrainingRun(experiment(algorithm={"steps": 32}), 0, tmp_path / "mine"), start)
    before = (run.checkpoint.read_bytes(), (tmp_path / "mine/run.json").read_bytes())
    with pytest.raises(CheckpointError, match=r"mine did not begin with the weights of .*other"):
        learn(run, tmp_path / "other/best.pt")
    assert before == (run.checkpoint.read_bytes(), (tmp_path / "mine/run.json").read_bytes())


@pytest.mark.parametrize("change", [{"task": {"mode": "VM", "lock": "off"}}, {"algorithm": {"memory": "none"}}])
def test_weights_that_do_not_fit_are_refused_and_nothing_is_left(change: dict[str, Any], tmp_path: Path) -> None:
    learn(TrainingRun(experiment(algorithm={"steps": 32}), 0, tmp_path / "first"))
    with pytest.raises(CheckpointError, match=r"cannot begin with .*best\.pt"):
        learn(TrainingRun(experiment("second", **change), 0, tmp_path / "second"), tmp_path / "first/best.pt")
    assert not (tmp_path / "second").exists()


def test_weights_that_are_none_are_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.pt").write_text("not weights")
    torch.save({"weights": 1}, tmp_path / "other.pt")
    for name, text in (("missing.pt", "there is no"), ("notes.pt", "cannot read"), ("other.pt", "holds no network")):
        with pytest.raises(CheckpointError, match=text):
            read(tmp_path / name)
