"""Cells that play episode after episode, in one process and in several."""

import os
import signal
from functools import partial

import numpy as np
import pytest

from training.environment import design
from training.environment.episodes import TaskSource
from training.environment.insertion import PRIVILEGED_SIZE, Insertions
from training.environment.vector import Ended, EndlessInsertions
from training.learning.parallel import ParallelInsertions, WorkerError


def endless(seed: int = 0, n: int = 2, max_steps: int = 4) -> EndlessInsertions:
    return EndlessInsertions(Insertions(design.contract_for(max_steps=max_steps), n), TaskSource(), seed)


def worker(seeds: list[int], number: int) -> EndlessInsertions:
    return endless(seeds[number])


def broken(number: int) -> EndlessInsertions:
    raise ValueError(f"no cells for {number}")


def actions(count: int, n: int = 2) -> np.ndarray:
    return np.random.default_rng(1).uniform(-1, 1, (count, n, 4)).astype(np.float32)


def test_the_policys_part_of_the_features_is_what_it_sees_and_the_rest_is_for_the_critic() -> None:
    cells = endless()
    features = cells.reset()
    size = design.contract_for().observation_size
    assert features.shape == (2, size + PRIVILEGED_SIZE) == (cells.n, cells.feature_size)
    again = Insertions(design.contract_for(max_steps=4), 2)
    again.reset(np.arange(2), TaskSource().draw(np.random.default_rng(0), 2))
    assert np.array_equal(features[:, :size], again.observation)
    assert np.array_equal(features[:, size:], again.privileged())


def test_an_episode_that_ends_hands_over_its_account() -> None:
    cells = endless()
    cells.reset()
    earned = np.zeros(2)
    for action in actions(3):
        step = cells.step(action)
        earned += step.reward
        assert not step.done.any()
        assert len(step.ended) == 0
    step = cells.step(actions(1)[0])
    earned += step.reward
    assert step.done.all()
    assert step.ended.steps.tolist() == [4, 4]
    np.testing.assert_allclose(step.ended.episode_return, earned, rtol=1e-5)
    assert not step.ended.success.any()
    assert not step.ended.fault.any()
    assert (step.ended.peak_force > 0).all()


def test_the_features_after_an_end_are_the_first_of_the_next_episode() -> None:
    cells = endless(seed=3)
    cells.reset()
    for action in actions(4):
        step = cells.step(action)
    draw = np.random.default_rng(3)
    TaskSource().draw(draw, 2)
    fresh = Insertions(design.contract_for(max_steps=4), 2)
    fresh.reset(np.arange(2), TaskSource().draw(draw, 2))
    assert np.array_equal(step.features, np.concatenate([fresh.observation, fresh.privileged()], axis=1))


def test_the_same_seed_plays_the_same_and_another_another() -> None:
    assert np.array_equal(endless(seed=1).reset(), endless(seed=1).reset())
    assert not np.array_equal(endless(seed=1).reset(), endless(seed=2).reset())


def test_accounts_of_episodes_are_joined_in_order() -> None:
    first, second = (
        Ended(
            np.array([True]), np.array([False]), np.array([number]), np.array([1.0 * number]), np.array([2.0 * number])
        )
        for number in (1, 2)
    )
    both = Ended.joined([first, second])
    assert both.steps.tolist() == [1, 2]
    assert both.latest(1).episode_return.tolist() == [4.0]


def test_workers_in_their_own_processes_play_what_their_cells_play_here_and_do_jobs_between() -> None:
    here = [endless(seed) for seed in (7, 8)]
    there = ParallelInsertions(partial(worker, [7, 8]), 2)
    try:
        assert there.n == 4
        assert np.array_equal(there.reset(), np.concatenate([cells.reset() for cells in here]))
        for number, action in enumerate(actions(5, 4)):
            if number == 2:
                assert there.run([partial(int, text) for text in ("3", "4", "5")]) == [3, 4, 5]
                own, one, other = there.run([os.getpid] * 3)
                assert own == other != one
            step = there.step(action)
            mine = [cells.step(share) for cells, share in zip(here, np.split(action, 2), strict=True)]
            for name in ("features", "reward", "done"):
                assert np.array_equal(getattr(step, name), np.concatenate([getattr(one, name) for one in mine]))
            assert step.ended.steps.tolist() == Ended.joined([one.ended for one in mine]).steps.tolist()
        with pytest.raises(WorkerError, match=r"worker 1: ValueError: .*'seven'"):
            there.run([partial(int, "6"), partial(int, "seven")])
        assert there.step(action).features.shape == (4, there.feature_size)
    finally:
        there.close()
    there.close()


def test_a_worker_that_is_killed_is_an_error_that_names_it() -> None:
    cells = ParallelInsertions(partial(worker, [7, 8]), 2)
    try:
        cells.reset()
        _, second = cells.run([os.getpid] * 2)
        os.kill(second, signal.SIGKILL)
        with pytest.raises(WorkerError, match="worker 1 has ended"):
            cells.step(actions(1, 4)[0])
    finally:
        cells.close()


def test_cells_that_cannot_be_made_are_an_error_that_says_why() -> None:
    with pytest.raises(WorkerError, match="worker 0: ValueError: no cells for 0"):
        ParallelInsertions(broken, 1)
