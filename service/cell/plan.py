"""The plan of one insertion, fixed before it starts: numbers of the recipe, the limits and the policy's contract."""

from dataclasses import dataclass

import numpy as np

from service.config import CellConfig, LimitsSection, RecipeSection
from service.policy.compiled.policy_step import policy_step
from service.policy.contract import PolicyContract
from service.policy.step import PolicyStep, command_bounds
from service.safety.dsl import DslOutput
from service.safety.monitor import MonitorParameters
from service.safety.preflight import PreflightParameters
from service.safety.probe import ProbeParameters
from service.safety.seating import CAMERA, NOMINAL, SeatingParameters
from service.safety.witness import WitnessParameters
from wire.arrays import FloatArray
from wire.impact import fastest_m_s, liveliness, reached_m_s
from wire.law import ComplianceLaw, ControlLimits

APPROACH_SPEED_M_S = 0.08
"""Speed of the scripted moves where the recipe names none and the part bears it."""
PATH_TICKS = 5
"""Samples between two targets of a scripted move."""
SEARCH_M = 15e-3
"""Distance beyond the possible places of the hole to which a policy's search may lead the tip."""
ABOVE_HOVER_M = 20e-3
"""Height above the hover to which it may lead the tip."""
PROVEN_SHARE = 5.0 / 6.0
"""Share of the success depth that a probe must prove: 2.5 mm of 3 mm, the paper's criterion."""
PROBE_N = 4.0
"""Force from which a side holds the tip."""
PROBE_PUSH_N = 6.0
"""Largest force with which a probe pushes aside, whatever the sensor says: stiffness times the target's lead."""
PROBE_PULL_N = 9.0
"""The same down and up."""
PROBE_SAMPLES = 25
"""Newest samples whose mean force a probe judges."""
PROBE_SPEED_M_S = 0.02
PROBE_PATIENCE_S = 2.5
"""Time of one leg of a probe after which it has failed."""


@dataclass(frozen=True, slots=True)
class Plan:
    """Numbers of one insertion: lengths in m, angles in rad, base frame, times on the samples' clock.

    Attributes:
        start_position: (3,) position at which the TCP must stand.
        start_yaw: yaw at which it must stand; kept during the approach.
        nominal_hole: (3,) position of the hole without a camera.
        max_hole_offset: (3,) largest distance of the camera's estimate from it, per axis.
        uses_estimate: whether approach and depth use the camera's estimate.
        hover_m: height above the hole at which the approach ends.
        approach_speed_m_s: speed of scripted moves.
        max_steps: policy steps before the run fails.
        tick_s: period of the samples.
        retract: whether the tool moves up at the end.
        policy_deadline_s: longest time of one inference.
        clamped_steps: steps in a row with an outrageous action before the cell latches.
        law: compliance while engaged.
        limits: limits that the arm's own controller enforces.
        preflight: requirements on sensor and pose before the arm moves.
        witness: agreement of the sensor with the arm's joints, where the arm gives their forces.
        step: the policy step, with its lock and its bounds.
        seating: requirements on a seated peg, and the room of the run.
        probe: question to the walls where no contact proves the seat.
    """

    start_position: FloatArray
    start_yaw: float
    nominal_hole: FloatArray
    max_hole_offset: FloatArray
    uses_estimate: bool
    hover_m: float
    approach_speed_m_s: float
    max_steps: int
    tick_s: float
    retract: bool
    policy_deadline_s: float
    clamped_steps: int
    law: ComplianceLaw
    limits: ControlLimits
    preflight: PreflightParameters
    witness: WitnessParameters
    step: PolicyStep
    seating: SeatingParameters
    probe: ProbeParameters

    def why_end(self, locked: DslOutput, steps: int) -> str | None:
        """Return why the search for the hole ends without success; None where it goes on.

        Args:
            locked: output of the lock at the last policy step.
            steps: policy steps so far.
        """
        if bool(locked.search_depth_exceeded):
            return f"no contact within {self.step.lock.search_depth_m * 1e3:g} mm"
        if bool(locked.search_time_exceeded):
            return f"no contact within {self.step.lock.search_steps} steps"
        return f"not inserted within {self.max_steps} steps" if steps >= self.max_steps else None

    def why_not_hole(self, estimate: FloatArray) -> str | None:
        """Return why an estimate cannot be the recipe's hole; None where it can.

        Args:
            estimate: (3,) m, base frame, from the camera.
        """
        offset = estimate - self.nominal_hole
        # Plain floats: each call of numpy costs more than the three comparisons
        if all(abs(off) <= most for off, most in zip(offset.tolist(), self.max_hole_offset.tolist(), strict=True)):
            return None
        way = f"{np.round(offset * 1e3, 1).tolist()} mm from the recipe's hole"
        return f"the camera sees the hole {way}, limit {(self.max_hole_offset * 1e3).tolist()} mm"


