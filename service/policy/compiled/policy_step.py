"""Chooses between the compiled policy step and the one of numpy."""

from dataclasses import asdict
from typing import Any

import numpy as np
import numpy.typing as npt

from service.policy import compiled
from service.policy.compiled import Step
from service.policy.contract import PolicyContract
from service.policy.observation import ObservationState, uses_estimate
from service.policy.step import Decision, PolicyStep, Seen, StepState
from service.safety import bounds, dsl
from wire import extension
from wire.arrays import Float32Array
from wire.modes import LockMode


def policy_step(contract: PolicyContract, limits: bounds.BoundsParameters) -> PolicyStep:
    """Return the policy step under one contract: compiled where that is built and knows every entry of the contract.

    Args:
        contract: contract of the policy.
        limits: bounds on every command.
    """
    step = compiled.step
    if step is None or any(entry.name not in step.ENTRIES for entry in contract.observation):
        return PolicyStep(contract, limits)
    return CompiledStep(contract, limits, step)


class CompiledStep(PolicyStep):
    """The policy step, compiled. `PolicyStep` is its specification; both give the same numbers.

    Args:
        contract: contract of the policy; the extension knows all of its entries.
        limits: bounds on every command.
        step: the extension.
    """

    def __init__(self, contract: PolicyContract, limits: bounds.BoundsParameters, step: Step) -> None:
        super().__init__(contract, limits)
        names = list(step.ENTRIES)
        self._step = step
        self._entries = np.array([names.index(entry.name) for entry in contract.observation])
        self._columns = self.builder.columns
        self._constants = np.concatenate(
            [
                extension.constants(step.LOCK_CONSTANTS, _of_lock(contract.dsl)),
                extension.constants(step.BOUNDS_CONSTANTS, asdict(limits)),
                extension.constants(step.ACTION_CONSTANTS, self.actions.constants()),
                extension.constants(step.OBSERVATION_CONSTANTS, _of_observation(contract)),
            ]
        )

    def observe(self, state: StepState, seen: Seen) -> tuple[StepState, Float32Array]:
        lock, memory = state.lock, state.memory
        frames, (hole_mean, hole_count, steps), observation = self._step.observe(
            self._constants,
            self._entries,
            self._columns,
            (
                *(seen.position, seen.yaw, seen.tilt, seen.hole_estimate, seen.nominal_hole),
                *(state.target_position, state.target_yaw, seen.start_yaw),
                *(lock.z_lock, lock.z_contact0, lock.phase, state.previous_action, seen.last_joint),
            ),
            seen.wrench_window,
            (memory.hole_mean, memory.hole_count, memory.steps),
            memory.frames,
        )
        after = ObservationState(frames, hole_mean, hole_count, steps)
        return StepState(lock, after, state.target_position, state.target_yaw, state.previous_action), observation

    def act(self, state: StepState, seen: Seen, action: npt.ArrayLike) -> tuple[StepState, Decision]:
        lock = state.lock
        (displacement, unit), after, locked, bounded = self._step.act(
            self._constants,
            (
                *(seen.position, seen.yaw, seen.tilt, lock.z_floor, state.target_position, state.target_yaw),
                np.asarray(action, np.float64),
            ),
            seen.wrench_window,
            (
                *(lock.phase, lock.z_lock, lock.z_contact0, lock.previous_n, lock.previous_position),
                *(lock.fresh, lock.seek_start_z, lock.seek_steps),
            ),
        )
        decision = Decision(displacement, dsl.DslOutput(*locked), bounds.BoundedCommand(*bounded))
        next_lock = dsl.DslState(*after, z_floor=lock.z_floor)
        return StepState(next_lock, state.memory, decision.bounded.position, decision.bounded.yaw, unit), decision


def _of_lock(parameters: dsl.DslParameters) -> dict[str, Any]:
    release = parameters.release_threshold
    return asdict(parameters) | {
        "mode": LockMode.__args__.index(parameters.mode),
        "clip": [parameters.force_clip_n] * 3 + [parameters.torque_clip_nm] * 3,
        "release_threshold": parameters.contact_threshold if release is None else release,
    }


def _of_observation(contract: PolicyContract) -> dict[str, npt.ArrayLike]:
    return {
        "uses_nominal": not uses_estimate(contract.mode),
        "feels_nothing": contract.mode == "VM",
        "max_steps": contract.max_steps,
        "window_samples": contract.wrench_window_ticks,
        "wrench_clip": [contract.dsl.force_clip_n] * 3 + [contract.dsl.torque_clip_nm] * 3,
    }
