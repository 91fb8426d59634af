"""Decisions to accept or refuse a start or a reset. Every refusal says what to do about it."""

import math
from dataclasses import dataclass

import numpy as np

from service.cell import report
from service.cell.states import StateMachine
from service.config import CellConfig, LimitsSection, RecipeSection
from service.drivers.base import Program, Sample
from service.messages import CellState, Latch, Problem, RefusalReason, Refused, ResetRequest, StartRequest, StopMark
from service.safety.pose import yaw_and_tilt
from service.safety.preflight import PreflightParameters, check_start_pose
from service.safety.verdict import Verdict


@dataclass(frozen=True, slots=True)
class Situation:
    """Everything about the cell that decides a request.

    Attributes:
        states: its state, and the transitions that the table allows.
        latch: in force.
        link_text: why the arm is not heard; None while samples come.
        storage_text: why the disk cannot be relied on; None while it can.
        sample: the newest believed one.
        sample_age_s: its age; infinite without one.
        force_n: its resultant force.
        force_ceiling_n: in force.
        resetting: whether an earlier reset is not finished.
        starting: whether an earlier start is not decided.
        mark: place in the order of stops.
        clock_s: time on the control process's clock.
    """

    states: StateMachine
    latch: Latch | None
    link_text: str | None
    storage_text: str | None
    sample: Sample | None
    sample_age_s: float
    force_n: float
    force_ceiling_n: float
    resetting: bool
    starting: bool
    mark: StopMark
    clock_s: float

    def problem(self, reason: RefusalReason, detail: str, field: str | None = None) -> Problem:
        """Return a refusal in this situation."""
        code = None if self.latch is None else self.latch.code
        return Problem(reason=reason, detail=detail, code=code, state=self.states.state, field=field)


def why_not_start(
    situation: Situation, request: StartRequest | None, config: CellConfig, simulated: bool
) -> Problem | None:
    """Return the reason to refuse a start; None where it is accepted.

    Args:
        situation: of the cell.
        request: None: any start.
        config: of the cell.
        simulated: whether the arm's world takes a seed.
    """
    latch, states = situation.latch, situation.states
    if latch is not None:
        return situation.problem(RefusalReason.LATCHED, f"latched by {latch.code}: {latch.text}; reset it first")
    if not states.allows(CellState.PREFLIGHT):
        why = situation.link_text or "wait until it is READY"
        return situation.problem(RefusalReason.WRONG_STATE, f"the cell is {states.state}: {why}")
    if situation.link_text is not None:
        return situation.problem(RefusalReason.NO_MEASUREMENT, f"the arm is not measured: {situation.link_text}")
    if situation.storage_text is not None:
        text = f"the state directory cannot be written: {situation.storage_text}"
        return situation.problem(RefusalReason.STORAGE, text)
    if situation.starting:
        text = "another start is being decided: wait for its answer"
        return situation.problem(RefusalReason.WRONG_STATE, text)
    return None if request is None else _why_not_this_start(situation, request, config, simulated)


def _why_not_this_start(
    situation: Situation, request: StartRequest, config: CellConfig, simulated: bool
) -> Problem | None:
    if request.after is not None and request.after != situation.mark:
        since = "a stop came" if request.after.service_epoch == situation.mark.service_epoch else "the cell restarted"
        text = f"{since} after this start had been received: look at the cell, then start again, under a new key"
        return situation.problem(RefusalReason.STOPPED, text)
    if request.valid_until is not None and situation.clock_s > request.valid_until:
        text = "the start could not be decided before its valid_until: ask again"
        return situation.problem(RefusalReason.EXPIRED, text)
    if request.recipe not in config.recipes:
        text = f"no recipe {request.recipe!r}; there are {', '.join(config.recipes)}"
        return situation.problem(RefusalReason.UNKNOWN_RECIPE, text, "recipe")
    if request.seed is not None and not simulated:
        return situation.problem(RefusalReason.INVALID_REQUEST, "a real arm has no seed: leave it out", "seed")
    # The arm of a simulated world is laid out at its start pose
    if not simulated and situation.sample is not None:
        verdict = _check_pose(situation.sample, config.recipes[request.recipe], config)
        if verdict.fault is not None:
            return situation.problem(RefusalReason.WRONG_STATE, verdict.text)
    return None


def _check_pose(sample: Sample, recipe: RecipeSection, config: CellConfig) -> Verdict:
    yaw, tilt = yaw_and_tilt(sample.tcp_rotvec)
    parameters = PreflightParameters(**config.preflight.model_dump())
    start = np.array(recipe.start_position_m)
    return check_start_pose(parameters, sample.tcp_position, float(yaw), tilt, start, recipe.start_yaw_rad)


def why_not_reset(situation: Situation, request: ResetRequest, limits: LimitsSection) -> Problem | None:
    """Return the reason to refuse a reset; None where it is accepted."""
    latch, sample = situation.latch, situation.sample
    if latch is None:
        return situation.problem(RefusalReason.NOT_LATCHED, "nothing is latched; a reset cannot be given in advance")
    if situation.states.state is not CellState.LATCHED or situation.resetting:
        return situation.problem(RefusalReason.WRONG_STATE, "the stop or another reset is not finished: try again")
    if request.acknowledge is not None and request.acknowledge is not latch.code:
        text = f"the latch in force is {latch.code}: inspect that fault, then acknowledge it"
        return situation.problem(RefusalReason.LATCHED, text, "acknowledge")
    if sample is None or situation.link_text is not None or situation.sample_age_s >= limits.sample_age_s:
        why = situation.link_text or f"the newest sample is {situation.sample_age_s:.3g} s old"
        return situation.problem(
            RefusalReason.NO_MEASUREMENT, f"the arm is not measured: {why}; restore the link first"
        )
    if sample.program is Program.PROTECTIVE_STOP:
        text = "the arm is in its protective stop; its release was asked for: try again in some seconds"
        return situation.problem(RefusalReason.WRONG_STATE, text)
    if sample.program is not Program.IDLE:
        text = f"the arm's program is {sample.program.name} and is being stopped: try again when it is IDLE"
        return situation.problem(RefusalReason.WRONG_STATE, text)
    if report.measured(sample, 0.0).moving:
        return situation.problem(RefusalReason.WRONG_STATE, "the arm is moving")
    if situation.force_n >= situation.force_ceiling_n or sample.saturated:
        ceiling_n = situation.force_ceiling_n
        text = f"{situation.force_n:.1f} N are measured, the ceiling is {ceiling_n:g} N: relieve the tool"
        return situation.problem(RefusalReason.FORCE_ABOVE_LIMIT, text)
    torque_nm = math.hypot(*sample.wrench[3:])
    if torque_nm >= limits.torque_ceiling_nm:
        text = f"{torque_nm:.2f} N·m are measured, the ceiling is {limits.torque_ceiling_nm:g} N·m: relieve the tool"
        return situation.problem(RefusalReason.FORCE_ABOVE_LIMIT, text)
    return None


def refused(state: CellState, reason: RefusalReason, detail: str, field: str | None = None) -> Refused:
    """Return a refusal for a reason that lies outside the situation."""
    return Refused(problem=Problem(reason=reason, detail=detail, state=state, field=field))
