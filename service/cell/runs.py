"""The runs of one cell: at most one under way, and those that have ended.

`ActiveRun` is the run under way. `service.messages.Run` is the description of a run that people see.
"""

import secrets
from typing import Protocol

import structlog

from service.cell.inference import HeldPolicy, Inference
from service.cell.insertion import Insertion
from service.cell.journal import Journal
from service.cell.orders import Disengage, Engage, Fail, Halt, Infer, Move, Order, Succeed, ZeroFt
from service.cell.plan import Plan
from service.cell.stages import STATE_IN, Stage
from service.cell.tick_record import TickRecord
from service.drivers.base import Driver, Sample
from service.faults import FaultCode
from service.messages import CellState, Run, RunState, StartRequest
from service.policy.model import PolicyError, PolicyFault
from service.safety.witness import Witness
from wire.arrays import Float32Array

_log = structlog.get_logger("service.cell")


class RunHost(Protocol):
    """The cell, as its run sees it."""

    @property
    def state(self) -> CellState: ...

    def enter(self, state: CellState) -> None: ...

    def halt(self, code: FaultCode, text: str) -> None:
        """Stop and latch; the run is abandoned before this returns."""
        ...

    def disengage(self) -> None:
        """Stop the arm as the ordinary end of the run, and finish once standstill is measured."""
        ...

    def on_tick(self, record: TickRecord) -> None: ...


class ActiveRun:
    """One accepted run, until it has ended: carries out the orders of its insertion.

    Args:
        run: as accepted.
        driver: of the arm.
        host: the cell.

    Attributes:
        accepted: the run as accepted.
        outcome: set once the insertion has decided; the arm may still be moving away.
        insertion: None before the world is prepared.
    """

    def __init__(self, run: Run, driver: Driver, host: RunHost) -> None:
        self.accepted = run
        self.outcome: Succeed | Fail | None = None
        self.insertion: Insertion | None = None
        self._driver = driver
        self._host = host
        self._inference: Inference | None = None
        self._abandoned = False

    @property
    def abandoned(self) -> bool:
        return self._abandoned

    def begin(self, plan: Plan, policy: HeldPolicy) -> None:
        """Insert, from the next sample on."""
        self.insertion = Insertion(plan)
        self._inference = policy.infer(self._take_action, self._take_failure)

    def on_sample(self, sample: Sample) -> None:
        """Take in a sample that the monitor has passed."""
        if self.insertion is not None:
            self._carry_out(self.insertion, self.insertion.on_sample(sample))

    def abandon(self) -> None:
        """Send nothing of this run to the arm any more."""
        self._abandoned = True
        if self._inference is not None:
            self._inference.close()

    def snapshot(self, peak_force_n: float, now_s: float) -> Run:
        """Describe the run at this moment.

        Args:
            peak_force_n: so far.
            now_s: the samples' clock.
        """
        insertion = self.insertion
        if insertion is None:
            return self.accepted
        return self.accepted.model_copy(
            update={
                "phase": insertion.phase,
                "steps": insertion.steps,
                "depth_m": insertion.depth_m,
                "peak_force_n": peak_force_n,
                "duration_s": insertion.duration_s(now_s),
            }
        )

    def _carry_out(self, insertion: Insertion, orders: list[Order]) -> None:
        for order in orders:
            if self._abandoned:
                return
            if isinstance(order, Move):
                # A target of the stage before leaves before the new stage is told
                self._driver.send_target(order.target)
                continue
            self._follow(insertion.stage)
            match order:
                case Infer(observation):
                    if self._inference is not None:
                        self._inference.ask(observation)
                case ZeroFt():
                    self._driver.zero_ft()
                case Engage(law, limits):
                    self._driver.engage(law, limits)
                case Succeed() | Fail():
                    self.outcome = order
                case Disengage():
                    self._host.disengage()
                case Halt(code, text):
                    self._host.halt(code, text)
        if not self._abandoned:
            self._follow(insertion.stage)

    def _follow(self, stage: Stage) -> None:
        """Bring the cell into the state that belongs to the stage.

        It is entered at this point among the orders, and not derived from the stage, because the cell tells each change
        of state between the order before it and the one after it.
        """
        state = STATE_IN[stage]
        if state is not self._host.state:
            self._host.enter(state)

    def _take_action(self, action: Float32Array) -> None:
        if self._abandoned or self.insertion is None:
            return
        before = self.insertion.steps
        try:
            self._carry_out(self.insertion, self.insertion.take_action(action))
        except Exception as error:
            self._host.halt(FaultCode.INTERNAL, f"{type(error).__name__}: {error}")
            _log.exception("action", run=self.accepted.id)
        if self.insertion.steps > before and self.insertion.last is not None:
            self._host.on_tick(self.insertion.last)

    def _take_failure(self, error: Exception) -> None:
        if self._abandoned:
            return
        if isinstance(error, PolicyError) and error.reason is PolicyFault.TOO_SLOW:
            self._host.halt(FaultCode.POLICY_DEADLINE, f"{error.text}; the last target was held")
        elif isinstance(error, PolicyError):
            self._host.halt(FaultCode.POLICY_INVALID, f"the policy gave no usable action: {error}")
        else:
            self._host.halt(FaultCode.INTERNAL, f"inference failed with {type(error).__name__}: {error}")
            _log.error("inference", exc_info=error)


