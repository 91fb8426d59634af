from pathlib import Path

import numpy as np
import pytest

from service.policy.model import Policy
from tests.training.play import SHORT, towards_hole
from training.environment.episodes import FIRST_TRAINING_SEED
from training.environment.insertion import Insertions
from training.evaluation.evaluate import FIRST_TEST_SEED, evaluate, jobs_of, measure, play, with_lock
from training.evaluation.results import Block, EpisodeResult, Setting
from wire.arrays import Float32Array
from wire.task import Task

SETTING = Setting(part="tr", clearance_m=3e-3, conditions="easy", lock="paper", first_seed=FIRST_TEST_SEED)


class Knowing:
    """An actor with a memory, which counts its steps, and with what only the simulation knows."""

    def __init__(self, insertions: Insertions) -> None:
        self.insertions = insertions
        self.counted: list[float] = []

    def initial_hidden(self, shape: tuple[int, ...] = ()) -> Float32Array:
        return np.zeros((*shape, 1), np.float32)

    def act(self, observation: Float32Array, hidden: Float32Array | None = None) -> tuple[Float32Array, Float32Array]:
        assert hidden is not None
        self.counted.append(float(hidden[0, 0]))
        return towards_hole(self.insertions).astype(np.float32), hidden + 1


def test_every_seed_is_played_once_by_a_fixed_number_of_episodes_per_cell(model_path: Path) -> None:
    policy = Policy.load(model_path)
    block = evaluate(policy, 3e-3, 6, cells=3, threads=1, conditions="easy")
    assert [episode.seed for episode in block.episodes] == list(range(FIRST_TEST_SEED, FIRST_TEST_SEED + 6))
    assert max(episode.seed for episode in block.episodes) < FIRST_TRAINING_SEED
    assert all(1 <= episode.steps <= policy.contract.max_steps for episode in block.episodes)


def test_how_many_cells_play_makes_no_difference_to_any_episode(model_path: Path) -> None:
    policy = Policy.load(model_path)
    together, in_turn = (evaluate(policy, 3e-3, 3, cells=n, threads=1, conditions="easy") for n in (3, 1))
    for one, other in zip(together.episodes, in_turn.episodes, strict=True):
        assert (one.seed, one.success, one.fault, one.steps) == (other.seed, other.success, other.fault, other.steps)
        assert one.peak_force_n == pytest.approx(other.peak_force_n, rel=1e-3)


def test_episodes_that_cannot_be_shared_out_evenly_are_refused(model_path: Path) -> None:
    with pytest.raises(ValueError, match="do not divide evenly"):
        evaluate(Policy.load(model_path), 2e-3, 5, cells=3)


def test_the_memory_of_a_recurrent_policy_is_carried_from_step_to_step() -> None:
    insertions = Insertions(SHORT, 1)
    actor = Knowing(insertions)
    (result,) = play(actor, insertions, [Task(FIRST_TEST_SEED, "tr", 3e-3, "easy")])
    assert result.steps > 5
    assert actor.counted == list(range(result.steps))


def test_an_episode_that_goes_on_to_the_authors_depth_is_judged_as_it_was_at_its_own_end() -> None:
    tasks = [Task(FIRST_TEST_SEED + i, "tr", 4e-3, "easy") for i in range(3)]
    insertions = Insertions(SHORT.model_copy(update={"max_steps": 60}), 3)
    ended = play(Knowing(insertions), insertions, tasks)
    went_on = play(Knowing(insertions), insertions, tasks, to_author_depth=True)
    assert any(result.success for result in ended)
    for one, other in zip(ended, went_on, strict=True):
        assert one.success_10mm is None
        assert other.success_10mm is not None
        assert (one.success, one.fault, one.steps, one.peak_force_n, one.episode_return) == (
            other.success,
            other.fault,
            other.steps,
            other.peak_force_n,
            other.episode_return,
        )
        assert other.success or not other.success_10mm
    assert any(result.success_10mm for result in went_on)


def test_only_the_seeds_that_are_missing_become_jobs() -> None:
    played = [EpisodeResult(FIRST_TEST_SEED + i, True, False, 10, 5.0) for i in (0, 2)]
    block = Block(setting=SETTING, episodes=tuple(played))
    jobs = jobs_of(Path("model.onnx"), "", block, 60)
    seeds = [seed for job in jobs for seed in job.seeds]
    assert seeds == [FIRST_TEST_SEED + i for i in range(60) if i not in (0, 2)]
    assert len(jobs) > 1
    assert jobs_of(Path("model.onnx"), "", block, 1) == []


def test_jobs_give_what_the_evaluation_in_one_process_gives(model_path: Path) -> None:
    policy = Policy.load(model_path)
    jobs = jobs_of(model_path, policy.sha256, Block(setting=SETTING), 2)
    ((setting, results),) = measure(jobs, 1)
    assert setting == SETTING
    want = evaluate(policy, 3e-3, 2, threads=1, conditions="easy", reward_name=SETTING.reward)
    for got, reference in zip(results, want.episodes, strict=True):
        assert (got.seed, got.success, got.steps) == (reference.seed, reference.success, reference.steps)
        assert got.episode_return == pytest.approx(reference.episode_return, rel=1e-3)


def test_a_policy_can_be_put_under_another_lock_but_not_under_one_that_does_not_exist() -> None:
    sliding = with_lock(SHORT, Setting(**_fields(lock="sliding")))
    assert sliding.dsl.mode == "sliding"
    assert sliding.dsl.delta_f == SHORT.dsl.delta_f
    with pytest.raises(ValueError, match="bolt"):
        with_lock(SHORT, Setting(**_fields(lock="bolt")))


def _fields(**changes: object) -> dict[str, object]:
    return {name: getattr(SETTING, name) for name in SETTING.__slots__} | changes
