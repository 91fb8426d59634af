"""A batch of n peg insertions that run as in the deployed cell: same world, observation, action, lock and bounds.

This module depends on no framework. `peg_in_hole` wraps it for Gymnasium, `vector` plays endless episodes on it for
training, and `training.evaluation.evaluate` plays whole episodes on it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from service.policy.compiled import rotvec_from_yaw, yaw_and_tilt
from service.policy.compiled.policy_step import policy_step
from service.policy.contract import PolicyContract
from service.policy.step import Seen, StepState, command_bounds
from service.safety.pose import rotate, wrap
from sim_backend.world import quaternion
from sim_backend.world.scene import NOMINAL_HOLE_M
from sim_backend.world.world import START_YAW_RAD, World
from training.environment import reward
from training.environment.reward import RewardName, Situation
from wire import pose
from wire.arrays import BoolArray, CellIndices, Float32Array, FloatArray, IntArray
from wire.law import ControlLimits
from wire.limits import FORCE_CEILING_N, TILT_RAD, TORQUE_CEILING_NM, WORKSPACE_M
from wire.plant import PlantErrors
from wire.records import Program
from wire.task import Part, Task

SUCCESS_DEPTH_M = 2.5e-3
"""Depth of the peg's bottom below the hole's mouth that counts as success, m: the paper's criterion."""
GOAL_DEPTH_M = 4.0e-3
"""Depth that ends an episode, m. It exceeds the deployed cell's criterion, so that training covers that depth."""
PRIVILEGED_SIZE = 10
AIM = slice(2, 6)
"""Columns of `Insertions.privileged` that tell how the peg must move to be right above the hole."""
SLIP_STEPS = (0, 75)
"""Range of policy steps in which a hole slips, if slips are enabled. A slip before the first contact acts like a larger
error of the camera."""
SLIP_SIGMA_M = 1.5e-3
SLIP_YAW_RAD = float(np.deg2rad(60))
SLIP_DEPTH_M = 1e-4
"""A hole slips only while the peg is in it by less than this, m."""
LIMITS = ControlLimits(WORKSPACE_M, FORCE_CEILING_N)
_ALL = slice(None)
_SEEN_ANEW = ("position", "yaw", "tilt", "hole_estimate", "last_joint")
"""Fields of `Seen` that the beginning of an episode changes; the window is one array."""

Rows = TypeVar("Rows")


@dataclass(frozen=True, slots=True)
class Outcome:
    """One step of every cell; arrays (n,) unless said otherwise.

    Attributes:
        observation: (n, size) float32, raw units, after the step.
        reward: reward of this step.
        terminated: the episode ended by insertion or by a fault.
        truncated: the episode reached its last step.
        success: the episode ended with the peg `SUCCESS_DEPTH_M` below the mouth and its axis inside the hole.
        fault: a ceiling of force or torque, the limit of the tilt, or the arm's controller stopped the episode.
        peak_force: largest resultant of the episode so far, over every sample, N.
        depth: depth of the peg's bottom below the mouth, m; negative above it.
        z_lock: height of the lock, m; NaN without a lock.
        phase: `Phase` of the lock.
        clamped: a command bound changed the command.
    """

    observation: Float32Array
    reward: FloatArray
    terminated: BoolArray
    truncated: BoolArray
    success: BoolArray
    fault: BoolArray
    peak_force: FloatArray
    depth: FloatArray
    z_lock: FloatArray
    phase: IntArray
    clamped: BoolArray


