import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra `training`: pip install -e '.[training]'")
onnx = pytest.importorskip("onnx", reason="needs the extra `training`")

from service.policy.contract import EvaluationFigure, PolicyContract  # noqa: E402
from service.policy.model import Policy, PolicyError  # noqa: E402
from tests.training.play import REMEMBERING, SHORT  # noqa: E402
from training.environment import design  # noqa: E402
from training.environment.insertion import Insertions  # noqa: E402
from training.learning.export import export, network_of, record_evaluation, rounded, to_onnx  # noqa: E402
from wire.task import Task  # noqa: E402


def figure(clearance_m: float, successes: int) -> EvaluationFigure:
    return EvaluationFigure(
        clearance_m=clearance_m, conditions="standard", episodes=500, successes=successes, low=0.5, high=0.6
    )


@pytest.fixture(params=[SHORT, REMEMBERING], ids=["memoryless", "recurrent"])
def trained(request: pytest.FixtureRequest) -> tuple[Any, PolicyContract]:
    contract = request.param
    return request.getfixturevalue("remembering" if contract.hidden_size else "untrained"), contract


def test_the_file_computes_what_the_network_does_through_real_episodes(trained: tuple[Any, PolicyContract]) -> None:
    network, contract = trained
    policy = Policy(to_onnx(network, contract))
    network = rounded(network)
    cells = Insertions(contract, 2)
    seen = cells.reset(np.arange(2), [Task(0), Task(1)])
    remembered, hidden = policy.initial_hidden((2,)), network.initial_hidden(2)
    for _ in range(15):
        with torch.no_grad():
            perceived, hidden = network.remember(torch.from_numpy(seen), hidden)
            want = network.act(perceived, hidden)[0].clamp(-1, 1).numpy()
        got, remembered = policy.act(seen, remembered)
        np.testing.assert_allclose(got, want, rtol=0, atol=1e-5)
        if remembered is not None:
            np.testing.assert_allclose(remembered, hidden.numpy(), rtol=0, atol=1e-5)
        seen = cells.step(got).observation
    assert np.abs(got).max() > 1e-3


def test_the_files_matrices_are_rounded_to_a_byte_a_weight_and_take_a_quarter_of_the_room(
    trained: tuple[Any, PolicyContract],
) -> None:
    network, contract = trained
    actor = [p for name, p in network.named_parameters() if not name.startswith(("critic", "log_std"))]
    full = sum(4 * p.numel() for p in actor)
    assert len(to_onnx(network, contract)) < 0.25 * full + 40_000
    for before, after in zip(network.parameters(), rounded(network).parameters(), strict=True):
        step = before.detach().abs().amax(-1, keepdim=True) / 127 if before.ndim == 2 else 0.0
        assert ((after - before).abs() <= 0.501 * step).all()


def test_a_recurrent_policy_acts_by_what_it_has_seen_before(remembering: Any) -> None:
    policy = Policy(to_onnx(remembering, REMEMBERING))
    now = np.zeros(REMEMBERING.observation_size, np.float32)
    _, after_contact = policy.act(now + 1.0, policy.initial_hidden())
    _, after_nothing = policy.act(now, policy.initial_hidden())
    assert not np.array_equal(policy.act(now, after_contact)[0], policy.act(now, after_nothing)[0])


def test_normalisation_is_in_the_graph_so_that_far_outliers_change_nothing(model_path: Path) -> None:
    policy = Policy.load(model_path)
    entries = [e for e in policy.contract.observation for _ in range(e.size * e.history)]
    clipped = np.array([e.clip is not None for e in entries])
    far = np.where(clipped, 1e3, 0.0).astype(np.float32)
    assert np.array_equal(policy.act(far)[0], policy.act(2 * far)[0])
    assert not np.array_equal(policy.act(far)[0], policy.act(-far)[0])


def test_the_file_carries_the_contract_it_was_trained_under(trained: tuple[Any, PolicyContract]) -> None:
    assert Policy(to_onnx(*trained)).contract == trained[1]


def test_weights_make_the_network_again_that_they_were_taken_from(trained: tuple[Any, PolicyContract]) -> None:
    network, contract = trained
    again = network_of(contract, network.state_dict())
    assert to_onnx(again, contract) == to_onnx(network, contract)


@pytest.mark.parametrize(
    "other",
    [
        design.contract_for("VM", hidden_size=32),
        design.contract_for(hidden_size=16),
        design.contract_for(),
        REMEMBERING.model_copy(
            update={"observation": tuple(e.model_copy(update={"scale": 7.0}) for e in REMEMBERING.observation)}
        ),
    ],
    ids=["other observation", "other memory", "no memory", "other scales"],
)
def test_weights_of_another_contract_are_refused(remembering: Any, other: PolicyContract) -> None:
    with pytest.raises(ValueError, match=f"contract '{other.name}'"):
        network_of(other, remembering.state_dict())


def test_a_graph_that_differs_from_the_network_is_not_written(
    untrained: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("training.learning.export.AGREEMENT", -1.0)
    with pytest.raises(ValueError, match="differs from the network"):
        export(untrained, SHORT, tmp_path / "model.onnx")
    assert not list(tmp_path.iterdir())


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


def test_exporting_warns_of_nothing(trained: tuple[Any, PolicyContract]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        to_onnx(*trained)
