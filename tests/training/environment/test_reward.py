import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from training.environment import reward
from training.environment.insertion import GOAL_DEPTH_M
from training.environment.reward import Situation


def situation(
    offset: tuple[float, float] = (0.0, 0.0),
    yaw_error: float = 0.0,
    depth: float = 0.0,
    peak_force: float = 0.0,
    success: bool = False,
    fault: bool = False,
) -> Situation:
    return Situation(
        np.array(offset), np.array(yaw_error), np.array(depth), np.array(peak_force), np.array(success), np.array(fault)
    )


def potential(where: Situation, force_cost_per_n: float = reward.FORCE_COST_PER_N) -> np.ndarray:
    return reward.potential(where, GOAL_DEPTH_M, force_cost_per_n)


LENGTH = st.floats(-0.05, 0.05)
PLACES = st.builds(
    situation,
    offset=st.tuples(LENGTH, LENGTH),
    yaw_error=st.floats(-1.1, 1.1),
    depth=st.floats(-0.03, 0.02),
    peak_force=st.floats(0.0, 60.0),
)


@given(place=PLACES)
def test_the_potential_is_highest_at_the_goal(place: Situation) -> None:
    goal = situation(depth=GOAL_DEPTH_M)
    assert potential(place) <= potential(goal) == 0


@pytest.mark.parametrize(
    ("worse", "better"),
    [
        (situation(offset=(3e-3, 0)), situation(offset=(1e-3, 0))),
        (situation(yaw_error=-0.3), situation(yaw_error=0.1)),
        (situation(depth=-5e-3), situation(depth=1e-3)),
    ],
)
def test_coming_nearer_in_any_sense_pays(worse: Situation, better: Situation) -> None:
    assert reward.potential_reward(potential(worse), potential(better), better) > 0
    assert reward.potential_reward(potential(better), potential(worse), worse) < -reward.STEP_COST


@given(place=PLACES)
def test_staying_anywhere_costs(place: Situation) -> None:
    here = potential(place)
    assert reward.potential_reward(here, here, place) <= -reward.STEP_COST


@given(path=st.lists(PLACES, min_size=2, max_size=20))
def test_a_way_back_to_its_beginning_never_pays(path: list[Situation]) -> None:
    path = [*path, path[0]]
    levels = [potential(place) for place in path]
    earned = sum(
        reward.potential_reward(before, after, place)
        for before, after, place in zip(levels[:-1], levels[1:], path[1:], strict=True)
    )
    assert earned <= -reward.STEP_COST * (len(path) - 1) + 1e-9


@given(path=st.lists(PLACES, min_size=2, max_size=20))
def test_the_shaping_of_a_way_depends_on_its_ends_alone(path: list[Situation]) -> None:
    levels = [potential(place) for place in path]
    costs = reward.STEP_COST * (len(path) - 1)
    earned = sum(
        reward.potential_reward(before, after, place)
        for before, after, place in zip(levels[:-1], levels[1:], path[1:], strict=True)
    )
    assert earned == pytest.approx(levels[-1] - levels[0] - costs)


def test_going_in_pays_more_than_any_standstill_and_a_fault_costs() -> None:
    hover, goal = situation(depth=GOAL_DEPTH_M - 1e-4), situation(depth=GOAL_DEPTH_M, success=True)
    assert (
        reward.potential_reward(potential(hover), potential(goal), goal) > reward.SUCCESS_BONUS - 2 * reward.STEP_COST
    )
    stopped = situation(fault=True)
    assert reward.potential_reward(potential(stopped), potential(stopped), stopped) < -reward.FAULT_COST


def test_a_peak_costs_once_and_pressing_on_as_hard_nothing_more() -> None:
    forces = (0.0, reward.FORCE_FREE_N, reward.FORCE_FREE_N + 1, reward.FORCE_FREE_N + 1, reward.FORCE_FREE_N + 11)
    path = [situation(peak_force=force) for force in forces]
    earned = [
        float(reward.potential_reward(potential(before), potential(after), after)) + reward.STEP_COST
        for before, after in itertools.pairwise(path)
    ]
    cost = reward.FORCE_COST_PER_N
    assert earned == pytest.approx([0.0, -cost, 0.0, -10 * cost])
    assert potential(path[2], force_cost_per_n=0.5) == pytest.approx(potential(path[0]) - 0.5)


@pytest.mark.parametrize(
    ("where", "value"),
    [
        # far: -sqrt(2.3 · 25e-6 + 1.23 · 100e-6)
        (situation(offset=(3e-3, 4e-3), depth=-1e-2), -0.0134350),
        # within δ2: -sqrt(1.23) · 5 mm + 0.5 · 5 mm
        (situation(depth=5e-3), -0.0030453),
        # within δ1: -sqrt(2.3 · 25e-10) + 2
        (situation(offset=(3e-5, 4e-5)), 1.9999242),
    ],
)
def test_the_papers_reward_has_the_values_of_its_equations(where: Situation, value: float) -> None:
    assert reward.paper_reward(where) == pytest.approx(value * reward.PAPER_SCALE, abs=1e-7)


@given(place=PLACES)
def test_the_papers_reward_pays_for_nothing_but_the_last_tenth_of_a_millimetre(place: Situation) -> None:
    distance = np.sqrt((place.offset**2).sum() + place.depth**2)
    assert (reward.paper_reward(place) > 0) == (distance < reward.PAPER_DELTA_M[0])


def test_rewards_take_any_batch_shape() -> None:
    zeros, flags = np.zeros((2, 3)), np.zeros((2, 3), bool)
    batch = Situation(np.zeros((2, 3, 2)), zeros, zeros, zeros, flags, flags)
    assert reward.paper_reward(batch).shape == potential(batch).shape == (2, 3)
