"""A few seeds through the deployed service: real processes, real transport."""

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from service.client import CellClient, CellError
from service.messages import Run, RunState
from service.policy.model import Policy
from training.environment.insertion import SUCCESS_DEPTH_M
from training.evaluation import through_service
from training.evaluation.evaluate import Job
from training.evaluation.results import Setting, Through
from wire.plant import PlantErrors
from wire.task import Task

SEEDS = [1_000_000, 1_000_001]


def setting(through: Through) -> Setting:
    return Setting(part="tr", clearance_m=3e-3, conditions="easy", lock="paper", through=through, first_seed=SEEDS[0])


def check(played: list[through_service.ServiceEpisode], seeds: list[int]) -> None:
    assert [episode.seed for episode in played] == [episode.run.seed for episode in played] == seeds
    for episode in played:
        assert episode.run.state in (RunState.SUCCEEDED, RunState.FAILED)
        assert episode.run.steps > 5
        assert episode.run.peak_force_n > 1
        assert episode.claimed == episode.inserted
        # nothing was pulled out before it was judged
        assert episode.run.depth_m == pytest.approx(episode.depth_m, abs=3e-3)
        result = episode.result
        assert (result.seed, result.success, result.claimed) == (episode.seed, episode.inserted, episode.claimed)
        assert result.fault == (episode.run.state is RunState.LATCHED)
        assert result.code == episode.run.code
        assert (result.steps, result.peak_force_n) == (episode.run.steps, episode.run.peak_force_n)


@pytest.mark.timeout(300)
def test_the_service_plays_the_seeds_it_is_told_and_the_simulator_judges_them(model_path: Path) -> None:
    told: list[through_service.ServiceEpisode] = []
    played = through_service.play(model_path, SEEDS, setting("zenoh"), on_episode=told.append)
    check(played, SEEDS)
    assert told == played
    sha256 = Policy.load(model_path).sha256
    jobs = [Job(model_path, sha256, setting("zenoh"), (seed,)) for seed in SEEDS]
    side_by_side = {episode.seed: episode for _, episode in through_service.measure(jobs, 2)}
    assert side_by_side == {episode.seed: episode.result for episode in played}


@pytest.mark.timeout(300)
def test_the_same_seeds_can_be_played_on_an_emulated_ur_controller(model_path: Path) -> None:
    check(through_service.play(model_path, SEEDS[:1], setting("rtde")), SEEDS[:1])


@pytest.mark.timeout(300)
@pytest.mark.parametrize("through", ["zenoh", "rtde"])
def test_the_world_behind_the_service_has_the_errors_of_the_settings_plant(model_path: Path, through: Through) -> None:
    plant = PlantErrors(hole_tilt_deg=1.0, tcp_shift_m=1e-3, ft_gain_error=0.1, peg_chamfer_m=0.3e-3)
    check(through_service.play(model_path, SEEDS[:1], replace(setting(through), plant=plant)), SEEDS[:1])


@pytest.mark.timeout(300)
def test_a_run_whose_service_dies_is_kept_as_a_failure_and_ends_the_measurement(
    model_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def lost(client: CellClient, run: str) -> Run:
        raise CellError(f"{run}: nobody answers")

    monkeypatch.setattr(CellClient, "run", lost)
    told: list[through_service.ServiceEpisode] = []
    with pytest.raises(through_service.ServiceError, match=f"seed {SEEDS[0]} was not seen to end"):
        through_service.play(model_path, SEEDS, setting("zenoh"), on_episode=told.append)
    (episode,) = told
    assert (episode.result.seed, episode.result.success, episode.result.claimed) == (SEEDS[0], False, False)


def test_a_world_that_was_laid_out_for_something_else_is_not_judged() -> None:
    asked = setting("zenoh")
    run = Run.model_construct(state=RunState.SUCCEEDED)
    played = Task(7, asked.part, asked.clearance_m, asked.conditions).to_json()
    at_the_limit = {"task": played, "depth": SUCCESS_DEPTH_M, "contained": True}
    assert through_service.judged(at_the_limit, 7, asked, run).inserted
    tilted = replace(asked, plant=PlantErrors(hole_tilt_deg=1.0))
    with pytest.raises(through_service.ServiceError, match="the simulator played another task: plant None where"):
        through_service.judged(at_the_limit, 7, tilted, run)
    latched = Run.model_construct(state=RunState.LATCHED)
    assert not through_service.judged(at_the_limit, 7, asked, latched).inserted
    for name, value in (("seed", 8), ("part", "cir"), ("clearance_m", 2e-3), ("conditions", "standard")):
        with pytest.raises(through_service.ServiceError, match=f"another task: {name} {value!r} where"):
            through_service.judged(at_the_limit | {"task": played | {name: value}}, 7, asked, run)


def test_a_policy_that_the_service_refuses_is_reported_with_what_it_said(tmp_path: Path) -> None:
    model = tmp_path / "broken.onnx"
    model.write_bytes(b"nothing")
    with pytest.raises(through_service.ServiceError, match="not an ONNX model"):
        through_service.play(model, [1], setting("zenoh"))


def test_services_play_at_once_and_what_one_told_is_not_lost_by_another_that_fails(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    meeting = threading.Barrier(2, timeout=30)
    told = threading.Event()

    def play(*arguments: Any, on_episode: Callable[[object], object], **_: object) -> None:
        (seed,) = arguments[1]
        meeting.wait()  # one after the other, they would not meet
        if seed == SEEDS[1]:
            assert told.wait(30)
            raise through_service.ServiceError("the second fails")
        on_episode(SimpleNamespace(result=seed))
        told.set()

    monkeypatch.setattr(through_service, "play", play)
    measuring = through_service.measure([Job(Path("p.onnx"), "", setting("zenoh"), (seed,)) for seed in SEEDS], 2)
    assert next(measuring) == (setting("zenoh"), SEEDS[0])
    with pytest.raises(through_service.ServiceError, match="the second fails"):
        list(measuring)


def test_a_file_that_was_replaced_meanwhile_is_not_played(model_path: Path) -> None:
    job = Job(model_path, "0" * 64, setting("zenoh"), (SEEDS[0],))
    with pytest.raises(through_service.ServiceError, match="SHA-256"):
        list(through_service.measure([job], 1))
