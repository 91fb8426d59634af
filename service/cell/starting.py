"""The start of a run: accepted, recorded, and its world prepared, before anything moves."""

import asyncio
from dataclasses import replace
from typing import Protocol, cast

import structlog

from service.cell.admission import Situation, refused, why_not_start
from service.cell.inference import PolicyOpener
from service.cell.intake import Intake
from service.cell.journal import Journal
from service.cell.plan import plan_insertion
from service.cell.policies import Admitted, PolicyRefusedError, PolicyShelf
from service.cell.runs import ActiveRun, RunHost, Runs
from service.config import CellConfig, RecipeSection, why_edited
from service.drivers.base import Driver, DriverError
from service.faults import FaultCode
from service.marks import FirstMarks
from service.messages import (
    CellState,
    EventKind,
    RefusalReason,
    Refused,
    Run,
    RunResult,
    RunState,
    StartRequest,
)
from wire.task import Part, Task

_log = structlog.get_logger("service.cell")


class StartHost(RunHost, Protocol):
    """The cell, as a start sees it."""

    def situation(self) -> Situation: ...

    def hear_client(self) -> None: ...

    def enter_world(self, force_ceiling_n: float) -> None:
        """Expect samples of the prepared world, under this force ceiling."""
        ...

    def end_run(self, state: RunState, code: FaultCode | None, text: str) -> None: ...


class Starting:
    """Accepts the runs of one cell and prepares their worlds.

    Args:
        config: of the cell.
        driver: of the arm.
        opener: opens the policies' files.
        journal: of the cell.
        runs: of the cell.
        intake: of the cell.
        host: the cell.

    Attributes:
        preparing: whether the driver is preparing a world. The samples of the old world end and those of the new one
            begin meanwhile.
    """

    def __init__(
        self,
        config: CellConfig,
        driver: Driver,
        opener: PolicyOpener,
        journal: Journal,
        runs: Runs,
        intake: Intake,
        host: StartHost,
    ) -> None:
        self._config = config
        self._driver = driver
        self._journal = journal
        self._runs = runs
        self._intake = intake
        self._host = host
        self._policies = PolicyShelf(config, driver.tick_s, opener)
        self._deciding: asyncio.Task[RunResult | Refused] | None = None
        self._deciding_key: str | None = None
        self._first_marks = FirstMarks()
        self._preparation: asyncio.Task[None] | None = None
        self._cancelled = False
        self.preparing = False

    @property
    def deciding(self) -> bool:
        """True while a start is being decided: it is no run yet, and another one must wait."""
        return self._deciding is not None

    async def start(self, request: StartRequest) -> RunResult | Refused:
        """Accept a run, or say why not. The answer comes once the run is on the disk, before anything moves.

        Until then there is no run: nothing of it is told or found, and the cell is READY. Whatever must hold for a
        start is checked again after every wait, so that a stop, a fault or a client that has given up ends it.
        """
        key = request.idempotency_key
        if self._cancelled:
            return refused(self._host.state, RefusalReason.STOPPED, "the control process is ending: nothing starts")
        if (known := self._runs.find_key(key)) is not None:
            return RunResult(run=known, created=False)
        if self._deciding is not None and key is not None and key == self._deciding_key:
            answer = await asyncio.shield(self._deciding)
            return answer if isinstance(answer, Refused) else RunResult(run=answer.run, created=False)
        request = request.model_copy(update={"after": self._first_marks.of(key, request.after)})
        if (refusal := self._why_not(request, self._host.situation())) is not None:
            return refusal
        self._deciding_key = key
        self._deciding = asyncio.create_task(self._decide(request), name="start")
        return await asyncio.shield(self._deciding)

    @property
    def policies_settled(self) -> bool:
        """True once every policy is loaded or refused; until then a start may have to wait."""
        return self._policies.settled

    def cancel(self) -> None:
        """Give up the start and the preparation under way; every start from now on is refused."""
        self._cancelled = True
        for task in (self._deciding, self._preparation):
            if task is not None:
                task.cancel()

    def close(self) -> None:
        """Release the policies. May block for a moment."""
        self._policies.close()

    # --- decision

    async def _decide(self, request: StartRequest) -> RunResult | Refused:
        try:
            return await self._decide_alone(request)
        finally:
            self._deciding = None

    async def _decide_alone(self, request: StartRequest) -> RunResult | Refused:
        if (edited := await asyncio.to_thread(why_edited, self._config)) is not None:
            return refused(self._host.state, RefusalReason.WRONG_STATE, edited)
        try:
            policy = await asyncio.to_thread(self._policies.admit, request.recipe)
        except PolicyRefusedError as error:
            return refused(self._host.state, RefusalReason.POLICY_REFUSED, str(error))
        if (refusal := self._why_not_now(request)) is not None:
            return refusal
        run = self._runs.draft(request, policy.sha256)
        try:
            await self._journal.propose(run)
        except OSError as error:
            refusal = refused(self._host.state, RefusalReason.STORAGE, f"the run cannot be recorded: {error}")
        except asyncio.CancelledError:
            self._journal.take_back(run.id)
            raise
        else:
            refusal = self._why_not_now(request)
        if refusal is not None:
            await self._journal.withdraw(run.id)
            return refusal
        self._accept(run, policy)
        return RunResult(run=run, created=True)

    def _accept(self, run: Run, policy: Admitted) -> None:
        active = self._runs.begin(run, self._host)
        self._intake.clear_peak()
        self._host.hear_client()
        self._host.enter(CellState.PREFLIGHT)
        self._journal.tell(EventKind.RUN, self._host.state, f"accepted, {run.recipe}", run_id=run.id)
        self._preparation = asyncio.create_task(self._prepare(active, policy), name=f"prepare {run.id}")

    def _why_not_now(self, request: StartRequest) -> Refused | None:
        """Return why the start that is being decided cannot be accepted at this moment; None where it can."""
        return self._why_not(request, replace(self._host.situation(), starting=False))

    def _why_not(self, request: StartRequest, situation: Situation) -> Refused | None:
        problem = why_not_start(situation, request, self._config, self._driver.simulated)
        return None if problem is None else Refused(problem=problem)

    # --- preparation

    async def _prepare(self, active: ActiveRun, policy: Admitted) -> None:
        try:
            await self._prepare_world(active, policy)
        except Exception as error:
            _log.exception("prepare", run=active.accepted.id)
            if not active.abandoned:
                self._host.halt(FaultCode.INTERNAL, f"{type(error).__name__}: {error}")

    async def _prepare_world(self, active: ActiveRun, policy: Admitted) -> None:
        run, recipe = active.accepted, self._config.recipes[active.accepted.recipe]
        plan = plan_insertion(self._config, recipe, policy.contract)
        self.preparing = True
        failure: DriverError | None = None
        try:
            await self._driver.prepare(_task(run, recipe))
        except DriverError as error:
            failure = error
        finally:
            self.preparing = False
        self._host.enter_world(plan.limits.force_ceiling_n)
        if active.abandoned:
            return
        if failure is not None:
            self._host.end_run(RunState.FAILED, failure.code, str(failure))
            return
        active.begin(plan, policy.held)


def _task(run: Run, recipe: RecipeSection) -> Task | None:
    """Return the episode that a simulated world lays out for a run; the driver checks it. None on a real arm."""
    if run.seed is None:
        return None
    return Task(run.seed, cast("Part", recipe.part), recipe.clearance_m, recipe.conditions, plant=recipe.plant)
