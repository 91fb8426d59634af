"""Rewards of an insertion step, for any batch shape. Lengths in m, angles in rad, forces in N.

`paper` is equations 1 and 2 of the paper. `potential` is the reward of the shipped models. It rewards the change of a
potential, so that no state pays by itself and hovering half inserted earns nothing.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from wire.arrays import BoolArray, FloatArray

RewardName = Literal["potential", "paper"]

PAPER_ALPHA = (2.3, 2.3, 1.23, 2.0, 0.5)
PAPER_DELTA_M = (1e-4, 0.01)
PAPER_SCALE = 1.0
"""This project's scale of equation 1, with lengths in m: 110 steps spent 30 mm away cost 5, the lower end of the
paper's range."""

OFFSET_SCALE_M = 5e-3
YAW_SCALE_RAD = 0.5
HEIGHT_SCALE_M = 10e-3
STEP_COST = 0.01
SUCCESS_BONUS = 10.0
FAULT_COST = 2.0
FORCE_FREE_N = 12.0
"""Peak force that costs nothing, N. The lock's regular press of 9 N reads up to this much with the sensor's noise."""
FORCE_COST_PER_N = 0.2


@dataclass(frozen=True, slots=True)
class Situation:
    """State after a step that a reward judges; every field has the batch shape (...).

    Attributes:
        offset: (..., 2) position of the peg's axis relative to the hole's, hole frame.
        yaw_error: angle from the nearest matching yaw.
        depth: depth of the peg's bottom below the mouth, negative above it.
        peak_force: largest resultant of the episode so far.
        success: the peg is inside the hole at the goal depth, which is deeper than the depth that counts as success.
        fault: the force ceiling or the arm stopped the episode.
    """

    offset: FloatArray
    yaw_error: FloatArray
    depth: FloatArray
    peak_force: FloatArray
    success: BoolArray
    fault: BoolArray


def potential(situation: Situation, goal_depth_m: float, force_cost_per_n: float = FORCE_COST_PER_N) -> FloatArray:
    """Return minus the distances to the goal, in units of their scales, minus the cost of the peak force.

    The result is (...), at most zero. The peak is the episode's, so its cost is paid once: a force that was reached
    before costs nothing again. A cost in every step would charge each press of a search, and the policy would learn to
    give up and hover.
    """
    distance = np.sqrt((situation.offset**2).sum(-1))
    height = np.maximum(goal_depth_m - situation.depth, 0.0)
    strain = force_cost_per_n * np.maximum(situation.peak_force - FORCE_FREE_N, 0.0)
    return -(distance / OFFSET_SCALE_M + np.abs(situation.yaw_error) / YAW_SCALE_RAD + height / HEIGHT_SCALE_M + strain)


def potential_reward(before: FloatArray, after: FloatArray, situation: Situation) -> FloatArray:
    """Return the change of the potential, minus a cost per step, plus a bonus at the goal depth, minus a fault's cost.

    The change is not discounted: with a negative potential, a discount would pay for standing still.
    """
    return (after - before) - STEP_COST + SUCCESS_BONUS * situation.success - FAULT_COST * situation.fault


def paper_reward(situation: Situation) -> FloatArray:
    """Return equations 1 and 2 times `PAPER_SCALE`, with the root read as a distance to be kept small."""
    a1, a2, a3, a4, a5 = PAPER_ALPHA
    x, y = situation.offset[..., 0], situation.offset[..., 1]
    distance = np.sqrt(x**2 + y**2 + situation.depth**2)
    weighted = np.sqrt(a1 * x**2 + a2 * y**2 + a3 * situation.depth**2)
    inserted = np.where(distance < PAPER_DELTA_M[1], situation.depth, 0.0)
    return PAPER_SCALE * (-weighted + a4 * (distance < PAPER_DELTA_M[0]) + a5 * inserted)