def plan_insertion(config: CellConfig, recipe: RecipeSection, contract: PolicyContract) -> Plan:
    """Plan an insertion by a recipe, the cell's limits and a policy's contract."""
    limits = config.limits
    control = ControlLimits(
        workspace=limits.workspace_m,
        force_ceiling_n=limits.force_ceiling_n if recipe.force_ceiling_n is None else recipe.force_ceiling_n,
        max_speed=(limits.max_speed_m_s, limits.max_turn_speed_rad_s),
        max_step=(limits.max_step_m, limits.max_turn_rad),
        target_age_s=limits.target_age_s,
    )
    bounds = command_bounds(
        control,
        contract.period_s,
        recipe.start_yaw_rad,
        yaw_half_range_rad=limits.yaw_range_rad,
        tilt_rad=limits.max_tilt_rad,
    )
    return Plan(
        start_position=np.array(recipe.start_position_m),
        start_yaw=recipe.start_yaw_rad,
        nominal_hole=np.array(recipe.nominal_hole_m),
        max_hole_offset=np.array(limits.max_hole_offset_m),
        uses_estimate=contract.uses_estimate,
        hover_m=recipe.hover_m,
        approach_speed_m_s=approach_speed_m_s(recipe, limits, contract.compliance),
        max_steps=contract.max_steps if recipe.max_steps is None else min(recipe.max_steps, contract.max_steps),
        tick_s=contract.tick_s,
        retract=recipe.retract,
        policy_deadline_s=limits.policy_deadline_s,
        clamped_steps=limits.clamped_steps,
        law=contract.compliance,
        limits=control,
        preflight=PreflightParameters(**config.preflight.model_dump()),
        witness=WitnessParameters(**config.witness.model_dump()),
        step=policy_step(contract, bounds),
        seating=SeatingParameters(
            success_depth_m=recipe.success_depth_m,
            clearance_m=recipe.clearance_m,
            tolerance=CAMERA if contract.uses_estimate else NOMINAL,
            search_m=SEARCH_M,
            above_m=recipe.hover_m + ABOVE_HOVER_M,
        ),
        probe=ProbeParameters(
            sink_m=CAMERA.height_m,
            proven_m=PROVEN_SHARE * recipe.success_depth_m,
            clearance_m=recipe.clearance_m,
            held_n=PROBE_N,
            step_m=PROBE_SPEED_M_S * PATH_TICKS * contract.tick_s,
            lead_m=(_lead(PROBE_PUSH_N, contract, 0), _lead(PROBE_PULL_N, contract, 2)),
            patience=round(PROBE_PATIENCE_S / (PATH_TICKS * contract.tick_s)),
        ),
    )


def approach_speed_m_s(recipe: RecipeSection, limits: LimitsSection, law: ComplianceLaw) -> float:
    """Return the speed of the scripted moves: the recipe's, else the fastest whose blow the part bears, m/s."""
    if recipe.approach_speed_m_s is not None:
        return recipe.approach_speed_m_s
    usual = min(APPROACH_SPEED_M_S, limits.max_speed_m_s)
    fastest = fastest_m_s(recipe.bears_n(limits.force_ceiling_n), max(law.inertia[:3]), limits.contact_n_m)
    return usual if reached_m_s(usual, limits.max_step_m, law) <= fastest else min(usual, fastest / liveliness(law))


def plan_monitor(limits: LimitsSection, force_ceiling_n: float) -> MonitorParameters:
    """Return the limits of a sample; the ceiling is that of the cell, or a recipe's lower one."""
    return MonitorParameters(
        force_ceiling_n=force_ceiling_n,
        torque_ceiling_nm=limits.torque_ceiling_nm,
        stuck_samples=limits.stuck_samples,
        stuck_channel_samples=limits.stuck_channel_samples,
        max_age_s=limits.sample_age_s,
        max_gap_s=limits.sample_age_s,
    )


def _lead(force_n: float, contract: PolicyContract, axis: int) -> float:
    """Return the lead of a target with which the law pulls with a force along an axis, m."""
    return force_n / contract.compliance.stiffness[axis]
