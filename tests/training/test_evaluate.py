from pathlib import Path

import pytest

from service.policy.model import Policy
from training.episodes import FIRST_TRAINING_SEED
from training.evaluate import FIRST_TEST_SEED, EpisodeResult, Report, evaluate, wilson


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [
        # from the published formula, worked out by hand or to be found in any table of it
        (0, 10, 0.0, 0.2775),
        (10, 10, 0.7225, 1.0),
        (5, 10, 0.2366, 0.7634),
        (450, 500, 0.8706, 0.9233),
        (1, 1, 0.2065, 1.0),
    ],
)
def test_the_wilson_interval_has_its_known_values(successes: int, trials: int, low: float, high: float) -> None:
    assert wilson(successes, trials) == pytest.approx((low, high), abs=1e-4)


def test_an_interval_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one"):
        wilson(0, 0)


def test_every_seed_is_played_once_by_a_fixed_number_of_episodes_per_cell(model_path: Path) -> None:
    policy = Policy.load(model_path)
    told: list[int] = []
    report = evaluate(policy, 3e-3, 6, cells=3, threads=1, conditions="easy", on_episodes=told.append)
    assert [episode.seed for episode in report.episodes] == list(range(FIRST_TEST_SEED, FIRST_TEST_SEED + 6))
    assert max(episode.seed for episode in report.episodes) < FIRST_TRAINING_SEED
    assert told == [3, 3]
    assert all(1 <= episode.steps <= policy.contract.max_steps for episode in report.episodes)


def test_how_many_cells_play_makes_no_difference_to_any_episode(model_path: Path) -> None:
    policy = Policy.load(model_path)
    together, in_turn = (evaluate(policy, 3e-3, 3, cells=n, threads=1, conditions="easy") for n in (3, 1))
    for one, other in zip(together.episodes, in_turn.episodes, strict=True):
        assert (one.seed, one.success, one.fault, one.steps) == (other.seed, other.success, other.fault, other.steps)
        assert one.peak_force_n == pytest.approx(other.peak_force_n, rel=1e-3)


def test_episodes_that_cannot_be_shared_out_evenly_are_refused(model_path: Path) -> None:
    with pytest.raises(ValueError, match="do not divide evenly"):
        evaluate(Policy.load(model_path), 2e-3, 5, cells=3)


def test_a_report_sums_up_its_episodes() -> None:
    episodes = tuple(
        EpisodeResult(
            seed, success=seed < 3, fault=seed == 3, steps=10 * seed, peak_force_n=float(seed), episode_return=0
        )
        for seed in range(5)
    )
    report = Report(1e-3, "standard", episodes)
    assert (report.successes, report.rate, report.interval) == (3, 0.6, wilson(3, 5))
    figure = report.figure()
    assert (figure.episodes, figure.successes, figure.peak_force_median_n, figure.peak_force_max_n) == (5, 3, 2.0, 4.0)
    assert report.line().startswith("| 1.00 | standard | 3/5 = 60.0% (")
    assert report.line().endswith("| 1 |")
