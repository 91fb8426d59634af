"""One cell: its state, its latch and the run under way, composed from driver, safety core and policy.

Synchronous where it matters: a sample goes from the driver through the monitor to a stop command within one call,
before anything is logged, stored, told or awaited.
"""

import asyncio
import contextlib
import time
from collections.abc import Callable, Sequence
from typing import cast

import structlog

from service.cell import report
from service.cell.admission import Standing, why_not_reset, why_not_start
from service.cell.inference import InferenceKind, InlineInference, ThreadInference
from service.cell.intake import UNBELIEVED, Intake
from service.cell.journal import Journal
from service.cell.plan import plan_insertion
from service.cell.policies import PolicyRefusedError, PolicyShelf
from service.cell.records import Fail, TickRecord
from service.cell.run import ActiveRun
from service.cell.runs import Runs, ended_by
from service.cell.states import WITH_RUN, StateMachine
from service.config import CellConfig, RecipeSection
from service.drivers.base import Driver, DriverError, Program, Sample
from service.faults import FaultCode
from service.messages import (
    CellState,
    EventKind,
    Problem,
    RefusalReason,
    Refused,
    ResetRequest,
    Run,
    RunResult,
    RunState,
    StartRequest,
    Status,
    StatusResult,
    StopRequest,
)
from service.policy.model import Policy
from service.safety.stop import StopConfirmation, StopParameters, StopState
from wire.task import Part, Task

LINK_FAULTS = frozenset({FaultCode.STALE, FaultCode.LINK, FaultCode.SOURCE, FaultCode.PROTOCOL})
"""Faults of the way to the arm: while nothing runs they mean OFFLINE and another attempt, not a latch."""
JOURNAL_CLOSE_S = 0.5
UNCONFIRMED = "no standstill was measured in time after the stop: use the robot's own emergency stop."
TELEMETRY_TICKS = 10
STOP_AGAIN_TICKS = 5

_log = structlog.get_logger("service.cell")


