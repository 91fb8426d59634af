"""The insertions as stable-baselines3 sees them, in one process and in several."""

from functools import partial

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="needs the extra `training`: pip install -e '.[training]'")

from training import design
from training.episodes import TaskSource
from training.insertion import PRIVILEGED_SIZE, Insertions
from training.parallel import ParallelInsertions
from training.vector import InsertionVecEnv


def environment(seed: int = 0, n: int = 2, max_steps: int = 4) -> InsertionVecEnv:
    return InsertionVecEnv(Insertions(design.contract_for(max_steps=max_steps), n), TaskSource(), seed)


def worker(seeds: list[int], number: int) -> InsertionVecEnv:
    return environment(seeds[number])


def steps(count: int, n: int = 2) -> np.ndarray:
    return np.random.default_rng(1).uniform(-1, 1, (count, n, 4)).astype(np.float32)


def test_the_policys_part_of_an_observation_is_the_cells_and_the_rest_is_for_the_critic() -> None:
    env = environment()
    seen = env.reset()
    size = design.contract_for().observation_size
    assert seen.shape == (2, size + PRIVILEGED_SIZE) == (2, *env.observation_space.shape)
    again = Insertions(design.contract_for(max_steps=4), 2)
    again.reset(np.arange(2), TaskSource().draw(np.random.default_rng(0), 2))
    assert np.array_equal(seen[:, :size], again.observation)
    assert np.array_equal(seen[:, size:], again.privileged())


def test_an_episode_that_ends_hands_over_its_last_observation_and_its_account() -> None:
    env = environment()
    env.reset()
    earned = np.zeros(2)
    for action in steps(3):
        seen, reward, done, infos = env.step(action)
        earned += reward
        assert not done.any()
        assert infos == [{}, {}]
    last = seen
    seen, reward, done, infos = env.step(steps(1)[0])
    earned += reward
    assert done.all()
    for cell, info in enumerate(infos):
        assert info["TimeLimit.truncated"]
        assert info["terminal_observation"].shape == seen[cell].shape
        assert not np.array_equal(info["terminal_observation"], seen[cell])
        assert not np.array_equal(info["terminal_observation"], last[cell])
        assert info["episode"]["l"] == 4
        assert info["episode"]["r"] == pytest.approx(earned[cell], rel=1e-5)
        assert {"is_success", "peak_force", "fault"} <= info.keys()


def test_the_observation_after_an_end_is_the_first_of_the_next_episode() -> None:
    env = environment(seed=3)
    env.reset()
    for action in steps(4):
        seen, *_ = env.step(action)
    draw = np.random.default_rng(3)
    TaskSource().draw(draw, 2)
    fresh = Insertions(design.contract_for(max_steps=4), 2)
    fresh.reset(np.arange(2), TaskSource().draw(draw, 2))
    assert np.array_equal(seen, np.concatenate([fresh.observation, fresh.privileged()], axis=1))


def test_the_same_seed_plays_the_same_and_another_another() -> None:
    assert np.array_equal(environment(seed=1).reset(), environment(seed=1).reset())
    assert not np.array_equal(environment(seed=1).reset(), environment(seed=2).reset())


def test_workers_in_their_own_processes_play_what_their_environments_play_here() -> None:
    here = [environment(seed) for seed in (7, 8)]
    there = ParallelInsertions(partial(worker, [7, 8]), 2)
    try:
        assert there.num_envs == 4
        assert np.array_equal(there.reset(), np.concatenate([env.reset() for env in here]))
        for action in steps(5, 4):
            seen, reward, done, infos = there.step(action)
            mine = [env.step(part) for env, part in zip(here, np.split(action, 2), strict=True)]
            assert np.array_equal(seen, np.concatenate([result[0] for result in mine]))
            assert np.array_equal(reward, np.concatenate([result[1] for result in mine]))
            assert np.array_equal(done, np.concatenate([result[2] for result in mine]))
            assert [info.get("episode") for info in infos] == [i.get("episode") for result in mine for i in result[3]]
    finally:
        there.close()