class Insertions:
    """n cells under one contract.

    Args:
        contract: observation, action and lock of the policy.
        n: number of cells.
        part: peg and hole of all cells.
        threads: number of threads that step the physics.
        force_ceiling_n: resultant force at which the cell stops, N.
        reward_name: name of the reward.
        force_cost_per_n: cost in the reward `potential`, per N of the episode's peak above `reward.FORCE_FREE_N`.
        slips: share of the episodes in which the hole slips once to another place and yaw; for training.
        misreads: share of the episodes in which the observed torque about z is multiplied by a factor within ±1; for
            training. It keeps a policy from relying on the torques of one peg, which mislead it with another peg.
        plant: errors of the plants, for the shape of their pegs; the tasks name all of them.
    """

    def __init__(
        self,
        contract: PolicyContract,
        n: int,
        part: Part = "tr",
        threads: int = 1,
        force_ceiling_n: float = FORCE_CEILING_N,
        reward_name: RewardName = "potential",
        force_cost_per_n: float = reward.FORCE_COST_PER_N,
        slips: float = 0.0,
        misreads: float = 0.0,
        plant: PlantErrors | None = None,
    ) -> None:
        self.contract = contract
        self.n = n
        self.world = World(n, part, threads, plant)
        self._reward_name = reward_name
        self._force_cost_per_n = force_cost_per_n
        self._slips = slips
        self._slip_at = np.full(n, -1)
        self._slip = np.zeros((n, 3))
        self._misreads = misreads
        self._torque_read = np.ones(n)
        self._limits = ControlLimits(WORKSPACE_M, force_ceiling_n)
        law = contract.compliance
        self._law = np.array(law.stiffness), np.array(law.damping), np.array(law.inertia)
        limits = command_bounds(self._limits, contract.period_s, START_YAW_RAD, tilt_rad=TILT_RAD)
        self._policy_step = policy_step(contract, limits)
        self._state = self._policy_step.begin(np.zeros((n, 3)), np.zeros(n))
        self._window = np.zeros((contract.ticks_per_step, n, 6))
        self._potential = np.zeros(n)
        self._nominal = np.broadcast_to(np.array(NOMINAL_HOLE_M), (n, 3))
        self._start_yaw = np.full(n, START_YAW_RAD)
        self.steps = np.zeros(n, np.int64)
        self.peak_force = np.zeros(n)
        self.observation = np.zeros((n, self._policy_step.observation_size), np.float32)
        self._seen = self._see()

    @property
    def observation_size(self) -> int:
        return self._policy_step.observation_size

    @property
    def action_size(self) -> int:
        return self._policy_step.actions.size

    @property
    def target_position(self) -> FloatArray:
        """(n, 3) m, the command in force."""
        return self._state.target_position

    @property
    def target_yaw(self) -> FloatArray:
        """(n,) rad, the command in force."""
        return self._state.target_yaw

    def reset(self, cells: CellIndices, tasks: Sequence[Task]) -> Float32Array:
        """Begin new episodes in `cells` (k,), at the end of the scripted approach.

        The peg hovers above the camera's estimate of the hole, in mode FTM above the nominal centre. The sensor is
        zeroed and the arm engaged.

        Returns:
            (n, size) observations; rows of other cells are unchanged.
        """
        world = self.world
        world.lay_out(cells, tasks)
        self._mislead(cells, tasks)
        known = world.camera(cells) if self.contract.uses_estimate else self._nominal[cells]
        hover = known + np.column_stack([np.zeros((len(cells), 2)), world.hover(cells)])
        world.place(cells, hover, self._start_yaw[cells])
        world.zero_ft(cells)
        world.engage(cells, *self._law, self._limits)
        self._window[:, cells] = 0.0  # a deployed cell has noise here; this world cannot sample some cells alone
        self.steps[cells] = 0
        self.peak_force[cells] = 0.0
        self._shape_anew(cells)
        seen = self._see(cells)
        state, observation = self._observed(self._policy_step.begin(seen.position, seen.yaw), seen, cells)
        self._state = _with_rows(self._state, cells, state)
        for name in _SEEN_ANEW:
            getattr(self._seen, name)[cells] = getattr(seen, name)
        self.observation = _with_rows(self.observation, cells, observation)
        return self.observation

    def step(self, action: npt.ArrayLike) -> Outcome:
        """Run one policy step of every cell, ended episodes included; `action` (n, action size) in [-1, 1]."""
        world, contract = self.world, self.contract
        self._slip_holes()
        self._state, decision = self._policy_step.act(self._state, self._seen, np.asarray(action, np.float64))
        locked, bounded = decision.locked, decision.bounded
        turn = quaternion.from_rotvec(rotvec_from_yaw(bounded.yaw))
        everyone = np.arange(self.n)
        world.arm.set_target(everyone, bounded.position, turn)
        world.advance(self._window)
        force = np.sqrt((self._window[..., :3] ** 2).sum(-1)).max(0)
        np.maximum(self.peak_force, force, out=self.peak_force)
        self.steps += 1
        self._seen = self._see()
        self._state, self.observation = self._observed(self._state, self._seen, _ALL)

        torque = np.sqrt((self._window[..., 3:] ** 2).sum(-1)).max(0)
        fault = (world.arm.program != Program.ENGAGED) | bounded.tilt | (torque >= TORQUE_CEILING_NM)
        depth = world.depth
        inside = world.contained & ~fault
        arrived = inside & (depth >= GOAL_DEPTH_M)
        terminated = arrived | fault
        truncated = ~terminated & (self.steps >= contract.max_steps)
        success = inside & (depth >= SUCCESS_DEPTH_M) & (terminated | truncated)
        situation = self._situation(arrived, fault)
        after = reward.potential(situation, GOAL_DEPTH_M, self._force_cost_per_n)
        if self._reward_name == "paper":
            earned = reward.paper_reward(situation)
        else:
            earned = reward.potential_reward(self._potential, after, situation)
        self._potential = after
        return Outcome(
            observation=self.observation,
            reward=earned,
            terminated=terminated,
            truncated=truncated,
            success=success,
            fault=fault,
            peak_force=self.peak_force.copy(),
            depth=depth.copy(),
            z_lock=locked.z_lock,
            phase=locked.phase,
            clamped=bounded.clamped,
        )

    def privileged(self) -> Float32Array:
        """Return (n, PRIVILEGED_SIZE) quantities that only the simulation knows, each about -1 … 1.

        They are for a critic, never for a policy.
        """
        world = self.world
        yaw_error = self._yaw_error()
        order = max(self.world.symmetry_order, 1)
        aim = rotate(world.hole_yaw - np.asarray(pose.yaw_of(world.rotation)), -world.offset)
        return np.column_stack(
            [
                np.clip(world.offset / 0.01, -3, 3),
                np.clip(aim / 5e-3, -3, 3),
                np.sin(order * yaw_error),
                np.cos(order * yaw_error),
                np.clip(world.depth / 0.01, -3, 1),
                world.clearance / 2e-3,
                world.friction,
                self.peak_force / 20.0,
            ]
        ).astype(np.float32)

    def _mislead(self, cells: CellIndices, tasks: Sequence[Task]) -> None:
        """Draw slips and misreadings, which only training uses, from the episodes' seeds."""
        if not (self._slips or self._misreads):
            return
        for cell, task in zip(cells, tasks, strict=True):
            rng = np.random.default_rng([task.seed, 1])
            self._slip_at[cell] = rng.integers(*SLIP_STEPS) if rng.uniform() < self._slips else -1
            self._slip[cell] = *rng.normal(0.0, SLIP_SIGMA_M, 2), rng.uniform(-SLIP_YAW_RAD, SLIP_YAW_RAD)
            self._torque_read[cell] = rng.uniform(-1.0, 1.0) if rng.uniform() < self._misreads else 1.0

    def _slip_holes(self) -> None:
        """Move the holes whose slip is due. The jump in distance earns no reward."""
        due = np.flatnonzero((self._slip_at >= 0) & (self.steps >= self._slip_at) & (self.world.depth < SLIP_DEPTH_M))
        if not due.size:
            return
        self._slip_at[due] = -1
        position = self.world.hole_position[due]
        position[:, :2] += self._slip[due, :2]
        self.world.move_hole(due, position, self._slip[due, 2])
        self._shape_anew(due)

    def _shape_anew(self, cells: CellIndices) -> None:
        """Restart the potential of `cells` at their present state."""
        nobody = np.zeros(self.n, np.bool_)
        now = reward.potential(self._situation(nobody, nobody), GOAL_DEPTH_M, self._force_cost_per_n)
        self._potential[cells] = now[cells]

    def _yaw_error(self) -> FloatArray:
        """Return the (n,) angle from the nearest matching yaw, rad; zero for a round peg."""
        order = self.world.symmetry_order
        if order == 0:
            return np.zeros(self.n)
        error = np.asarray(pose.yaw_of(self.world.rotation)) - self.world.hole_yaw
        return np.asarray(wrap(error * order)) / order

    def _situation(self, success: BoolArray, fault: BoolArray) -> Situation:
        return Situation(self.world.offset, self._yaw_error(), self.world.depth, self.peak_force, success, fault)

    def _observed(self, state: StepState, seen: Seen, cells: CellIndices | slice) -> tuple[StepState, Float32Array]:
        """Return state and observation of `cells` after they have observed."""
        if self._misreads:  # only the policy misreads the torque, the lock does not
            seen = replace(seen, wrench_window=seen.wrench_window.copy())
            seen.wrench_window[..., 5] *= self._torque_read[cells]
        return self._policy_step.observe(state, seen)

    def _see(self, cells: CellIndices | slice = _ALL) -> Seen:
        """Return what is measured in `cells`; of all, the window is the one that the next step writes into."""
        world = self.world
        rotation = world.rotation[cells]
        _, tilt = yaw_and_tilt(pose.rotvec_from_rotation(rotation))
        return Seen(
            position=world.position[cells],
            yaw=np.asarray(pose.yaw_of(rotation)),
            tilt=tilt,
            wrench_window=self._window[:, cells],
            hole_estimate=world.estimate[cells],
            nominal_hole=self._nominal[cells],
            start_yaw=self._start_yaw[cells],
            last_joint=world.joints[cells, 5],
        )


def info_of(outcome: Outcome) -> dict[str, Any]:
    """Return the `info` of a step. `z_lock` is -inf where nothing limits the depth."""
    return {
        "is_success": outcome.success,
        "fault": outcome.fault,
        "peak_force": outcome.peak_force,
        "depth": outcome.depth,
        "z_lock": np.where(np.isnan(outcome.z_lock), -np.inf, outcome.z_lock),
        "phase": outcome.phase,
        "clamped": outcome.clamped,
    }


def _with_rows(whole: Rows, cells: CellIndices, part: Rows) -> Rows:
    """Return a copy of an array (n, …), or of a dataclass of such arrays, with the rows of `cells` (k,) of `part`."""
    if is_dataclass(whole):
        names = [field.name for field in fields(whole)]
        return type(whole)(*(_with_rows(getattr(whole, name), cells, getattr(part, name)) for name in names))
    rows: Any = np.array(whole)
    rows[cells] = part
    return rows
