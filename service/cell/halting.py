"""The stop of a cell: the command leaves first, the latch follows, and standstill is measured before either is done."""

from typing import Protocol

from service.cell.intake import Intake
from service.cell.journal import Journal
from service.cell.orders import Fail
from service.cell.runs import Runs
from service.cell.standstill import Standstill
from service.cell.states import WITH_RUN, StateMachine
from service.config import LimitsSection
from service.drivers.base import Driver, Sample
from service.faults import FaultCode
from service.messages import CellState, EventKind, RunState, StopRequest
from service.safety.stop import StopState
from service.safety.verdict import Verdict

LINK_FAULTS = frozenset({FaultCode.STALE, FaultCode.LINK, FaultCode.SOURCE, FaultCode.PROTOCOL})
"""Faults of the link to the arm: while nothing runs they mean OFFLINE and another attempt, not a latch."""
DISBELIEVED = frozenset({FaultCode.SENSOR_INVALID, FaultCode.SENSOR_STUCK, FaultCode.BIAS})
"""Faults after which the arm must not yield to its force/torque sensor while it stops."""
UNCONFIRMED = "no standstill was measured in time after the stop: use the robot's own emergency stop."


class HaltHost(Protocol):
    """The cell, as its stop sees it."""

    def enter(self, state: CellState) -> None: ...

    def lose_link(self, text: str) -> None: ...

    def end_run(self, state: RunState, code: FaultCode | None, text: str) -> None: ...


