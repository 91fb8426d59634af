"""No shortcut for a policy: a success is a peg in the hole, found by what a cell measures, on seeds of its own."""

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.policy.model import Policy
from service.policy.step import Seen
from service.safety.pose import wrap
from sim_backend.world import world as world_module
from sim_backend.world.parts import HOLE_DEPTH_M, PARTS, contained, hole_walls, wall_centres
from sim_backend.world.scene import WALL_HALF_LENGTH_M, WALL_HALF_THICKNESS_M
from sim_backend.world.world import World
from tests.training.play import random_actions, unit
from training.environment import design
from training.environment.episodes import FIRST_TRAINING_SEED, TaskSource
from training.environment.insertion import GOAL_DEPTH_M, LIMITS, SUCCESS_DEPTH_M, Insertions
from training.evaluation.evaluate import FIRST_TEST_SEED, evaluate, play
from training.learning.experiment import load, names
from training.learning.validation import FIRST_VALIDATION_SEED
from wire import pose
from wire.task import Part, Task

SEARCH = Policy.load(Path(__file__).parents[3] / "models" / "scripted-search.onnx")
TESTED_AT_MOST = 100_000
"""Seeds that any test of ours will ever use, at most."""


# --- success is a peg in the hole


@pytest.mark.parametrize("part", ["tr", "rtr", "b-trm"])
def test_what_counts_as_a_success_is_a_whole_peg_inside_the_hole_and_it_stays_there(part: Part) -> None:
    clearance, n = 1.5e-3, 10
    cells = Insertions(SEARCH.contract, n, part)
    played = play(SEARCH, cells, [Task(500_000 + i, part, clearance, "easy") for i in range(n)])
    won = np.flatnonzero([episode.success for episode in played])
    assert len(won) >= 3
    world = cells.world
    assert (world.depth[won] > SUCCESS_DEPTH_M).all()
    yaw = np.asarray(pose.yaw_of(world.rotation)) - world.hole_yaw
    order = PARTS[part].symmetry_order
    nearest = np.asarray(wrap(yaw * order)) / order
    # the walls give by a few hundredths under load, and a tilted peg is not upright in the outline
    assert contained(PARTS[part], clearance + 0.15e-3, world.offset[won], nearest[won]).all()
    lost = np.setdiff1d(np.arange(n), won)
    assert not (
        (world.depth[lost] > GOAL_DEPTH_M) & world.contained[lost] & ~np.array([p.fault for p in played])[lost]
    ).any()


@pytest.mark.parametrize("part", sorted(PARTS))
@pytest.mark.parametrize("clearance", [0.05e-3, 6e-3])
def test_around_the_hole_the_block_is_closed(part: Part, clearance: float) -> None:
    """No gap between two slabs that a peg could drop into: everything within 10 cm is hole or wall."""
    walls, shape = hole_walls(PARTS[part], clearance), PARTS[part]
    centres = wall_centres(shape, clearance, WALL_HALF_THICKNESS_M)
    bearing, radius = np.meshgrid(np.linspace(0, 2 * np.pi, 721), np.linspace(0, 0.1, 201))
    places = np.stack([radius * np.cos(bearing), radius * np.sin(bearing)], -1).reshape(-1, 1, 2)
    normal = np.stack([np.cos(walls[:, 0]), np.sin(walls[:, 0])], -1)
    along = np.stack([-normal[:, 1], normal[:, 0]], -1)
    in_hole = ((places * normal).sum(-1) <= walls[:, 1]).all(-1)
    delta = places - centres
    slack = 1e-9
    in_slab = (np.abs((delta * normal).sum(-1)) <= WALL_HALF_THICKNESS_M + slack) & (
        np.abs((delta * along).sum(-1)) <= WALL_HALF_LENGTH_M + slack
    )
    assert (in_hole | in_slab.any(-1)).all()
    assert 0 < in_hole.mean() < 0.5


def test_a_peg_that_goes_round_the_block_gets_nowhere_from_the_side() -> None:
    """Twelve ways out: over the block to its edge or that of the workspace, down, and back towards the hole."""
    n, steps = 12, 100
    contract = design.contract_for(lock="off", max_steps=steps)
    hasty = tuple(entry.model_copy(update={"limit": 9e-3}) if entry.unit == "m" else entry for entry in contract.action)
    cells = Insertions(contract.model_copy(update={"action": hasty}), n, force_ceiling_n=50.0)
    cells.reset(np.arange(n), [Task(21, "tr", 2e-3, "easy")] * n)
    world = cells.world
    bearings = np.linspace(0, 2 * np.pi, n, endpoint=False)
    hole = world.hole_position[0]
    lower, upper = np.array(LIMITS.workspace)
    out = np.clip(
        hole[:2] + 0.2 * np.column_stack([np.cos(bearings), np.sin(bearings)]), lower[:2] + 2e-3, upper[:2] - 2e-3
    )
    deepest, ever = np.full(n, -np.inf), np.zeros(n, np.bool_)
    for step in range(steps):
        move = np.zeros((n, 4))
        if step < 40:
            move[:, :2] = out - world.position[:, :2]
        elif step < 60:
            move[:, 2] = -1.0
        else:
            move[:, :2] = hole[:2] - world.position[:, :2]
        outcome = cells.step(unit(cells, move))
        deepest = np.maximum(deepest, outcome.depth)
        ever |= outcome.success
    assert (deepest > 2 * GOAL_DEPTH_M).sum() >= 6  # they were deep beside the block
    assert not ever.any()
    assert not (world.contained & (outcome.depth > 0)).any()


