import numpy as np

from training.environment.episodes import FIRST_TRAINING_SEED, TaskSource
from training.evaluation.evaluate import FIRST_TEST_SEED


def test_no_training_seed_is_ever_a_test_seed() -> None:
    tasks = TaskSource().draw(np.random.default_rng(0), 5000)
    assert min(task.seed for task in tasks) >= FIRST_TRAINING_SEED > FIRST_TEST_SEED + 10**6
    assert len({task.seed for task in tasks}) == len(tasks)


def test_clearances_fill_their_range_and_favour_the_tight_end() -> None:
    clearances = np.array(
        [task.clearance_m for task in TaskSource(clearance_m=(1e-3, 2e-3)).draw(np.random.default_rng(0), 5000)]
    )
    assert clearances.min() >= 1e-3
    assert clearances.max() <= 2e-3
    assert (clearances < 1.5e-3).mean() > 0.55


def test_the_same_generator_draws_the_same_tasks_and_the_source_sets_the_rest() -> None:
    source = TaskSource("cir", (1e-3, 1e-3), "easy", False)
    first, again = (source.draw(np.random.default_rng(7), 3) for _ in range(2))
    assert first == again
    assert {(t.part, t.clearance_m, t.conditions, t.randomise_plant) for t in first} == {("cir", 1e-3, "easy", False)}
