"""A policy step in one call of MuJoCo is the same as tick by tick, with resets in between."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sim_backend.world import engine
from tests.sim_backend.world.compiled.twins import assert_equal, needs_the_extension, of_world
from tests.sim_backend.world.plants import EVERY
from tests.training.play import facts, random_actions
from training.environment import design
from training.environment.episodes import TaskSource
from training.environment.insertion import Insertions
from wire.arrays import FloatArray

pytestmark = needs_the_extension


def play(n: int, steps: int) -> int:
    """Play the same in both ways, comparing every array after every step; return the number of episodes that ended."""
    assert engine.obstacle() == ""
    rng, source, ended = np.random.default_rng(n), TaskSource(), 0
    both = [Insertions(design.contract_for(), n, threads=2, slips=0.5, misreads=0.5) for _ in range(2)]
    both[1].world._together = None
    first = [replace(task, plant=EVERY if i % 2 else None) for i, task in enumerate(source.draw(rng, n))]
    for cells in both:
        cells.reset(np.arange(n), first)
    for number, actions in enumerate(random_actions(steps, (n, 4), seed=n)):
        actions[:, 2] = actions[:, 2] - 0.3  # they get there
        outcomes = [cells.step(np.clip(actions, -1.0, 1.0)) for cells in both]
        assert_equal(*map(facts, outcomes), f"step {number} of {n} cells")  # type: ignore[arg-type]
        assert_equal(*(of_world(cells.world) for cells in both), f"step {number} of {n} cells")
        assert np.array_equal(*(cells.world._batch.state for cells in both))
        assert np.array_equal(*(cells._window for cells in both))
        over = np.flatnonzero(outcomes[0].terminated | outcomes[0].truncated | (rng.uniform(size=n) < 0.02))
        if over.size:
            tasks = [replace(task, plant=EVERY if task.seed % 3 else None) for task in source.draw(rng, over.size)]
            assert np.array_equal(*(cells.reset(over, tasks) for cells in both))
            ended += over.size
    return ended


@pytest.mark.parametrize(("n", "steps"), [(1, 150), (7, 60), (64, 8), (256, 3)])
def test_every_array_is_the_same_after_every_step(n: int, steps: int) -> None:
    assert play(n, steps) > 0


@pytest.mark.nightly
@pytest.mark.timeout(7200)
@pytest.mark.parametrize(("n", "steps"), [(1, 20_000), (7, 5000), (64, 1000), (256, 300)])
def test_every_array_is_the_same_after_every_one_of_thousands_of_steps(n: int, steps: int) -> None:
    assert play(n, steps) > n


def test_a_reset_looks_at_its_own_cells_only(monkeypatch: pytest.MonkeyPatch) -> None:
    cells = Insertions(design.contract_for(), 5)
    source, rng = TaskSource(), np.random.default_rng(0)
    cells.reset(np.arange(5), source.draw(rng, 5))
    shown = cells.step(np.zeros((5, 4))).observation
    before, sizes = shown.copy(), []
    observe = cells._policy_step.observe

    def observed(state: Any, seen: Any) -> tuple[Any, FloatArray]:
        sizes.append(len(seen.position))
        return observe(state, seen)

    monkeypatch.setattr(cells._policy_step, "observe", observed)
    monkeypatch.setattr(cells.world._batch, "step", lambda **_: pytest.fail("a reset makes no tick"))
    after = cells.reset(np.array([1, 3]), source.draw(rng, 2))
    assert sizes == [2]
    assert np.array_equal(shown, before)  # what was handed out stays
    assert np.flatnonzero((after != before).any(1)).tolist() == [1, 3]
