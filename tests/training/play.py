"""Ways to act on insertions in tests: at random, with what only the simulation knows, and around the block."""

from typing import Any

import numpy as np

from training.environment import design
from training.environment.insertion import Insertions, Outcome
from wire import pose
from wire.arrays import FloatArray

SHORT = design.contract_for(max_steps=30, name="untrained")
"""A contract for all frames at once, with short episodes."""
REMEMBERING = design.contract_for(max_steps=30, name="remembering", hidden_size=32)
"""The same for one frame at a time."""


def random_actions(steps: int, shape: tuple[int, ...], seed: int = 0) -> FloatArray:
    return np.random.default_rng(seed).uniform(-1, 1, (steps, *shape))


def unit(cells: Insertions, displacement: FloatArray) -> FloatArray:
    """The action (n, 4) that asks for `displacement` (n, 4), base frame: m and rad; lateral and yaw are squared."""
    yaw = pose.yaw_of(cells.world.rotation)
    limit = np.array([entry.limit for entry in cells.contract.action])
    squared = np.array([entry.map == "signed_square" for entry in cells.contract.action])
    cosine, sine = np.cos(yaw), np.sin(yaw)
    x, y = displacement[:, 0], displacement[:, 1]
    in_tool = displacement.copy()
    in_tool[:, 0], in_tool[:, 1] = cosine * x + sine * y, cosine * y - sine * x
    share = np.clip(in_tool / limit, -1, 1)
    return np.where(squared, np.sign(share) * np.sqrt(np.abs(share)), share)


def towards_hole(cells: Insertions) -> FloatArray:
    """Knows the hole's pose: moves the peg's axis over it and turns the peg to match."""
    world = cells.world
    offset, turn = world.offset, world.hole_yaw
    cosine, sine = np.cos(turn), np.sin(turn)
    order = world.symmetry_order
    error = np.asarray(pose.yaw_of(world.rotation)) - turn
    error = (np.remainder(error * order + np.pi, 2 * np.pi) - np.pi) / order
    displacement = np.zeros((cells.n, 4))
    displacement[:, 0] = -(cosine * offset[:, 0] - sine * offset[:, 1])
    displacement[:, 1] = -(sine * offset[:, 0] + cosine * offset[:, 1])
    displacement[:, 3] = -error
    return unit(cells, displacement)


def play_towards_hole(cells: Insertions, steps: int = 110) -> Outcome:
    for _ in range(steps):
        outcome = cells.step(towards_hole(cells))
        if (outcome.terminated | outcome.truncated).all():
            return outcome
    return outcome


def facts(outcome: Outcome) -> dict[str, Any]:
    return {name: getattr(outcome, name) for name in outcome.__slots__}
