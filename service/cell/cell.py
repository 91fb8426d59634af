"""One cell: driver, safety core and runs put together.

Everything that matters for safety is synchronous: a sample goes from the driver through the monitor to a stop command
within one call, before anything is logged, stored, told or awaited. The ceilings of a run are judged once before that,
on the thread on which the sample arrives.
"""

import asyncio
import contextlib
import time
from collections.abc import Callable, Iterator, Sequence

import structlog

from service.cell import report
from service.cell.admission import Situation, why_not_start
from service.cell.halting import Halting
from service.cell.idle_arm import IdleArm
from service.cell.inference import InferenceKind, InProcessPolicy
from service.cell.intake import UNBELIEVED, Intake
from service.cell.journal import Journal
from service.cell.lateness import Lateness
from service.cell.policy_process import PolicyProcess
from service.cell.remarks import Remarks
from service.cell.resetting import Resetting
from service.cell.runs import Runs
from service.cell.starting import Starting
from service.cell.states import WITH_RUN, StateMachine
from service.cell.tick_record import TickRecord
from service.config import CellConfig
from service.drivers.base import Driver, Load, Sample
from service.faults import FaultCode
from service.logs import log_fault
from service.messages import (
    CellState,
    EventKind,
    Refused,
    ResetRequest,
    RunResult,
    RunState,
    StartRequest,
    Status,
    StatusResult,
    StopMark,
    StopRequest,
)

JOURNAL_CLOSE_S = 0.5
TELEMETRY_TICKS = 10
OVERRUN_S = 0.02
"""Lateness of one turn of the loop that counts as an overrun."""

_log = structlog.get_logger("service.cell")


