"""The runs of one cell: the one under way, at most, and those that have ended."""

import secrets

from service.cell.journal import Journal
from service.cell.run import ActiveRun, RunHost
from service.drivers.base import Driver
from service.faults import FaultCode
from service.messages import Run, RunState, StartRequest

_ENDED_BY = {
    FaultCode.OPERATOR_STOP: RunState.STOPPED,
    FaultCode.CLIENT_LOST: RunState.STOPPED,
    FaultCode.INTERRUPTED: RunState.INTERRUPTED,
}


def ended_by(code: FaultCode) -> RunState:
    """How a run ends that a latching stop with this code has ended."""
    return _ENDED_BY.get(code, RunState.LATCHED)


class Runs:
    """Begins, ends and finds runs; each change goes to the journal.

    Args:
        journal: of the cell.

    Attributes:
        active: under way, else None.
    """

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._last: Run | None = None
        self.active: ActiveRun | None = None

    @property
    def active_id(self) -> str | None:
        return None if self.active is None else self.active.accepted.id

    def begin(self, request: StartRequest, driver: Driver, host: RunHost) -> ActiveRun:
        """Make the run under way; it is journalled once it has been accepted."""
        seed = request.seed
        if seed is None and driver.simulated:
            seed = secrets.randbelow(2**31)
        run = Run(
            id=f"run-{secrets.token_hex(6)}",
            recipe=request.recipe,
            seed=seed,
            state=RunState.ACTIVE,
            requested_at=self._journal.time_of_day(),
            requested_by=request.requested_by,
            idempotency_key=request.idempotency_key,
        )
        self.active = ActiveRun(run, driver, host)
        return self.active

    def end(self, state: RunState, code: FaultCode | None, text: str, peak_force_n: float, now_s: float) -> Run | None:
        """End the run under way, if there is one; from then on nothing of it reaches the arm.

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
        changes = {"state": state, "code": code, "text": text, "ended_at": self._journal.time_of_day()}
        self._last = run = active.snapshot(peak_force_n, now_s).model_copy(update=changes)
        self._journal.record(run)
        return run

    def raise_peak(self, peak_force_n: float) -> None:
        """Tell of the last run what was felt after its end, until the arm stood; never less than before."""
        last = self._last
        if last is not None and peak_force_n > (last.peak_force_n or 0.0):
            self._last = run = last.model_copy(update={"peak_force_n": peak_force_n})
            self._journal.record(run)

    def take_back(self) -> None:
        """Forget the run under way: it was not accepted after all."""
        if self.active is not None:
            self.active.abandon()
            self._journal.forget(self.active.accepted.id)
            self.active = None

    def current(self, peak_force_n: float, now_s: float) -> Run | None:
        """Return the run under way, else the last one of this process."""
        return self._last if self.active is None else self.active.snapshot(peak_force_n, now_s)

    def find(self, run_id: str) -> Run | None:
        """Return a run as it was accepted or as it ended."""
        if self.active is not None and self.active.accepted.id == run_id:
            return self.active.accepted
        return self._journal.ledger.find(run_id)

    def find_key(self, idempotency_key: str | None) -> Run | None:
        """Return the run that a start with this key began."""
        if idempotency_key is None:
            return None
        if self.active is not None and self.active.accepted.idempotency_key == idempotency_key:
            return self.active.accepted
        return self._journal.ledger.find_key(idempotency_key)
