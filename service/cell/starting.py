"""The start of a run: accepted, recorded, and its world prepared, before anything moves."""

import asyncio
from typing import Protocol, cast

import structlog

from service.cell.admission import Situation, refused, why_not_start
from service.cell.inference import PolicyOpener
from service.cell.intake import Intake
from service.cell.journal import Journal
from service.cell.plan import plan_insertion
from service.cell.policies import Admitted, PolicyRefusedError, PolicyShelf
from service.cell.runs import ActiveRun, RunHost, Runs
from service.config import CellConfig, RecipeSection
from service.drivers.base import Driver, DriverError
from service.faults import FaultCode
from service.messages import CellState, EventKind, RefusalReason, Refused, Run, RunResult, RunState, StartRequest
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
        self._preparation: asyncio.Task[None] | None = None
        self.preparing = False

    async def start(self, request: StartRequest) -> RunResult | Refused:
        """Accept a run, or say why not. The answer comes once the run is on the disk, before anything moves."""
        if (known := self._runs.find_key(request.idempotency_key)) is not None:
            return RunResult(run=known, created=False)
        problem = why_not_start(self._host.situation(), request, self._config, self._driver.simulated)
        if problem is not None:
            return Refused(problem=problem)
        if self._has_expired(request):
            return self._refuse(RefusalReason.EXPIRED, "the start arrived after its valid_until: ask again")
        self._host.hear_client()
        self._host.enter(CellState.PREFLIGHT)
        active = self._runs.begin(request, self._host)
        self._intake.clear_peak()
        try:
            policy = await asyncio.to_thread(self._policies.admit, request.recipe)
        except PolicyRefusedError as error:
            return self._take_back(active, RefusalReason.POLICY_REFUSED, str(error))
        if self._has_expired(request):
            return self._take_back(active, RefusalReason.EXPIRED, "loading the policy took too long: ask again")
        if not active.abandoned:
            active.accepted = active.accepted.model_copy(update={"policy_sha256": policy.sha256})
            try:
                await self._record(active)
            except OSError as error:
                return self._take_back(active, RefusalReason.STORAGE, f"the run cannot be recorded: {error}")
        if active.abandoned:
            return self._stopped(active)
        self._journal.tell(EventKind.RUN, self._host.state, f"accepted, {request.recipe}", run_id=active.accepted.id)
        self._preparation = asyncio.create_task(self._prepare(active, policy), name=f"prepare {active.accepted.id}")
        return RunResult(run=active.accepted, created=True)

    def cancel(self) -> None:
        """Give up the preparation under way."""
        if self._preparation is not None:
            self._preparation.cancel()

    def close(self) -> None:
        """Release the policies. May block for a moment."""
        self._policies.close()

    # --- acceptance

    async def _record(self, active: ActiveRun) -> None:
        recorded = self._journal.record(active.accepted)
        if recorded is None:
            raise OSError(self._journal.fault)
        await asyncio.wrap_future(recorded)

    def _take_back(self, active: ActiveRun, reason: RefusalReason, detail: str) -> RunResult | Refused:
        """Refuse after all, unless a stop came first: then there is a run, and it was stopped."""
        if active.abandoned:
            return self._stopped(active)
        self._runs.take_back()
        self._host.enter(CellState.READY)
        return self._refuse(reason, detail)

    def _stopped(self, active: ActiveRun) -> RunResult:
        return RunResult(run=self._runs.find(active.accepted.id) or active.accepted, created=True)

    def _refuse(self, reason: RefusalReason, detail: str) -> Refused:
        return refused(self._host.state, reason, detail)

    def _has_expired(self, request: StartRequest) -> bool:
        return request.valid_until is not None and self._journal.time_of_day() > request.valid_until

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
    return Task(run.seed, cast("Part", recipe.part), recipe.clearance_m, recipe.conditions)