class Cell:
    """Everything belongs to the event loop in which it is made.

    Args:
        config: checked.
        driver: not connected yet; `watch.keep_linked` connects it.
        inference: who computes the policy's answers; None: by the driver's mode.
        time_of_day: seconds since the Unix epoch, for stamps only; decisions go by the driver's clock.

    Attributes:
        unlinked: set while the driver is not believed to be connected.

    Raises:
        OSError: the state directory cannot be used.
    """

    def __init__(
        self,
        config: CellConfig,
        driver: Driver,
        *,
        inference: InferenceKind | None = None,
        time_of_day: Callable[[], float] = time.time,
    ) -> None:
        self.config = config
        self.driver = driver
        self.journal = Journal(config.cell.state_dir, time_of_day)
        self.degradations: Sequence[str] = ()
        self.telemetry_dropped = self.overruns = 0
        self.unlinked = asyncio.Event()
        self.unlinked.set()
        self._inference_kind = inference or (InlineInference if driver.mode == "lockstep" else ThreadInference)
        self._policies = PolicyShelf(config.recipes, driver.tick_s, config.limits, camera=config.sees_hole)
        self._intake = Intake(config.limits, driver.clock)
        self._stop_parameters = StopParameters(deadline_s=config.limits.stop_confirm_s)
        self._states = StateMachine(CellState.OFFLINE if self.journal.latch is None else CellState.LATCHED)
        self.runs = Runs(self.journal)
        self._run_task: asyncio.Task[None] | None = None
        self._confirmation: StopConfirmation | None = None
        self._preparing = False
        self._resetting = False
        self._link_text = "not connected yet"
        self._status_seq = 0
        self._client_heard_at = 0.0

    @property
    def state(self) -> CellState:
        return self._states.state

    @property
    def newest_sample(self) -> Sample | None:
        return self._intake.sample

    # --- what the driver says

    def on_sample(self, sample: Sample) -> None:
        """Judge a sample and, if the run has a use for it, act on it."""
        try:
            self._take(sample)
        except Exception as error:
            self.driver.stop()
            self.halt(FaultCode.INTERNAL, f"{type(error).__name__}: {error}")
            _log.exception("sample", seq=sample.seq)

    def on_link_fault(self, code: FaultCode, text: str) -> None:
        """The driver does not trust its link."""
        if not self._preparing or code is not FaultCode.STALE:
            self.halt(code, text)

    def _take(self, sample: Sample) -> None:
        if self._preparing:
            self._take_while_preparing(sample)
            return
        if self.unlinked.is_set() and self.state not in WITH_RUN and self.state is not CellState.STOPPING:
            return  # it may be of the source that was given up
        verdict = self._intake.judge(sample)
        if verdict.fault is not None:
            self.halt(verdict.fault, verdict.text)
        if not verdict.accepted or verdict.fault in UNBELIEVED:
            return
        late_s = self._intake.age_s
        if verdict.fault is None and late_s > self.config.limits.sample_age_s and self.state in WITH_RUN:
            self.halt(FaultCode.STALE, f"this process judged a sample {late_s * 1e3:.0f} ms after it had arrived")
        if self.state is CellState.CONNECTING:
            self.enter(CellState.READY)
        if self._confirmation is not None:
            self._await_standstill(sample)
        elif self.runs.active is not None:
            self.runs.active.on_sample(sample)
        elif sample.program is Program.ENGAGED and sample.seq % STOP_AGAIN_TICKS == 0:
            self.driver.stop()  # nothing of ours drives it
        if self._intake.accepted % TELEMETRY_TICKS == 0:
            self._send_telemetry(sample)

    def _take_while_preparing(self, sample: Sample) -> None:
        """The old world's samples end and the new one's begin: each is judged by itself."""
        verdict = self._intake.judge_alone(sample)
        if verdict.fault is not None:
            self.halt(verdict.fault, verdict.text)
        self._await_standstill(sample)

    # --- stopping

    def halt(self, code: FaultCode, text: str) -> None:
        """Stop at once and latch, if there is anything to stop; the first cause stands."""
        state = self.state
        if state in WITH_RUN or state is CellState.READY:
            self.driver.stop()
        if state in WITH_RUN or (state is CellState.READY and code not in LINK_FAULTS):
            self._begin_stop(code, text)
        elif code in LINK_FAULTS:
            self.lose_link(text)

    def _begin_stop(self, code: FaultCode, text: str) -> None:
        self._states.to(CellState.STOPPING)
        self._confirmation = StopConfirmation(self._stop_parameters, self.driver.clock())
        state = ended_by(code)
        run_id, peak_n = self.runs.active_id, self._intake.peak_force_n
        # Before the run's end: a process that dies between the two writes must come back latched
        self.journal.set_latch(code, text, run_id, None if run_id is None else peak_n)
        run = self.runs.end(state, code, text, peak_n, self._intake.time_s)
        self._tell_run(run)
        self._tell_state()
        self.journal.tell(EventKind.FAULT, self.state, text, code, run_id)
        if code in LINK_FAULTS:
            self.lose_link(text)

    def disengage(self) -> None:
        """End a run in the ordinary way: stop the arm, and be READY once it stands by measurement."""
        self.driver.stop()
        self._confirmation = StopConfirmation(self._stop_parameters, self.driver.clock())

    def _await_standstill(self, sample: Sample) -> None:
        if self._confirmation is None:
            return
        if sample.program is Program.ENGAGED and sample.seq % STOP_AGAIN_TICKS == 0:
            self.driver.stop()
        if sample.program in (Program.ENGAGED, Program.STOPPING):
            # Standing still is not enough while the arm's program could go on
            self._conclude(self._confirmation.check(sample.arrival_s))
        else:
            self._conclude(self._confirmation.observe(sample.tcp_velocity, sample.arrival_s))

    def _conclude(self, stop: StopState) -> None:
        if stop is StopState.WAITING or self._confirmation is None:
            return
        if stop is StopState.UNCONFIRMED:
            self.driver.escalate()
        if self.state is CellState.STOPPING:
            self._finish_stop(stop)
        elif stop is StopState.UNCONFIRMED:
            self.halt(FaultCode.STOP_UNCONFIRMED, UNCONFIRMED)
        else:
            self._confirmation = None
            self._finish_run()

    def _finish_stop(self, stop: StopState | None) -> None:
        latch, peak_n = self.journal.latch, self._intake.peak_force_n
        if latch is not None and latch.run_id is not None and peak_n > (latch.peak_force_n or 0.0):
            latch = self.journal.set_latch(latch.code, latch.text, latch.run_id, peak_n)
            self.runs.raise_peak(peak_n)
        if stop is StopState.UNCONFIRMED and latch is not None:
            code = FaultCode.STOP_UNCONFIRMED if self._intake.is_fresh else latch.code
            text = f"{UNCONFIRMED} Stopped for {latch.code}: {latch.text}"
            self.journal.set_latch(code, text, latch.run_id, latch.peak_force_n)
            self.journal.tell(EventKind.FAULT, self.state, text, FaultCode.STOP_UNCONFIRMED, latch.run_id)
        self._confirmation = None
        self.enter(CellState.LATCHED)

    # --- time

    def watch(self) -> None:
        """Judge the silence; `watch.keep_watch` calls this every few milliseconds of real time."""
        now = self.driver.clock()
        if self._confirmation is not None:
            if self.state is CellState.STOPPING:
                self.driver.stop()
            self._conclude(self._confirmation.check(now))
        if self._preparing or (self.unlinked.is_set() and self.state not in WITH_RUN):
            return
        loss = self.config.client_loss
        if loss.policy == "stop" and self.state in WITH_RUN and now - self._client_heard_at > loss.limit_s:
            self.halt(FaultCode.CLIENT_LOST, f"no client was heard for {loss.limit_s:g} s")
        overdue = self._intake.overdue()
        if overdue.fault is not None:
            self.halt(overdue.fault, overdue.text)

    def hear_client(self) -> None:
        """A client has said that it is there; `client_loss` says what its silence means."""
        self._client_heard_at = self.driver.clock()

    def linked(self) -> None:
        """The driver is connected; READY comes with the first sample.

        What an earlier process left moving is stopped: nothing that this one did not start goes on.
        """
        self.driver.stop()
        if self.state in WITH_RUN:
            self.halt(FaultCode.LINK, "the link to the arm was made anew under a run")
            return
        self._intake.renew()
        self._link_text = "connected, no sample yet"
        self.unlinked.clear()
        if self.state is CellState.OFFLINE:
            self.enter(CellState.CONNECTING)

    def lose_link(self, text: str) -> None:
        """Give the link up; `watch.keep_linked` tries again."""
        if text != self._link_text:
            self._link_text = text
            self.journal.tell(EventKind.WARNING, self.state, text)
        self.unlinked.set()
        if self._states.allows(CellState.OFFLINE):
            self.enter(CellState.OFFLINE)
        elif self.state is CellState.STOPPING and self.driver.mode == "lockstep":
            # No time passes there without a link, so nothing moves and nothing more can be measured.
            self._finish_stop(None)

    # --- what people ask

    async def start(self, request: StartRequest) -> RunResult | Refused:
        """Accept a run, or say why not. The answer comes once the run is on the disk, before anything moves."""
        if (known := self.runs.find_key(request.idempotency_key)) is not None:
            return RunResult(run=known, created=False)
        if (problem := why_not_start(self._standing(), request, self.config, self.driver.simulated)) is not None:
            return Refused(problem=problem)
        if self._has_expired(request):
            return self._refuse(RefusalReason.EXPIRED, "the start came too late to be carried out: ask again")
        self.hear_client()
        self.enter(CellState.PREFLIGHT)
        active = self.runs.begin(request, self.driver, self)
        self._intake.clear_peak()
        try:
            policy = await asyncio.to_thread(self._policies.admit, request.recipe)
        except PolicyRefusedError as error:
            return self._take_back(active, RefusalReason.POLICY_REFUSED, str(error))
        if self._has_expired(request):
            return self._take_back(active, RefusalReason.EXPIRED, "loading the policy took too long: ask again")
        if not active.abandoned:
            active.accepted = active.accepted.model_copy(update={"policy_sha256": policy.sha256})
            recorded = self.journal.record(active.accepted)
            try:
                if recorded is None:
                    raise OSError(self.journal.fault)
                await asyncio.wrap_future(recorded)
            except OSError as error:
                return self._take_back(active, RefusalReason.STORAGE, f"the run cannot be recorded: {error}")
        if active.abandoned:
            return RunResult(run=self.runs.find(active.accepted.id) or active.accepted, created=True)
        self.journal.tell(EventKind.RUN, self.state, f"accepted, {request.recipe}", run_id=active.accepted.id)
        self._run_task = asyncio.create_task(self._prepare(active, policy), name=f"prepare {active.accepted.id}")
        return RunResult(run=active.accepted, created=True)

    def stop(self, request: StopRequest) -> StatusResult:
        """Stop whatever moves, in every state; latches if a run is under way."""
        self.driver.stop()
        if self.state in WITH_RUN:
            by = f" by {request.requested_by}" if request.requested_by else ""
            why = f": {request.reason}" if request.reason else ""
            self._begin_stop(FaultCode.OPERATOR_STOP, f"stopped{by}{why}")
        return StatusResult(status=self.status())

    async def reset(self, request: ResetRequest) -> StatusResult | Refused:
        """Acknowledge the latched fault; moves nothing."""
        if (problem := why_not_reset(self._standing(), request, self.config.limits)) is not None:
            if problem.reason is RefusalReason.WRONG_STATE and self._intake.in_protective_stop:
                self.driver.unlock()
            return Refused(problem=problem)
        self._resetting = True
        try:
            await asyncio.wrap_future(self.journal.clear_latch_on_disk())
        except OSError as error:
            return self._refuse(RefusalReason.STORAGE, f"the latch could not be cleared on the disk: {error}")
        finally:
            self._resetting = False
        latch = self.journal.latch
        if latch is None:
            return self._refuse(RefusalReason.NOT_LATCHED, "nothing is latched")
        if (problem := why_not_reset(self._standing(), request, self.config.limits)) is not None:
            self.journal.set_latch(latch.code, latch.text, latch.run_id, latch.peak_force_n)
            return Refused(problem=problem)
        self.journal.latch = None
        self.enter(CellState.READY)
        by = f" by {request.requested_by}" if request.requested_by else ""
        found = f": {request.comment}" if request.comment else ""
        text = f"{latch.code} acknowledged{by}{found}"
        self.journal.tell(EventKind.RESET, self.state, text, latch.code, latch.run_id)
        return StatusResult(status=self.status())

    def status(self) -> Status:
        """What there is to show, by measurement where the arm is concerned."""
        now = self.driver.clock()
        self._status_seq += 1
        sample, config = self._intake.sample, self.config
        blocked = why_not_start(self._standing(), None, self.config, self.driver.simulated)
        return Status(
            cell=config.cell.id,
            service_epoch=self.journal.epoch,
            seq=self._status_seq,
            time=self.journal.time_of_day(),
            state=self.state,
            can_start=blocked is None,
            why_not=None if blocked is None else blocked.detail,
            latch=self.journal.latch,
            run=self.runs.current(self._intake.peak_force_n, self._intake.time_s),
            measured=None if sample is None else report.measured(sample, now),
            driver=self.driver.name,
            mode=self.driver.mode,
            recipes=tuple(config.recipes),
            force_ceiling_n=self._intake.force_ceiling_n,
            degradations=(*self.degradations, *self._storage_trouble()),
            counters=self._intake.counters(self.driver.samples_dropped, self.telemetry_dropped, self.overruns),
        )

    async def close(self) -> None:
        """Stop, wait for the standstill as long as a stop may take, and release everything."""
        if self.state in WITH_RUN:
            self.halt(FaultCode.INTERRUPTED, "the control process was told to end")
        self.driver.stop()
        if self._run_task is not None:
            self._run_task.cancel()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(self.config.limits.stop_confirm_s):
                while self.state is CellState.STOPPING:
                    await asyncio.sleep(self.driver.tick_s)
        await self.driver.close()
        await asyncio.to_thread(self.journal.close, JOURNAL_CLOSE_S)

    # --- what the run under way asks

    def enter(self, state: CellState) -> None:
        """Change the state and say so."""
        self._states.to(state)
        self._tell_state()

    def on_tick(self, record: TickRecord) -> None:
        """Hand a policy step's record on."""
        self.journal.inform(lambda observer: observer.on_tick(record))

    async def _prepare(self, active: ActiveRun, policy: Policy) -> None:
        try:
            await self._prepare_world(active, policy)
        except Exception as error:
            _log.exception("prepare", run=active.accepted.id)
            if not active.abandoned:
                self.halt(FaultCode.INTERNAL, f"{type(error).__name__}: {error}")

    async def _prepare_world(self, active: ActiveRun, policy: Policy) -> None:
        run, recipe = active.accepted, self.config.recipes[active.accepted.recipe]
        plan = plan_insertion(self.config, recipe, policy.contract)
        self._preparing = True
        failure: DriverError | None = None
        try:
            await self.driver.prepare(_task(run, recipe))
        except DriverError as error:
            failure = error
        finally:
            self._preparing = False
        self._intake.renew(plan.limits.force_ceiling_n)
        if self.state is CellState.STOPPING:
            self._confirmation = StopConfirmation(self._stop_parameters, self.driver.clock())
        if active.abandoned:
            return
        if failure is not None:
            self._end_run(RunState.FAILED, failure.code, str(failure))
            return
        active.begin(plan, policy, self._inference_kind)

    def _finish_run(self) -> None:
        outcome = None if self.runs.active is None else self.runs.active.outcome
        if isinstance(outcome, Fail):
            self._end_run(RunState.FAILED, outcome.code, outcome.text)
        else:
            self._end_run(RunState.SUCCEEDED, None, "")

    def _end_run(self, state: RunState, code: FaultCode | None, text: str) -> None:
        self._states.to(CellState.READY)
        self._tell_run(self.runs.end(state, code, text, self._intake.peak_force_n, self._intake.time_s))
        self._tell_state()

    def _tell_run(self, run: Run | None) -> None:
        if run is not None:
            text = f"{run.state}: {run.text}" if run.text else run.state
            self.journal.tell(EventKind.RUN, self.state, text, run.code, run.id)

    # --- small parts

    def _standing(self) -> Standing:
        intake = self._intake
        return Standing(
            states=self._states,
            latch=self.journal.latch,
            link_text=self._link_text if self.unlinked.is_set() or intake.sample is None else None,
            storage_text=self.journal.fault,
            sample=intake.sample,
            sample_age_s=intake.age_s,
            force_n=intake.force_n,
            force_ceiling_n=intake.force_ceiling_n,
            resetting=self._resetting,
        )

    def _storage_trouble(self) -> tuple[str, ...]:
        return () if self.journal.fault is None else (f"the state directory: {self.journal.fault}",)

    def _refuse(self, reason: RefusalReason, detail: str) -> Refused:
        return Refused(problem=Problem(reason=reason, detail=detail, state=self.state))

    def _has_expired(self, request: StartRequest) -> bool:
        return request.valid_until is not None and self.journal.time_of_day() > request.valid_until

    def _take_back(self, active: ActiveRun, reason: RefusalReason, detail: str) -> RunResult | Refused:
        """Refuse after all, unless a stop came first: then there is a run, and it was stopped."""
        if active.abandoned:
            return RunResult(run=self.runs.find(active.accepted.id) or active.accepted, created=True)
        self.runs.take_back()
        self.enter(CellState.READY)
        return self._refuse(reason, detail)

    def _tell_state(self) -> None:
        self.journal.tell(EventKind.STATE, self.state, "", run_id=self.runs.active_id)

    def _send_telemetry(self, sample: Sample) -> None:
        insertion = None if self.runs.active is None else self.runs.active.insertion
        peak_n = self._intake.take_recent_peak()
        point = report.telemetry(sample, peak_n, self.state, insertion, self.runs.active_id)
        self.journal.inform(lambda observer: observer.on_telemetry(point))


def _task(run: Run, recipe: RecipeSection) -> Task | None:
    """Return the episode that a simulated world lays out for a run; the driver checks it. None on a real arm."""
    if run.seed is None:
        return None
    return Task(run.seed, cast("Part", recipe.part), recipe.clearance_m, recipe.conditions)