class Runs:
    """Begins, ends and finds runs; each change goes to the journal.

    Args:
        journal: of the cell.
        driver: of the arm.

    Attributes:
        active: the run under way, else None.
    """

    def __init__(self, journal: Journal, driver: Driver) -> None:
        self._journal = journal
        self._driver = driver
        self._last: Run | None = None
        self._begun_s = 0.0
        self.active: ActiveRun | None = None

    @property
    def witness(self) -> Witness | None:
        """Witness of the contact in the run under way; None without one."""
        insertion = None if self.active is None else self.active.insertion
        return None if insertion is None else insertion.witness

    def asks_at(self, sample: Sample) -> bool:
        """Return whether the policy's answer to this sample is awaited."""
        insertion = None if self.active is None else self.active.insertion
        return insertion is not None and insertion.asks_at(sample)

    @property
    def active_id(self) -> str | None:
        return None if self.active is None else self.active.accepted.id

    def draft(self, request: StartRequest, policy_sha256: str) -> Run:
        """Describe the run that a start asks for. It is no run before `begin`."""
        seed = request.seed
        if seed is None and self._driver.simulated:
            seed = secrets.randbelow(2**31)
        return Run(
            id=f"run-{secrets.token_hex(6)}",
            seq=self._journal.next_seq(),
            recipe=request.recipe,
            seed=seed,
            state=RunState.ACTIVE,
            requested_at=self._journal.time_of_day(),
            requested_by=request.requested_by,
            idempotency_key=request.idempotency_key,
            policy_sha256=policy_sha256,
        )

    def begin(self, run: Run, host: RunHost) -> ActiveRun:
        """Make a run that is on the disk the run under way."""
        self._journal.admit(run)
        self._begun_s = self._journal.clock()
        self.active = ActiveRun(run, self._driver, host)
        return self.active

    def end(self, state: RunState, code: FaultCode | None, text: str, peak_force_n: float, now_s: float) -> Run | None:
        """End the run under way, if there is one; nothing of it reaches the arm any more.

        Args:
            state: how it ended.
            code: why it did not succeed.
            text: the same for people.
            peak_force_n: of the run.
            now_s: the samples' clock.
        """
        active, self.active = self.active, None
        if active is None:
            return None
        active.abandon()
        # Not the time of day, which may have been set back since
        ended_at = active.accepted.requested_at + self._journal.clock() - self._begun_s
        changes = {"state": state, "code": code, "text": text, "ended_at": ended_at}
        self._last = run = active.snapshot(peak_force_n, now_s).model_copy(update=changes)
        self._journal.record(run)
        return run

    def raise_peak(self, peak_force_n: float) -> None:
        """Add to the last run the force measured between its end and standstill; the peak never falls."""
        last = self._last
        if last is not None and peak_force_n > (last.peak_force_n or 0.0):
            self._last = run = last.model_copy(update={"peak_force_n": peak_force_n})
            self._journal.record(run)

    def current(self, peak_force_n: float, now_s: float) -> Run | None:
        """Return the run under way, else the last one of this process."""
        return self._last if self.active is None else self.active.snapshot(peak_force_n, now_s)

    def find(self, run_id: str) -> Run | None:
        """Return a run as it was accepted or as it ended."""
        if self.active is not None and self.active.accepted.id == run_id:
            return self.active.accepted
        return self._journal.find(run_id)

    def find_key(self, idempotency_key: str | None) -> Run | None:
        """Return the run that a start with this key began."""
        if idempotency_key is None:
            return None
        if self.active is not None and self.active.accepted.idempotency_key == idempotency_key:
            return self.active.accepted
        return self._journal.find_key(idempotency_key)