class Cell:
    """Decides on every sample and every request of one arm. Belongs to the event loop in which it is made.

    Args:
        config: checked.
        driver: not connected yet; `watch.keep_linked` connects it.
        inference: how runs get their inference from policies in this process; None: each policy has a process of its
            own, which can be killed.
        time_of_day: seconds since the Unix epoch, for stamps only; decisions about the arm use the driver's clock.
        clock: monotonic seconds of this process, for the validity of requests and the length of runs.

    Attributes:
        unlinked: set while the link to the arm is down or not believed.

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
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.config = config
        self.driver = driver
        self.journal = Journal(config.cell.state_dir, time_of_day, clock)
        self.runs = Runs(self.journal, driver)
        self.degradations: Sequence[str] = ()
        self.telemetry_dropped = 0
        self.lateness = Lateness(OVERRUN_S)
        self.unlinked = asyncio.Event()
        self.unlinked.set()
        opener = (
            PolicyProcess.opener(
                config.limits.policy_deadline_s, lockstep=driver.mode == "lockstep", realtime=config.asks_realtime
            )
            if inference is None
            else InProcessPolicy.opener(inference)
        )
        self._intake = Intake(config.limits, driver.clock)
        self._states = StateMachine(CellState.OFFLINE if self.journal.latch is None else CellState.LATCHED)
        self._halting = Halting(config.limits, driver, self.journal, self.runs, self._intake, self._states, self)
        self._idle_arm = IdleArm(config.limits.stop_confirm_s)
        self._starting = Starting(config, driver, opener, self.journal, self.runs, self._intake, self)
        self._resetting = Resetting(config.limits, driver, self.journal, self._intake, self)
        self._remarks = Remarks(lambda text: self.journal.tell(EventKind.WARNING, self.state, text), driver.clock)
        self._link_text = "not connected yet"
        self._status_seq = 0
        self._untold = 0
        self._client_heard_at = 0.0

    @property
    def state(self) -> CellState:
        return self._states.state

    @property
    def policies_settled(self) -> bool:
        """True once every policy is loaded or refused; until then a start may have to wait."""
        return self._starting.policies_settled

    @property
    def newest_sample(self) -> Sample | None:
        return self._intake.sample

    @property
    def mark(self) -> StopMark:
        """Place in the order of stops. May be read on any thread."""
        return StopMark(service_epoch=self.journal.epoch, stops=self._halting.stops)

    # --- from the driver

    def overloads(self, load: Load) -> bool:
        """Judge the ceilings of the run under way where the sample arrives, on the transport's thread.

        The loop latches later, with the first overload as the cause, whatever it finds meanwhile.
        """
        if self.state not in WITH_RUN or self._starting.preparing:
            return False
        return self._halting.demands_stop(self._intake.judge_ceiling(load))

    def on_sample(self, sample: Sample) -> None:
        """Judge a sample and act on it."""
        try:
            self._halting.latch_overload()
            self._take(sample)
        except Exception as error:
            self.driver.stop()
            self.halt(FaultCode.INTERNAL, f"{type(error).__name__}: {error}")
            _log.exception("sample", seq=sample.seq)

    def on_link_fault(self, code: FaultCode, text: str) -> None:
        """Halt: the driver does not trust its link."""
        if not self._starting.preparing or code is not FaultCode.STALE:
            self.halt(code, text)

    def on_notice(self, text: str) -> None:
        """Write a line about something that had no effect: a refused command, say. A flood is thinned out."""
        self._remarks.note(text)

    def _take(self, sample: Sample) -> None:
        if self._starting.preparing:
            self._take_while_preparing(sample)
            return
        if self.unlinked.is_set() and self.state not in WITH_RUN and self.state is not CellState.STOPPING:
            return  # it may come from the source that was given up
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
        if self._halting.under_way:
            self._halting.on_sample(sample)
        elif self.runs.active is not None:
            self.runs.active.on_sample(sample)
        else:
            self._halting.repeat_stop(sample)  # no run drives the arm
            self._mind_idle_arm(sample)
        self._untold += 1
        # On a sample that has asked the policy, the answer comes first
        if self._untold >= TELEMETRY_TICKS and not self.runs.asks_at(sample):
            self._untold = 0
            self._send_telemetry(sample)

    def _take_while_preparing(self, sample: Sample) -> None:
        """Judge a sample by itself: it may be of the old world or of the new one."""
        verdict = self._intake.judge_alone(sample)
        if verdict.fault is not None:
            self.halt(verdict.fault, verdict.text)
        self._halting.on_sample(sample)

    def _mind_idle_arm(self, sample: Sample) -> None:
        notice = self._idle_arm.observe(sample)
        if notice is None:
            return
        if notice.driven and self.state is CellState.READY:
            self.halt(FaultCode.AUTHORITY, notice.text)
        else:
            self.on_notice(notice.text)

    # --- stopping

    def halt(self, code: FaultCode, text: str) -> None:
        """Stop at once and latch, if there is anything to stop. A later fault does not replace the first."""
        self._halting.halt(code, text)

    def disengage(self) -> None:
        """End a run in the ordinary way: stop the arm, and become READY once standstill is measured."""
        self._halting.disengage()

    # --- deadlines

    def watch(self) -> None:
        """Check for deadlines and silence; `watch.keep_watch` calls this every few milliseconds of real time."""
        now = self.driver.clock()
        self._halting.on_silence(now)
        if self._starting.preparing or (self.unlinked.is_set() and self.state not in WITH_RUN):
            return
        loss = self.config.client_loss
        if loss.policy == "stop" and self.state in WITH_RUN and now - self._client_heard_at > loss.limit_s:
            self.halt(FaultCode.CLIENT_LOST, f"no client was heard for {loss.limit_s:g} s")
        overdue = self._intake.overdue()
        if overdue.fault is not None:
            self.halt(overdue.fault, overdue.text)

    def hear_client(self) -> None:
        """Note that a client is there; `client_loss` in the configuration says what its silence means."""
        self._client_heard_at = self.driver.clock()

    # --- the link

    def linked(self) -> None:
        """Take the link up: the driver is connected. READY comes with the first sample.

        The arm is stopped, in case an earlier process left it moving.
        """
        self.driver.stop()
        if self.state in WITH_RUN:
            self.halt(FaultCode.LINK, "the link to the arm was made anew under a run")
            return
        self._intake.renew()
        self._idle_arm.forget()
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
            # In lockstep no time passes without a link: nothing moves, and nothing more can be measured
            self._halting.finish()

    # --- requests

    async def start(self, request: StartRequest) -> RunResult | Refused:
        """Accept a run, or say why not. The answer comes once the run is on the disk, before anything moves.

        A request without a mark was received now: a stop from here on refuses it.
        """
        if request.after is None:
            request = request.model_copy(update={"after": self.mark})
        return await self._starting.start(request)

    def stop(self, request: StopRequest) -> StatusResult:
        """Stop whatever moves, in every state; latch if a run is under way. No start received before survives it."""
        self._halting.stop(request)
        return StatusResult(status=self.status())

    async def reset(self, request: ResetRequest) -> StatusResult | Refused:
        """Acknowledge the latched fault; nothing moves."""
        refusal = await self._resetting.reset(request)
        return StatusResult(status=self.status()) if refusal is None else refusal

    def status(self) -> Status:
        """Return everything that there is to show; the arm is shown as measured."""
        now = self.driver.clock()
        self._status_seq += 1
        sample, config = self._intake.sample, self.config
        blocked = why_not_start(self.situation(), None, self.config, self.driver.simulated)
        return Status(
            cell=config.cell.id,
            service_epoch=self.journal.epoch,
            seq=self._status_seq,
            time=self.journal.time_of_day(),
            clock_s=self.journal.clock(),
            stops=self._halting.stops,
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
            degradations=(*self.degradations, *self._impaired()),
            counters=self._intake.counters(self.driver.samples_dropped, self.telemetry_dropped, self.lateness),
        )

    async def close(self) -> None:
        """Stop, wait for standstill as long as a stop may take, and release everything."""
        self._halting.close()
        self._starting.cancel()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(self.config.limits.stop_confirm_s):
                while self.state is CellState.STOPPING:
                    await asyncio.sleep(self.driver.tick_s)
        await self.driver.close()
        await asyncio.to_thread(self._starting.close)
        await asyncio.to_thread(self.journal.close, JOURNAL_CLOSE_S)

    # --- for its parts

    def situation(self) -> Situation:
        """Return what decides a request at this moment."""
        intake = self._intake
        return Situation(
            states=self._states,
            latch=self.journal.latch,
            link_text=self._link_text if self.unlinked.is_set() or intake.sample is None else None,
            storage_text=self.journal.fault,
            sample=intake.sample,
            sample_age_s=intake.age_s,
            force_n=intake.force_n,
            force_ceiling_n=intake.force_ceiling_n,
            resetting=self._resetting.under_way,
            starting=self._starting.deciding,
            mark=self.mark,
            clock_s=self.journal.clock(),
        )

    def enter(self, state: CellState) -> None:
        """Change the state and tell it."""
        self._states.to(state)
        self.journal.tell_state(state, self.runs.active_id)

    def enter_world(self, force_ceiling_n: float) -> None:
        """Expect samples of the prepared world, under this force ceiling."""
        self._intake.renew(force_ceiling_n)
        self._idle_arm.forget()
        self._halting.enter_world()

    def end_run(self, state: RunState, code: FaultCode | None, text: str) -> None:
        """End the run under way without a latch and become READY."""
        self._states.to(CellState.READY)
        run = self.runs.end(state, code, text, self._intake.peak_force_n, self._intake.time_s)
        if run is not None:
            self.journal.tell_run(run, self.state)
        self.journal.tell_state(self.state, None)

    def on_tick(self, record: TickRecord) -> None:
        """Hand a policy step's record to the observers."""
        self.journal.inform(lambda observer: observer.on_tick(record))

    # --- small parts

    def _impaired(self) -> Iterator[str]:
        """Yield what does not work at present."""
        if (fault := self.journal.fault) is not None:
            yield f"the state directory: {fault}"
        if (lost := log_fault()) is not None:
            yield lost

    def _send_telemetry(self, sample: Sample) -> None:
        insertion = None if self.runs.active is None else self.runs.active.insertion
        peak_n = self._intake.take_recent_peak()
        point = report.telemetry(sample, peak_n, self.state, insertion, self.runs.active_id)
        self.journal.inform(lambda observer: observer.on_telemetry(point))