def test_a_peg_beneath_the_block_is_not_in_the_hole() -> None:
    world = World(2)
    world.reset(np.arange(2), [Task(0), Task(0)])
    below = world.hole_position - [[0, 0, 0.010], [0, 0, HOLE_DEPTH_M + 0.025]]
    world.place(np.arange(2), below, np.zeros(2))
    assert (world.depth > SUCCESS_DEPTH_M).all()
    assert world.contained.tolist() == [True, False]


# --- what is seen is what a cell measures


class Measured:
    """A world of which only what a deployed cell measures can be read."""

    NAMES = frozenset({"position", "rotation", "joints", "estimate"})

    def __init__(self, world: world_module.World) -> None:
        self._world = world

    def __getattr__(self, name: str) -> Any:
        assert name in self.NAMES, f"{name} is not measured"
        return getattr(self._world, name)


@pytest.mark.parametrize("mode", ["VFTM", "FTM", "VM"])
def test_an_observation_is_made_of_what_a_cell_measures_and_of_nothing_else(mode: Any) -> None:
    cells = Insertions(design.contract_for(mode), 2)
    cells.reset(np.arange(2), [Task(seed, conditions="search") for seed in (5, 6)])
    for action in random_actions(14, (2, cells.action_size)):
        cells.step(action)
    world, whole = cells.world, cells._see()
    cells.world = Measured(world)  # type: ignore[assignment]
    bare = cells._see()
    for field in fields(Seen):
        assert np.array_equal(getattr(whole, field.name), getattr(bare, field.name), equal_nan=True)
    with pytest.raises(AssertionError, match="is not measured"):
        cells.privileged()


@pytest.mark.parametrize("mode", ["VFTM", "FTM", "VM"])
@pytest.mark.parametrize(
    "unknown", ["hole_yaw", "friction", "clearance", "hole_height"], ids=lambda name: f"whatever the {name}"
)
def test_before_contact_what_is_seen_is_the_same(mode: Any, unknown: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def seen(task: Task) -> np.ndarray[Any, Any]:
        cells = Insertions(design.contract_for(mode), 1)
        first = cells.reset(np.arange(1), [task]).copy()
        return np.array([first, *(cells.step(action).observation for action in random_actions(3, (1, 4)))])

    task = Task(31, "tr", 2e-3, "easy")
    before = seen(task)
    drawn = world_module.draw

    def other(task: Task) -> Any:
        episode = drawn(task)
        if unknown == "hole_height":  # the camera sees the same
            shift = np.array([0.0, 0.0, 4e-3])
            return replace(
                episode,
                hole_position=episode.hole_position + shift,
                estimate_offset=episode.estimate_offset - shift,
            )
        return replace(episode, **{unknown: getattr(episode, unknown) + 0.2}) if unknown != "clearance" else episode

    monkeypatch.setattr(world_module, "draw", other)
    after = seen(replace(task, clearance_m=0.5e-3) if unknown == "clearance" else task)
    assert np.allclose(before, after, rtol=0, atol=1e-6)


# --- what is tested has never been trained on


def test_no_seed_serves_two_purposes() -> None:
    assert FIRST_VALIDATION_SEED < FIRST_TEST_SEED < FIRST_TEST_SEED + TESTED_AT_MOST < FIRST_TRAINING_SEED
    longest = max(load(name).evaluation.episodes for name in names())
    assert FIRST_VALIDATION_SEED + longest <= FIRST_TEST_SEED
    drawn = [
        task.seed for seed in (0, 500_000, 2_000_000) for task in TaskSource().draw(np.random.default_rng(seed), 500)
    ]
    assert min(drawn) >= FIRST_TRAINING_SEED
    assert len(set(drawn)) == len(drawn)


@pytest.mark.parametrize("seed", [0, 500_000, 2_000_000])
def test_whatever_seed_gymnasium_hands_it_an_environment_draws_worlds_of_the_training(seed: int) -> None:
    gymnasium = pytest.importorskip("gymnasium", reason="needs the extra `training`")
    environment = gymnasium.make("dsl_assembly/PegInHole-v0", max_episode_steps=1)
    for _ in range(3):
        _, info = environment.reset(seed=seed)
        assert info["world_seed"] >= FIRST_TRAINING_SEED
        seed = None  # type: ignore[assignment]


def test_different_seeds_are_different_worlds() -> None:
    worlds = [world_module.draw(Task(seed)) for seed in (*range(500_000, 500_100), *range(2_000_000, 2_000_100))]
    assert len({tuple(world.hole_position) for world in worlds}) == len(worlds)


# --- an evaluation counts every episode once


def test_every_cell_of_an_evaluation_plays_the_same_number_whatever_becomes_of_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    begun: list[tuple[int, int]] = []
    reset = Insertions.reset

    def counted(self: Insertions, cells: Any, tasks: Any) -> Any:
        begun.extend((int(cell), task.seed) for cell, task in zip(cells, tasks, strict=True))
        return reset(self, cells, tasks)

    monkeypatch.setattr(Insertions, "reset", counted)
    block = evaluate(SEARCH, 3e-3, 12, conditions="easy", cells=4, threads=1)
    lengths = [episode.steps for episode in block.episodes]
    assert max(lengths) > 1.3 * min(lengths)  # a window of time would have played some cells more often
    assert np.bincount([cell for cell, _ in begun]).tolist() == [3, 3, 3, 3]
    assert sorted(seed for _, seed in begun) == list(range(FIRST_TEST_SEED, FIRST_TEST_SEED + 12))
    assert [episode.seed for episode in block.episodes] == list(range(FIRST_TEST_SEED, FIRST_TEST_SEED + 12))


def test_an_evaluation_is_deterministic() -> None:
    one, again = (evaluate(SEARCH, 2e-3, 4, conditions="easy", cells=4, threads=1).episodes for _ in range(2))
    assert one == again
