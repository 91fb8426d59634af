"""Whether a start or a reset is accepted: pure decisions, each with what the asker should do about it."""

import math
from dataclasses import dataclass

from service.cell import report
from service.cell.states import StateMachine
from service.config import CellConfig, LimitsSection
from service.drivers.base import Program, Sample
from service.messages import CellState, Latch, Problem, RefusalReason, ResetRequest, StartRequest


@dataclass(frozen=True, slots=True)
class Standing:
    """How the cell stands when it is asked.

    Attributes:
        states: its state, and what the table allows.
        latch: in force.
        link_text: why nothing is heard of the arm; None while samples come.
        storage_text: why the disk cannot be relied on; None while it can.
        sample: the newest.
        sample_age_s: its age; infinite without one.
        force_n: resultant of the newest believed sample.
        force_ceiling_n: in force.
        resetting: another reset is being written.
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

    def problem(self, reason: RefusalReason, detail: str, field: str | None = None) -> Problem:
        """A refusal in this standing."""
        code = None if self.latch is None else self.latch.code
        return Problem(reason=reason, detail=detail, code=code, state=self.states.state, field=field)


def why_not_start(
    standing: Standing, request: StartRequest | None, config: CellConfig, simulated: bool
) -> Problem | None:
    """Say why a start is refused; None where it is not.

    Args:
        standing: of the cell.
        request: None asks whether any start would be accepted.
        config: of the cell.
        simulated: whether the arm's world takes a seed.
    """
    latch, states = standing.latch, standing.states
    if latch is not None:
        return standing.problem(RefusalReason.LATCHED, f"latched by {latch.code}: {latch.text}; reset it first")
    if not states.allows(CellState.PREFLIGHT):
        why = standing.link_text or "wait until it is READY"
        return standing.problem(RefusalReason.WRONG_STATE, f"the cell is {states.state}: {why}")
    if standing.link_text is not None:
        return standing.problem(RefusalReason.NO_MEASUREMENT, f"the arm is not measured: {standing.link_text}")
    if standing.storage_text is not None:
        text = f"the state directory cannot be written: {standing.storage_text}"
        return standing.problem(RefusalReason.STORAGE, text)
    if request is None:
        return None
    if request.recipe not in config.recipes:
        text = f"no recipe {request.recipe!r}; there are {', '.join(config.recipes)}"
        return standing.problem(RefusalReason.UNKNOWN_RECIPE, text, "recipe")
    if request.seed is not None and not simulated:
        return standing.problem(RefusalReason.INVALID_REQUEST, "a real arm has no seed: leave it out", "seed")
    return None


def why_not_reset(standing: Standing, request: ResetRequest, limits: LimitsSection) -> Problem | None:
    """Say why a reset is refused; None where it is not."""
    latch, sample = standing.latch, standing.sample
    if latch is None:
        return standing.problem(RefusalReason.NOT_LATCHED, "nothing is latched; a reset cannot be given in advance")
    if standing.states.state is not CellState.LATCHED or standing.resetting:
        return standing.problem(RefusalReason.WRONG_STATE, "the stop or another reset is not finished: try again")
    if request.acknowledge is not None and request.acknowledge is not latch.code:
        return standing.problem(RefusalReason.LATCHED, f"latched is {latch.code}: look at that one", "acknowledge")
    if sample is None or standing.link_text is not None or standing.sample_age_s >= limits.sample_age_s:
        why = standing.link_text or f"the newest sample is {standing.sample_age_s:.3g} s old"
        return standing.problem(RefusalReason.NO_MEASUREMENT, f"the arm is not measured: {why}; restore the link first")
    if sample.program is Program.PROTECTIVE_STOP:
        text = "the arm is in its protective stop; its release was asked for: try again in some seconds"
        return standing.problem(RefusalReason.WRONG_STATE, text)
    if sample.program is not Program.IDLE:
        text = f"the arm's program is {sample.program.name}: it is being stopped; try again when it rests"
        return standing.problem(RefusalReason.WRONG_STATE, text)
    if report.measured(sample, 0.0).moving:
        return standing.problem(RefusalReason.WRONG_STATE, "the arm is moving")
    if standing.force_n >= standing.force_ceiling_n or sample.saturated:
        text = f"{standing.force_n:.1f} N are measured, the ceiling is {standing.force_ceiling_n:g} N: relieve the tool"
        return standing.problem(RefusalReason.FORCE_ABOVE_LIMIT, text)
    torque_nm = math.hypot(*sample.wrench[3:])
    if torque_nm >= limits.torque_ceiling_nm:
        text = f"{torque_nm:.2f} N·m are measured, the ceiling is {limits.torque_ceiling_nm:g} N·m: relieve the tool"
        return standing.problem(RefusalReason.FORCE_ABOVE_LIMIT, text)
    return None
