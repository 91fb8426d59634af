"""One cell: its state, its latch and the run under way, composed from driver, safety core and policy.

Synchronous where it matters: a sample goes from the driver through the monitor to a stop command within one call,
before anything is logged, stored, told or awaited.
"""

import asyncio
import contextlib
import secrets
import time
from collections.abc import Callable, Sequence

import numpy as np
import structlog

from service.cell import report
from service.cell.inference import InferenceKind, InlineInference, ThreadInference
from service.cell.journal import Journal
from service.cell.plan import plan_insertion
from service.cell.policies import PolicyRefusedError, PolicyShelf
from service.cell.records import Fail, TickRecord
from service.cell.run import ActiveRun
from service.cell.states import WITH_RUN, StateMachine
from service.config import CellConfig
from service.drivers.base import Driver, DriverError, Program, Sample, Setup
from service.faults import FaultCode
from service.messages import (
    CellState,
    Counters,
    EventKind,
    Problem,
    Reason,
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
from service.safety.monitor import Monitor, MonitorParameters
from service.safety.stop import StopConfirmation, StopParameters, StopState

LINK_FAULTS = frozenset({FaultCode.STALE, FaultCode.LINK, FaultCode.SOURCE, FaultCode.PROTOCOL})
"""Faults of the way to the arm: while nothing runs they mean OFFLINE and another attempt, not a latch."""
UNBELIEVED = frozenset({FaultCode.SENSOR_INVALID, FaultCode.SOURCE, FaultCode.LINK})
"""Faults after which the sample itself is not used for anything."""
ENDED_BY = {
    FaultCode.OPERATOR_STOP: RunState.STOPPED,
    FaultCode.CLIENT_LOST: RunState.STOPPED,
    FaultCode.INTERRUPTED: RunState.INTERRUPTED,
}
JOURNAL_CLOSE_S = 0.5
TELEMETRY_TICKS = 10
STOP_AGAIN_TICKS = 5
FIRST_SAMPLE_S = 2.0
"""Time after connecting in which the first sample must come."""

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
        self.telemetry_dropped = 0
        self.overruns = 0
        self.unlinked = asyncio.Event()
        self.unlinked.set()
        self._inference_kind = inference or (InlineInference if driver.mode == "lockstep" else ThreadInference)
        self._policies = PolicyShelf(config.recipes, driver.tick_s, config.limits.max_stiffness)
        self._monitor = self._new_monitor(config.limits.force_ceiling_n)
        self._stop_parameters = StopParameters(
            report.STANDSTILL_M_S, report.STANDSTILL_RAD_S, deadline_s=config.limits.stop_confirm_s
        )
        self._states = StateMachine(CellState.OFFLINE if self.journal.latch is None else CellState.LATCHED)
        self._active: ActiveRun | None = None
        self._last_run: Run | None = None
        self._run_task: asyncio.Task[None] | None = None
        self._confirmation: StopConfirmation | None = None
        self._preparing = False
        self._resetting = False
        self._sample: Sample | None = None
        self._linked_at = 0.0
        self._link_text = "not connected yet"
        self._status_seq = 0
        self._samples = self._ignored = self._missed = 0

    @property
    def state(self) -> CellState:
        return self._states.state

    @property
    def newest_sample(self) -> Sample | None:
        return self._sample

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
            return
        verdict = self._monitor.check(
            epoch=sample.epoch,
            episode=sample.episode,
            seq=sample.seq,
            time_s=sample.time_s,
            wrench=sample.wrench,
            motion=np.concatenate((sample.q, sample.qd, sample.tcp_position, sample.tcp_rotvec, sample.tcp_velocity)),
            saturated=sample.saturated,
            now=sample.arrival_s,
        )
        if not verdict.accepted:
            self._ignored += 1
            return
        if verdict.fault is not None:
            self.halt(verdict.fault, verdict.text)
            if verdict.fault in UNBELIEVED:
                return
        self._keep(sample)
        late_s = self.driver.clock() - sample.arrival_s
        if verdict.fault is None and late_s > self.config.limits.sample_age_s and self.state in WITH_RUN:
            self.halt(FaultCode.STALE, f"this process judged a sample {late_s * 1e3:.0f} ms after it had arrived")
        if self.state is CellState.CONNECTING:
            self.enter(CellState.READY)
        if self._confirmation is not None:
            self._await_standstill(sample)
        elif self._active is not None:
            self._active.on_sample(sample)
        if self._samples % TELEMETRY_TICKS == 0:
            self._send_telemetry(sample)

    def _keep(self, sample: Sample) -> None:
        self._samples += 1
        if self._sample is not None and sample.epoch == self._sample.epoch:
            self._missed += max(0, sample.seq - self._sample.seq - 1)
        self._sample = sample

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
        active, self._active = self._active, None
        run = None
        if active is not None:
            active.abandon()
            run = self._end_run(active, ENDED_BY.get(code, RunState.LATCHED), code, text)
        run_id = None if run is None else run.id
        self.journal.set_latch(code, text, run_id, None if run is None else run.peak_force_n)
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
        if sample.program is Program.ENGAGED and self._samples % STOP_AGAIN_TICKS == 0:
            self.driver.stop()
        self._conclude(self._confirmation.observe(sample.tcp_velocity, sample.arrival_s))

    def _conclude(self, stop: StopState) -> None:
        if stop is StopState.WAITING or self._confirmation is None:
            return
        if self.state is CellState.STOPPING:
            self._finish_stop(stop)
        elif stop is StopState.UNCONFIRMED:
            self.halt(FaultCode.STOP_UNCONFIRMED, self._unconfirmed_text())
        else:
            self._confirmation = None
            self._finish_run()

    def _finish_stop(self, stop: StopState | None) -> None:
        latch = self.journal.latch
        if stop is StopState.UNCONFIRMED and latch is not None:
            seen = self._sample is not None and self._age_s(self._sample) < self.config.limits.sample_age_s
            code = FaultCode.STOP_UNCONFIRMED if seen else latch.code
            text = f"{self._unconfirmed_text()} Stopped for {latch.code}: {latch.text}"
            self.journal.set_latch(code, text, latch.run_id, latch.peak_force_n)
            self.journal.tell(EventKind.FAULT, self.state, text, FaultCode.STOP_UNCONFIRMED, latch.run_id)
        self._confirmation = None
        self.enter(CellState.LATCHED)

    def _unconfirmed_text(self) -> str:
        limit = self.config.limits.stop_confirm_s
        return f"no standstill was measured within {limit:g} s of the stop: use the robot's own emergency stop."

    # --- time

    def watch(self) -> None:
        """Judge the silence; `watch.keep_watch` calls this every few milliseconds of real time."""
        now = self.driver.clock()
        if self._preparing:
            return
        if self._confirmation is not None:
            if self.state is CellState.STOPPING:
                self.driver.stop()
            self._conclude(self._confirmation.check(now))
        if self.unlinked.is_set():
            return
        overdue = self._monitor.overdue(now)
        if overdue.fault is None or (self._sample is None and now - self._linked_at < FIRST_SAMPLE_S):
            return
        if now - self._linked_at >= self.config.limits.sample_age_s:
            self.halt(overdue.fault, overdue.text)

    def linked(self) -> None:
        """The driver is connected; READY comes with the first sample."""
        self._monitor.reset()
        self._linked_at = self.driver.clock()
        self._sample = None
        self._link_text = "connected, no sample yet"
        self.unlinked.clear()

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
        if (known := self._find_key(request.idempotency_key)) is not None:
            return RunResult(run=known, created=False)
        if (refusal := self._why_not_start(request)) is not None:
            return refusal
        self.enter(CellState.PREFLIGHT)
        active = self._active = ActiveRun(self._new_run(request), self.driver, self)
        self._monitor.clear_peak()
        try:
            policy = await asyncio.to_thread(self._policies.admit, request.recipe)
        except PolicyRefusedError as error:
            return self._take_back(active, Reason.POLICY_REFUSED, str(error))
        if not active.abandoned:
            active.accepted = active.accepted.model_copy(update={"policy_sha256": policy.sha256})
            recorded = self.journal.record(active.accepted)
            try:
                if recorded is None:
                    raise OSError(self.journal.fault)
                await asyncio.wrap_future(recorded)
            except OSError as error:
                return self._take_back(active, Reason.STORAGE, f"the run cannot be recorded: {error}")
        if active.abandoned:
            return RunResult(run=self.journal.ledger.find(active.accepted.id) or active.accepted, created=True)
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
        if (refusal := self._why_not_reset(request)) is not None:
            return refusal
        self._resetting = True
        try:
            await asyncio.wrap_future(self.journal.clear_latch_on_disk())
        except OSError as error:
            return self._refuse(Reason.STORAGE, f"the latch could not be cleared on the disk: {error}")
        finally:
            self._resetting = False
        latch = self.journal.latch
        if latch is None:
            return self._refuse(Reason.NOT_LATCHED, "nothing is latched")
        if (refusal := self._why_not_reset(request)) is not None:
            self.journal.set_latch(latch.code, latch.text, latch.run_id, latch.peak_force_n)
            return refusal
        self.journal.latch = None
        self.enter(CellState.READY)
        by = f" by {request.requested_by}" if request.requested_by else ""
        self.journal.tell(EventKind.RESET, self.state, f"{latch.code} acknowledged{by}", latch.code, latch.run_id)
        return StatusResult(status=self.status())

    def status(self) -> Status:
        """What there is to show, by measurement where the arm is concerned."""
        now = self.driver.clock()
        self._status_seq += 1
        active, sample, config = self._active, self._sample, self.config
        run = self._last_run if active is None else active.snapshot(self._monitor.peak_force_n, self._samples_clock())
        blocked = self._why_not_start(None)
        return Status(
            cell=config.cell.id,
            service_epoch=self.journal.epoch,
            seq=self._status_seq,
            time=self.journal.time_of_day(),
            state=self.state,
            can_start=blocked is None,
            why_not=None if blocked is None else blocked.problem.detail,
            latch=self.journal.latch,
            run=run,
            measured=None if sample is None else report.measured(sample, now),
            driver=self.driver.name,
            mode=self.driver.mode,
            recipes=tuple(config.recipes),
            force_ceiling_n=config.limits.force_ceiling_n,
            degradations=tuple(self.degradations),
            counters=Counters(
                samples=self._samples,
                samples_ignored=self._ignored,
                samples_missed=self._missed,
                telemetry_dropped=self.telemetry_dropped,
                loop_overruns=self.overruns,
            ),
        )

    def find_run(self, run_id: str) -> Run | None:
        """Return a run, live where it is the one under way."""
        if self._active is not None and self._active.accepted.id == run_id:
            return self._active.snapshot(self._monitor.peak_force_n, self._samples_clock())
        return self.journal.ledger.find(run_id)

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
        for observer in self.journal.observers:
            observer.on_tick(record)

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
            await self.driver.prepare(Setup(run.seed, recipe.part, recipe.clearance_m, recipe.conditions))
        except DriverError as error:
            failure = error
        finally:
            self._preparing = False
        self._monitor = self._new_monitor(plan.limits.force_ceiling_n)
        self._sample = None
        self._linked_at = self.driver.clock()
        if self.state is CellState.STOPPING:
            self._confirmation = StopConfirmation(self._stop_parameters, self._linked_at)
        if active.abandoned:
            return
        if failure is not None:
            self._active = None
            self._states.to(CellState.READY)
            self._end_run(active, RunState.FAILED, failure.code, str(failure))
            self._tell_state()
            return
        active.begin(plan, policy, self._inference_kind)

    def _finish_run(self) -> None:
        active, self._active = self._active, None
        self._states.to(CellState.READY)
        if active is None:
            return
        active.abandon()
        outcome = active.outcome
        if isinstance(outcome, Fail):
            self._end_run(active, RunState.FAILED, outcome.code, outcome.text)
        else:
            self._end_run(active, RunState.SUCCEEDED, None, "")
        self._tell_state()

    def _end_run(self, active: ActiveRun, state: RunState, code: FaultCode | None, text: str) -> Run:
        run = active.snapshot(self._monitor.peak_force_n, self._samples_clock()).model_copy(
            update={"state": state, "code": code, "text": text, "ended_at": self.journal.time_of_day()}
        )
        self._last_run = run
        self.journal.record(run)
        self.journal.tell(EventKind.RUN, self.state, f"{state}{': ' if text else ''}{text}", code, run.id)
        return run

    # --- small parts

    def _why_not_start(self, request: StartRequest | None) -> Refused | None:
        latch = self.journal.latch
        if latch is not None:
            return self._refuse(Reason.LATCHED, f"latched by {latch.code}: {latch.text}. Reset it first.", latch.code)
        if not self._states.allows(CellState.PREFLIGHT):
            why = (
                self._link_text if self.state in (CellState.OFFLINE, CellState.CONNECTING) else "wait until it is READY"
            )
            return self._refuse(Reason.WRONG_STATE, f"the cell is {self.state}: {why}")
        if self.journal.fault is not None:
            return self._refuse(Reason.STORAGE, f"the state directory cannot be written: {self.journal.fault}")
        if request is None:
            return None
        if request.recipe not in self.config.recipes:
            known = ", ".join(self.config.recipes)
            return self._refuse(
                Reason.UNKNOWN_RECIPE, f"no recipe {request.recipe!r}; there are {known}", field="recipe"
            )
        if request.seed is not None and not self.driver.simulated:
            return self._refuse(Reason.INVALID_REQUEST, "a real arm has no seed: leave it out", field="seed")
        return None

    def _why_not_reset(self, request: ResetRequest) -> Refused | None:
        latch = self.journal.latch
        if latch is None:
            return self._refuse(Reason.NOT_LATCHED, "nothing is latched; a reset cannot be given in advance")
        if self.state is not CellState.LATCHED or self._resetting:
            return self._refuse(Reason.WRONG_STATE, "the stop or another reset is not finished: try again", latch.code)
        if request.acknowledge is not None and request.acknowledge is not latch.code:
            return self._refuse(Reason.LATCHED, f"latched is {latch.code}: look at that one", latch.code)
        sample, limits = self._sample, self.config.limits
        if sample is None or self._age_s(sample) >= limits.sample_age_s or self.unlinked.is_set():
            return self._refuse(
                Reason.NO_MEASUREMENT, f"nothing fresh is measured ({self._link_text}): restore the link", latch.code
            )
        if sample.program is Program.PROTECTIVE_STOP:
            self.driver.unlock()
            text = "the arm is in its protective stop, its release was asked for: try again in a few seconds"
            return self._refuse(Reason.WRONG_STATE, text, latch.code)
        if report.measured(sample, 0.0).moving:
            return self._refuse(Reason.WRONG_STATE, "the arm is moving", latch.code)
        force = self._monitor.force_n
        if force >= limits.force_ceiling_n or sample.saturated:
            text = f"{force:.1f} N are measured, the ceiling is {limits.force_ceiling_n:g} N: relieve the tool first"
            return self._refuse(Reason.FORCE_ABOVE_LIMIT, text, latch.code)
        return None

    def _refuse(self, reason: Reason, detail: str, code: FaultCode | None = None, field: str | None = None) -> Refused:
        return Refused(problem=Problem(reason=reason, detail=detail, code=code, state=self.state, field=field))

    def _take_back(self, active: ActiveRun, reason: Reason, detail: str) -> RunResult | Refused:
        """Refuse after all, unless a stop came first: then there is a run, and it was stopped."""
        if active.abandoned:
            return RunResult(run=self.journal.ledger.find(active.accepted.id) or active.accepted, created=True)
        active.abandon()
        self._active = None
        self.enter(CellState.READY)
        return self._refuse(reason, detail)

    def _find_key(self, key: str | None) -> Run | None:
        if key is None:
            return None
        if self._active is not None and self._active.accepted.idempotency_key == key:
            return self._active.accepted
        return self.journal.ledger.find_key(key)

    def _new_run(self, request: StartRequest) -> Run:
        seed = request.seed
        if seed is None and self.driver.simulated:
            seed = secrets.randbelow(2**31)
        return Run(
            id=f"run-{secrets.token_hex(6)}",
            recipe=request.recipe,
            seed=seed,
            state=RunState.ACTIVE,
            requested_at=self.journal.time_of_day(),
            requested_by=request.requested_by,
            idempotency_key=request.idempotency_key,
        )

    def _new_monitor(self, force_ceiling_n: float) -> Monitor:
        limits = self.config.limits
        return Monitor(
            MonitorParameters(
                force_ceiling_n=force_ceiling_n,
                torque_ceiling_nm=limits.torque_ceiling_nm,
                stuck_samples=limits.stuck_samples,
                max_age_s=limits.sample_age_s,
                max_gap_s=limits.sample_age_s,
            )
        )

    def _tell_state(self) -> None:
        run_id = None if self._active is None else self._active.accepted.id
        self.journal.tell(EventKind.STATE, self.state, "", run_id=run_id)

    def _send_telemetry(self, sample: Sample) -> None:
        active = self._active
        insertion = None if active is None else active.insertion
        point = report.telemetry(sample, self.state, insertion, None if active is None else active.accepted.id)
        for observer in self.journal.observers:
            observer.on_telemetry(point)

    def _age_s(self, sample: Sample) -> float:
        return self.driver.clock() - sample.arrival_s

    def _samples_clock(self) -> float:
        return 0.0 if self._sample is None else self._sample.time_s
