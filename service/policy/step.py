"""The policy step: measurement → observation → policy → action → depth lock → command bounds → target.

It works for any batch shape `...`: `()` in a cell, `(n,)` in training. `service.cell.insertion` calls it and adds
stages and faults; `training.environment.insertion` calls it and adds world and reward.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from service.policy.contract import PolicyContract
from service.policy.observation import Measurement, ObservationState
from service.safety import bounds, dsl
from wire.arrays import Float32Array, FloatArray
from wire.law import ControlLimits
from wire.limits import TILT_RAD, YAW_HALF_RANGE_RAD


@dataclass(frozen=True, slots=True)
class Seen:
    """Everything measured at one moment; base frame.

    A step observes and acts on the same instance. Training alone makes an exception: under its setting `misreads` the
    policy observes a falsified copy, and the lock acts on the measurement.

    Attributes:
        position: (..., 3) m, measured TCP.
        yaw: (...) rad, measured.
        tilt: (..., 2) rad, measured, as `service.safety.pose.yaw_and_tilt` gives it.
        wrench_window: (T, ..., 6) N and N·m at the TCP, oldest first: the samples since the last step.
        hole_estimate: (..., 3) m, this camera frame's estimate of the centre of the hole's mouth; NaN without one.
        nominal_hole: (..., 3) m, nominal centre of the hole's mouth, known without a camera.
        start_yaw: (...) rad, yaw at the start of the run.
        last_joint: (...) rad, angle of the last joint.
    """

    position: FloatArray
    yaw: FloatArray
    tilt: FloatArray
    wrench_window: FloatArray
    hole_estimate: FloatArray
    nominal_hole: FloatArray
    start_yaw: FloatArray
    last_joint: FloatArray


@dataclass(frozen=True, slots=True)
class StepState:
    """Memory between two policy steps; batch shape `...` in front.

    Attributes:
        lock: memory of the depth lock.
        memory: memory of the observation.
        target_position: (..., 3) m, the command in force.
        target_yaw: (...) rad, the command in force.
        previous_action: (..., 4) the policy's last action (`ActionMap.unit`); zero before the first.
    """

    lock: dsl.DslState
    memory: ObservationState
    target_position: FloatArray
    target_yaw: FloatArray
    previous_action: FloatArray


@dataclass(frozen=True, slots=True)
class Decision:
    """Stages of one step from the policy's action to the target; batch shape `...` in front.

    Attributes:
        displacement: (..., 4) m and rad, base frame: the action in units, before the lock.
        locked: output of the depth lock for that displacement.
        bounded: output of the command bounds for the locked command: the target.
    """

    displacement: FloatArray
    locked: dsl.DslOutput
    bounded: bounds.BoundedCommand


class PolicyStep:
    """The policy step under one contract.

    It holds no state: `begin` returns the first state, `observe` and `act` return the next one.

    Args:
        contract: contract of the policy.
        limits: bounds on every command.

    Attributes:
        ticks: samples per step.
        lock: constants of the depth lock.
        bounds: bounds on every command.
        actions: map from the policy's output to a displacement.
        builder: builder of observations.
        observation_size: length of an observation.
    """

    def __init__(self, contract: PolicyContract, limits: bounds.BoundsParameters) -> None:
        self.ticks = contract.ticks_per_step
        self.lock = contract.dsl
        self.bounds = limits
        self.actions = contract.action_map()
        self.builder = contract.observation_builder()
        self._lock_samples = contract.wrench_window_ticks
        self.observation_size = self.builder.size

    def begin(self, target_position: npt.ArrayLike, target_yaw: npt.ArrayLike) -> StepState:
        """Return the state before the first step.

        Args:
            target_position: (..., 3) m, the command in force. Its batch shape is the state's.
            target_yaw: (...) rad, the command in force.
        """
        position, yaw = np.asarray(target_position, np.float64), np.asarray(target_yaw, np.float64)
        shape = position.shape[:-1]
        return StepState(
            lock=dsl.DslState.begin(shape, self.bounds.workspace_lower[2]),
            memory=self.builder.begin(shape),
            target_position=position,
            target_yaw=yaw,
            previous_action=np.zeros((*shape, 4)),
        )

    def observe(self, state: StepState, seen: Seen) -> tuple[StepState, Float32Array]:
        """Build the policy's observation.

        Args:
            state: from `begin` or the last `act`.
            seen: present measurement.

        Returns:
            The next state, and the observation: (..., observation_size) float32 in raw units. A value is NaN where a
            quantity is not known.
        """
        measurement = Measurement(
            position=seen.position,
            yaw=seen.yaw,
            tilt=seen.tilt,
            wrench_window=seen.wrench_window,
            hole_estimate=seen.hole_estimate,
            nominal_hole=seen.nominal_hole,
            target_position=state.target_position,
            target_yaw=state.target_yaw,
            start_yaw=seen.start_yaw,
            z_lock=state.lock.z_lock,
            contact_z=state.lock.z_contact0,
            phase=state.lock.phase,
            previous_action=state.previous_action,
            last_joint=seen.last_joint,
        )
        memory, observation = self.builder.build(state.memory, measurement)
        return (
            StepState(state.lock, memory, state.target_position, state.target_yaw, state.previous_action),
            observation,
        )

    def act(self, state: StepState, seen: Seen, action: npt.ArrayLike) -> tuple[StepState, Decision]:
        """Turn the policy's answer into the next target.

        Args:
            state: from `observe`.
            seen: measurement that the observation was built from.
            action: (..., m), the policy's output. The caller must refuse an action that is not finite.

        Returns:
            The next state, which holds the decision's target, and the decision.
        """
        displacement = self.actions.displacement(action, seen.yaw)
        wrench = seen.wrench_window[-self._lock_samples :].mean(0)
        lock, locked = dsl.step(self.lock, state.lock, seen.position, wrench, displacement)
        bounded = bounds.apply(
            self.bounds,
            seen.position,
            seen.yaw,
            locked.position,
            seen.yaw + locked.dyaw,
            state.target_position,
            state.target_yaw,
            np.linalg.norm(seen.tilt, axis=-1),
        )
        after = StepState(lock, state.memory, bounded.position, bounded.yaw, self.actions.unit(action))
        return after, Decision(displacement, locked, bounded)


def command_bounds(
    limits: ControlLimits,
    period_s: float,
    start_yaw_rad: float,
    *,
    yaw_half_range_rad: float = YAW_HALF_RANGE_RAD,
    tilt_rad: float = TILT_RAD,
) -> bounds.BoundsParameters:
    """Return the bounds on a policy's commands: the limits of the arm's own controller, the yaw range and the tilt.

    Args:
        limits: limits that the arm's own controller enforces.
        period_s: time between two commands, s.
        start_yaw_rad: middle of the yaw range.
        yaw_half_range_rad: half of the yaw range.
        tilt_rad: measured tilt at which the caller stops.
    """
    lower, upper = limits.workspace
    step_m, step_rad = limits.max_step
    speed_m_s, speed_rad_s = limits.max_speed
    return bounds.BoundsParameters(
        period_s=period_s,
        step_m=step_m,
        step_rad=step_rad,
        speed_mps=speed_m_s,
        speed_radps=speed_rad_s,
        leash_m=step_m,
        leash_rad=step_rad,
        workspace_lower=lower,
        workspace_upper=upper,
        yaw_centre_rad=start_yaw_rad,
        yaw_half_range_rad=yaw_half_range_rad,
        tilt_rad=tilt_rad,
    )
