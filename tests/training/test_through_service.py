"""A few seeds through the deployed service: real processes, real transport."""

from pathlib import Path

import pytest

from service.messages import RunState
from service.policy.model import Policy
from training import through_service
from training.evaluate import evaluate

SEEDS = [1_000_000, 1_000_001]


@pytest.mark.timeout(300)
def test_the_service_plays_the_seeds_it_is_told_and_the_simulator_judges_them(model_path: Path) -> None:
    told: list[int] = []
    played = through_service.play(model_path, SEEDS, 3e-3, conditions="easy", on_episode=told.append)
    assert [episode.seed for episode in played] == [episode.run.seed for episode in played] == SEEDS
    assert told == [1, 1]
    for episode in played:
        assert episode.run.state in (RunState.SUCCEEDED, RunState.FAILED)
        assert episode.run.steps > 5
        assert episode.run.peak_force_n > 1
        assert episode.claimed == episode.inserted
        # nothing was pulled out before it was judged
        assert episode.run.depth_m == pytest.approx(episode.depth_m, abs=3e-3)
    report = evaluate(Policy.load(model_path), 3e-3, 2, cells=2, threads=1, conditions="easy")
    text = through_service.table(report, played)
    assert text.count("%)") == 3
    assert "differ in 0 of 2" in text


def test_a_policy_that_the_service_refuses_is_reported_with_what_it_said(tmp_path: Path) -> None:
    model = tmp_path / "broken.onnx"
    model.write_bytes(b"nothing")
    with pytest.raises(through_service.ServiceError, match="no ONNX model"):
        through_service.play(model, [1], 2e-3)
