"""One cell: its state, its latch and the run under way, composed from driver, safety core and policy.

Synchronous where it matters: a sample goes from the driver through the monitor to a stop command within one call,
before anything is logged, stored, told or awaited.
"""

import asyncio
import contextlib
import time
from collections.abc import Callable, Sequence

import numpy as np
import structlog

from service.cell import report
from service.cell.admission import Standing, why_not_reset, why_not_start
from service.cell.inference import InferenceKind, InlineInference, ThreadInference
from service.cell.journal import Journal
from service.cell.plan import plan_insertion, plan_monitor
from service.cell.policies import PolicyRefusedError, PolicyShelf
from service.cell.records import Fail, TickRecord
from service.cell.run import ActiveRun
from service.cell.runs import Runs
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
from service.safety.monitor import Monitor
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
        self._monitor = Monitor(plan_monitor(config.limits, config.limits.force_ceiling_n))
        self._stop_parameters = StopParameters(
            report.STANDSTILL_M_S, report.STANDSTILL_RAD_S, deadline_s=config.limits.stop_confirm_s
        )
        self._states = StateMachine(CellState.OFFLINE if self.journal.latch is None else CellState.LATCHED)
        self.runs = Runs(self.journal)
        self._run_task: asyncio.Task[None] | None = None
        self._confirmation: StopConfirmation | None = None
        self._preparing = False
        self._resetting = False
        self._sample: Sample | None = None
        self._linked_at = 0.0
        self._link_text = "not connected yet"
        self._status_seq = 0
        self._samples = self._ignored = self._missed = 0
        self._client_heard_at = 0.0

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
        elif self.runs.active is not None:
            self.runs.active.on_sample(sample)
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
        state = ENDED_BY.get(code, RunState.LATCHED)
        run = self.runs.end(state, code, text, self._monitor.peak_force_n, self._samples_clock())
        run_id = None if run is None else run.id
        self.journal.set_latch(code, text, run_id, None if run is None else run.peak_force_n)
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
        if sample.program is Program.ENGAGED and self._samples % STOP_AGAIN_TICKS == 0:
            self.driver.stop()
        if sample.program in (Program.ENGAGED, Program.STOPPING):
            # Standing still is not enough while the arm's program could go on
            self._conclude(self._confirmation.check(sample.arrival_s))
        else:
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
        loss = self.config.client_loss
        if loss.policy == "stop" and self.state in WITH_RUN and now - self._client_heard_at > loss.limit_s:
            self.halt(FaultCode.CLIENT_LOST, f"no client was heard for {loss.limit_s:g} s")
        overdue = self._monitor.overdue(now)
        if overdue.fault is None or (self._sample is None and now - self._linked_at < FIRST_SAMPLE_S):
            return
        if now - self._linked_at >= self.config.limits.sample_age_s:
            self.halt(overdue.fault, overdue.text)

    def hear_client(self) -> None:
        """A client has said that it is there; `client_loss` says what its silence means."""
        self._client_heard_at = self.driver.clock()

    def linked(self) -> None:
        """The driver is connected; READY comes with the first sample.

        What an earlier process left moving is stopped: nothing that this one did not start goes on.
        """
        self.driver.stop()
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
        if (known := self.runs.find_key(request.idempotency_key)) is not None:
            return RunResult(run=known, created=False)
        if (problem := why_not_start(self._standing(), request, self.config, self.driver.simulated)) is not None:
            return Refused(problem=problem)
        self.hear_client()
        self.enter(CellState.PREFLIGHT)
        active = self.runs.begin(request, self.driver, self)
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
            if problem.reason is Reason.WRONG_STATE and self._in_protective_stop:
                self.driver.unlock()
            return Refused(problem=problem)
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
        if (problem := why_not_reset(self._standing(), request, self.config.limits)) is not None:
            self.journal.set_latch(latch.code, latch.text, latch.run_id, latch.peak_force_n)
            return Refused(problem=problem)
        self.journal.latch = None
        self.enter(CellState.READY)
        by = f" by {request.requested_by}" if request.requested_by else ""
        self.journal.tell(EventKind.RESET, self.state, f"{latch.code} acknowledged{by}", latch.code, latch.run_id)
        return StatusResult(status=self.status())

    def status(self) -> Status:
        """What there is to show, by measurement where the arm is concerned."""
        now = self.driver.clock()
        self._status_seq += 1
        sample, config = self._sample, self.config
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
            run=self.runs.current(self._monitor.peak_force_n, self._samples_clock()),
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
        self._monitor = Monitor(plan_monitor(self.config.limits, plan.limits.force_ceiling_n))
        self._sample = None
        self._linked_at = self.driver.clock()
        if self.state is CellState.STOPPING:
            self._confirmation = StopConfirmation(self._stop_parameters, self._linked_at)
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
        self._tell_run(self.runs.end(state, code, text, self._monitor.peak_force_n, self._samples_clock()))
        self._tell_state()

    def _tell_run(self, run: Run | None) -> None:
        if run is not None:
            text = f"{run.state}: {run.text}" if run.text else run.state
            self.journal.tell(EventKind.RUN, self.state, text, run.code, run.id)

    # --- small parts

    def _standing(self) -> Standing:
        sample = self._sample
        return Standing(
            states=self._states,
            latch=self.journal.latch,
            link_text=self._link_text if self.unlinked.is_set() or sample is None else None,
            storage_text=self.journal.fault,
            sample=sample,
            sample_age_s=float("inf") if sample is None else self._age_s(sample),
            force_n=self._monitor.force_n,
            resetting=self._resetting,
        )

    @property
    def _in_protective_stop(self) -> bool:
        return self._sample is not None and self._sample.program is Program.PROTECTIVE_STOP

    def _refuse(self, reason: Reason, detail: str) -> Refused:
        return Refused(problem=Problem(reason=reason, detail=detail, state=self.state))

    def _take_back(self, active: ActiveRun, reason: Reason, detail: str) -> RunResult | Refused:
        """Refuse after all, unless a stop came first: then there is a run, and it was stopped."""
        if active.abandoned:
            return RunResult(run=self.runs.find(active.accepted.id) or active.accepted, created=True)
        self.runs.take_back()
        self.enter(CellState.READY)
        return self._refuse(reason, detail)

    def _tell_state(self) -> None:
        run_id = None if self.runs.active is None else self.runs.active.accepted.id
        self.journal.tell(EventKind.STATE, self.state, "", run_id=run_id)

    def _send_telemetry(self, sample: Sample) -> None:
        active = self.runs.active
        insertion = None if active is None else active.insertion
        point = report.telemetry(sample, self.state, insertion, None if active is None else active.accepted.id)
        for observer in self.journal.observers:
            observer.on_telemetry(point)

    def _age_s(self, sample: Sample) -> float:
        return self.driver.clock() - sample.arrival_s

    def _samples_clock(self) -> float:
        return 0.0 if self._sample is None else self._sample.time_s
