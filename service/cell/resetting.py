"""The reset of a latched cell: an operator acknowledges the fault, and nothing moves."""

from typing import Protocol

from service.cell.admission import Situation, refused, why_not_reset
from service.cell.intake import Intake
from service.cell.journal import Journal
from service.config import LimitsSection
from service.drivers.base import Driver
from service.messages import CellState, EventKind, RefusalReason, Refused, ResetRequest


class ResetHost(Protocol):
    """The cell, as a reset sees it."""

    @property
    def state(self) -> CellState: ...

    def situation(self) -> Situation: ...

    def enter(self, state: CellState) -> None: ...


class Resetting:
    """Clears the latch of one cell.

    Args:
        limits: of the cell.
        driver: of the arm.
        journal: of the cell.
        intake: of the cell.
        host: the cell.

    Attributes:
        under_way: whether the disk is being written; another reset is refused meanwhile.
    """

    def __init__(
        self, limits: LimitsSection, driver: Driver, journal: Journal, intake: Intake, host: ResetHost
    ) -> None:
        self._limits = limits
        self._driver = driver
        self._journal = journal
        self._intake = intake
        self._host = host
        self.under_way = False

    async def reset(self, request: ResetRequest) -> Refused | None:
        """Clear the latch and make the cell READY; return the refusal where that is not possible."""
        journal = self._journal
        if (problem := why_not_reset(self._host.situation(), request, self._limits)) is not None:
            if problem.reason is RefusalReason.WRONG_STATE and self._intake.in_protective_stop:
                self._driver.unlock()
            return Refused(problem=problem)
        self.under_way = True
        try:
            await journal.clear_latch_on_disk()
        except OSError as error:
            text = f"the latch could not be cleared on the disk: {error}"
            return refused(self._host.state, RefusalReason.STORAGE, text)
        finally:
            self.under_way = False
        latch = journal.latch
        if latch is None:
            return refused(self._host.state, RefusalReason.NOT_LATCHED, "nothing is latched")
        # The arm may have changed while the disk was written
        if (problem := why_not_reset(self._host.situation(), request, self._limits)) is not None:
            journal.set_latch(latch.code, latch.text, latch.run_id, latch.peak_force_n)
            return Refused(problem=problem)
        journal.drop_latch()
        self._host.enter(CellState.READY)
        by = f" by {request.requested_by}" if request.requested_by else ""
        found = f": {request.comment}" if request.comment else ""
        text = f"{latch.code} acknowledged{by}{found}"
        journal.tell(EventKind.RESET, self._host.state, text, latch.code, latch.run_id)
        return None
