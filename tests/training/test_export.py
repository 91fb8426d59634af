import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra `training`: pip install -e '.[training]'")
onnx = pytest.importorskip("onnx", reason="needs the extra `training`")

from service.policy.contract import EvaluationFigure  # noqa: E402
from service.policy.model import Policy, PolicyError  # noqa: E402
from tests.training.play import SHORT  # noqa: E402
from training.export import contract_of, export, record_evaluation  # noqa: E402


def figure(clearance_m: float, successes: int) -> EvaluationFigure:
    return EvaluationFigure(
        clearance_m=clearance_m, conditions="standard", episodes=500, successes=successes, low=0.5, high=0.6
    )


def test_the_file_computes_what_the_trained_model_does_on_observations_of_real_episodes(
    untrained: Any, model_path: Path
) -> None:
    policy = Policy.load(model_path)
    env = untrained.get_env()
    seen = env.reset()
    size = policy.contract.observation_size
    for _ in range(15):
        want, _ = untrained.predict(seen, deterministic=True)
        got, _ = policy.act(np.ascontiguousarray(seen[:, :size]))
        np.testing.assert_allclose(got, want, rtol=0, atol=1e-5)
        seen, *_ = env.step(want)


def test_normalisation_is_in_the_graph_so_that_far_outliers_change_nothing(model_path: Path) -> None:
    policy = Policy.load(model_path)
    entries = [e for e in policy.contract.observation for _ in range(e.size * e.history)]
    clipped = np.array([e.clip is not None for e in entries])
    far = np.where(clipped, 1e3, 0.0).astype(np.float32)
    assert np.array_equal(policy.act(far)[0], policy.act(2 * far)[0])
    assert not np.array_equal(policy.act(far)[0], policy.act(-far)[0])


def test_the_file_carries_the_contract_it_was_trained_under(untrained: Any, model_path: Path) -> None:
    assert Policy.load(model_path).contract == contract_of(untrained) == SHORT


def test_a_model_keeps_its_contract_when_it_is_saved_and_loaded(untrained: Any, tmp_path: Path) -> None:
    from stable_baselines3 import PPO

    untrained.save(tmp_path / "model.zip")
    assert contract_of(PPO.load(tmp_path / "model.zip", device="cpu")) == contract_of(untrained)


def test_a_graph_that_differs_from_the_network_is_not_written(
    untrained: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("training.export.AGREEMENT", -1.0)
    with pytest.raises(ValueError, match="differs from the network"):
        export(untrained, SHORT, tmp_path / "model.onnx")
    assert not (tmp_path / "model.onnx").exists()


def test_figures_are_recorded_in_the_contract_and_the_network_stays(model_path: Path, tmp_path: Path) -> None:
    path = tmp_path / "model.onnx"
    path.write_bytes(model_path.read_bytes())
    before = Policy.load(path)
    record_evaluation(path, [figure(1.33e-3, 200), figure(2e-3, 100)])
    after = record_evaluation(path, [figure(2e-3, 450)])
    assert [(f.clearance_m, f.successes) for f in Policy.load(path).contract.evaluation] == [
        (2e-3, 450),
        (1.33e-3, 200),
    ]
    assert after.sha256 != before.sha256
    probe = np.ones(before.contract.observation_size, np.float32)
    assert np.array_equal(before.act(probe)[0], after.act(probe)[0])
    assert list(tmp_path.iterdir()) == [path]


def test_recording_into_something_else_changes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "model.onnx"
    path.write_bytes(b"not a model")
    with pytest.raises(PolicyError):
        record_evaluation(path, [figure(2e-3, 1)])
    assert path.read_bytes() == b"not a model"


def test_exporting_warns_of_nothing(untrained: Any, tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        export(untrained, SHORT, tmp_path / "model.onnx")