class Halting:
    """Stops the arm of one cell, latches, and waits for standstill.

    Args:
        limits: of the cell.
        driver: of the arm.
        journal: of the cell.
        runs: of the cell.
        intake: of the cell.
        states: of the cell.
        host: the cell.

    Attributes:
        stops: count that every stop command, latching fault and end of the process advances, by one or two. No start
            received before it advances survives.
    """

    def __init__(
        self,
        limits: LimitsSection,
        driver: Driver,
        journal: Journal,
        runs: Runs,
        intake: Intake,
        states: StateMachine,
        host: HaltHost,
    ) -> None:
        self._driver = driver
        self._journal = journal
        self._runs = runs
        self._intake = intake
        self._states = states
        self._host = host
        self._standstill = Standstill(driver, limits.stop_confirm_s)
        self._overload: Verdict | None = None
        self.stops = 0

    @property
    def under_way(self) -> bool:
        """True while standstill is awaited, after a stop or at the ordinary end of a run."""
        return self._standstill.awaited

    # --- an overload, judged on the transport's thread

    def demands_stop(self, verdict: Verdict) -> bool:
        """Return whether a load judged in a run demands a stop; the first overload is kept. Any thread may call it."""
        if verdict.fault is not None and self._overload is None:
            self._overload = verdict
        return verdict.fault is not None

    def latch_overload(self) -> None:
        """Latch the overload that was kept, where its run is still under way; before anything else that may end it."""
        overload = self._overload
        if overload is None:
            return  # without a write: one may come from the other thread at this moment
        self._overload = None
        if overload.fault is not None and self._states.state in WITH_RUN:
            self.halt(overload.fault, overload.text)

    # --- commands

    def halt(self, code: FaultCode, text: str) -> None:
        """Stop at once and latch, if there is anything to stop. A later fault does not replace the first."""
        self.latch_overload()
        state = self._states.state
        if state in WITH_RUN or state is CellState.READY:
            (self._driver.stop_blind if code in DISBELIEVED else self._driver.stop)()
        elif state is CellState.STOPPING and code in DISBELIEVED:
            self._standstill.disbelieve()
        if state in WITH_RUN or (state is CellState.READY and code not in LINK_FAULTS):
            self._begin(code, text)
        elif code in LINK_FAULTS:
            self._host.lose_link(text)

    def stop(self, request: StopRequest) -> None:
        """Stop whatever moves, in every state; latch if a run is under way."""
        self.latch_overload()
        self._driver.stop()
        self.stops += 1
        if self._states.state in WITH_RUN:
            by = f" by {request.requested_by}" if request.requested_by else ""
            why = f": {request.reason}" if request.reason else ""
            self._begin(FaultCode.OPERATOR_STOP, f"stopped{by}{why}")

    def disengage(self) -> None:
        """End a run in the ordinary way: stop the arm, and become READY once standstill is measured."""
        self._driver.stop()
        self._standstill.begin(self._runs.witness)

    def close(self) -> None:
        """Stop because the process ends; a run that is under way is interrupted."""
        self.stops += 1
        if self._states.state in WITH_RUN:
            self.halt(FaultCode.INTERRUPTED, "the control process was told to end")
        self._driver.stop()

    # --- until standstill

    def on_sample(self, sample: Sample) -> None:
        """Judge standstill by a sample, where it is awaited."""
        self._conclude(self._standstill.on_sample(sample))

    def on_silence(self, now: float) -> None:
        """Latch an overload; judge the deadline of a stop without a sample, and repeat the stop.

        Args:
            now: of the driver's clock.
        """
        self.latch_overload()
        if self.under_way:
            if self._states.state is CellState.STOPPING:
                self._standstill.stop()
            self._conclude(self._standstill.on_silence(now))

    def repeat_stop(self, sample: Sample) -> None:
        """Send the stop command again where the arm is engaged and no run drives it."""
        self._standstill.repeat_stop(sample)

    def enter_world(self) -> None:
        """Measure the standstill of a stop under way anew: a world was laid out."""
        if self._states.state is CellState.STOPPING:
            self._standstill.begin()

    def finish(self, stop: StopState | None = None) -> None:
        """Become LATCHED.

        Args:
            stop: how the stop ended; None where nothing moves and nothing more can be measured.
        """
        latch, peak_n = self._journal.latch, self._intake.peak_force_n
        if latch is not None and latch.run_id is not None and peak_n > (latch.peak_force_n or 0.0):
            latch = self._journal.set_latch(latch.code, latch.text, latch.run_id, peak_n)
            self._runs.raise_peak(peak_n)
        if stop is StopState.UNCONFIRMED and latch is not None:
            code = FaultCode.STOP_UNCONFIRMED if self._intake.is_fresh else latch.code
            text = f"{UNCONFIRMED} Stopped for {latch.code}: {latch.text}"
            self._journal.set_latch(code, text, latch.run_id, latch.peak_force_n)
            self._journal.tell(EventKind.FAULT, self._states.state, text, FaultCode.STOP_UNCONFIRMED, latch.run_id)
        self._standstill.end()
        self._host.enter(CellState.LATCHED)

    def _begin(self, code: FaultCode, text: str) -> None:
        self.stops += 1
        self._states.to(CellState.STOPPING)
        self._standstill.begin(self._runs.witness, blind=code in DISBELIEVED)
        run_id, peak_n = self._runs.active_id, self._intake.peak_force_n
        # Before the run's end: a process that dies between the two writes must come back latched
        self._journal.set_latch(code, text, run_id, None if run_id is None else peak_n)
        run = self._runs.end(RunState.ended_by(code), code, text, peak_n, self._intake.time_s)
        if run is not None:
            self._journal.tell_run(run, CellState.STOPPING)
        self._journal.tell_state(CellState.STOPPING, None)
        self._journal.tell(EventKind.FAULT, CellState.STOPPING, text, code, run_id)
        if code in LINK_FAULTS:
            self._host.lose_link(text)

    def _conclude(self, stop: StopState) -> None:
        if stop is StopState.WAITING:
            return
        if self._states.state is CellState.STOPPING:
            self.finish(stop)
        elif stop is StopState.UNCONFIRMED:
            self.halt(FaultCode.STOP_UNCONFIRMED, UNCONFIRMED)
        else:
            self._standstill.end()
            self._finish_run()

    def _finish_run(self) -> None:
        outcome = None if self._runs.active is None else self._runs.active.outcome
        if isinstance(outcome, Fail):
            self._host.end_run(RunState.FAILED, outcome.code, outcome.text)
        else:
            self._host.end_run(RunState.SUCCEEDED, None, "")
