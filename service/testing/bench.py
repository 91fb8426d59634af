"""A test bench around one simulated cell in lockstep, and the pytest fixture that makes one."""

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import pytest

from service.cell.cell import Cell
from service.cell.inference import InferenceKind, InlineInference
from service.cell.process import attended
from service.cell.tick_record import TickRecord
from service.config import CellConfig
from service.drivers.base import Driver
from service.messages import CellState, Event, Run, RunResult, RunState, StartRequest, Telemetry
from service.testing.in_process import InProcessDriver
from sim_backend.world.scene import NOMINAL_HOLE_M
from sim_backend.world.world import START_POSITION_M, START_YAW_RAD
from sim_backend.zenoh_cell.cell import SimulatedCell
from wire.limits import FORCE_CEILING_N, WORKSPACE_M

RECIPE = "under-test"
PATIENCE_S = 60.0
"""Simulated time in which a run of any sensible policy ends."""
LIMITS: dict[str, Any] = {
    "force_ceiling_n": FORCE_CEILING_N,
    "workspace_m": WORKSPACE_M,
}


@dataclass(slots=True)
class Bench:
    """One simulated cell and everything that it published.

    Attributes:
        cell: the cell, as a control process runs it.
        world: the simulation; `world.truth()` returns the true state, the hole included.
        records: one per policy step, oldest first.
        events: oldest first.
        telemetry: oldest first.
    """

    cell: Cell
    world: SimulatedCell
    records: list[TickRecord] = field(default_factory=list[TickRecord])
    events: list[Event] = field(default_factory=list[Event])
    telemetry: list[Telemetry] = field(default_factory=list[Telemetry])

    def on_event(self, event: Event) -> None:
        """Keep an event."""
        self.events.append(event)

    def on_telemetry(self, point: Telemetry) -> None:
        """Keep a point."""
        self.telemetry.append(point)

    def on_tick(self, record: TickRecord) -> None:
        """Keep a record."""
        self.records.append(record)

    async def until(self, condition: Callable[[], bool], limit_s: float = PATIENCE_S) -> None:
        """Let simulated time pass until `condition` holds.

        Raises:
            TimeoutError: it does not hold within `limit_s` of simulated time.
        """
        clock = self.cell.driver.clock
        deadline = clock() + limit_s
        while not condition():
            if clock() > deadline:
                raise TimeoutError(f"not within {limit_s:g} s of simulated time; the cell is {self.cell.state}")
            await asyncio.sleep(0)

    async def let_pass(self, seconds: float) -> None:
        """Let simulated time pass."""
        until = self.cell.driver.clock() + seconds
        await self.until(lambda: self.cell.driver.clock() >= until, seconds + 1.0)

    async def state(self, *states: CellState, limit_s: float = PATIENCE_S) -> None:
        """Wait until the cell is in one of `states`."""
        await self.until(lambda: self.cell.state in states, limit_s)

    async def start(self, seed: int = 0, recipe: str = RECIPE, **request: Any) -> Run:
        """Start a run; raise AssertionError with the reason where it is refused."""
        answer = await self.cell.start(StartRequest(recipe=recipe, seed=seed, **request))
        if not isinstance(answer, RunResult):
            raise AssertionError(f"start refused, {answer.problem.reason}: {answer.problem.detail}")
        return answer.run

    async def ended(self, run: Run) -> Run:
        """Wait for a run's end; return the recorded run."""
        await self.until(lambda: self._ended(run) is not None)
        await self.state(CellState.READY, CellState.LATCHED, CellState.OFFLINE)
        found = self._ended(run)
        assert found is not None  # noqa: S101  # a run that has ended stays so
        return found

    async def insert(self, seed: int = 0, recipe: str = RECIPE) -> Run:
        """Start a run and wait for its end."""
        return await self.ended(await self.start(seed, recipe))

    def _ended(self, run: Run) -> Run | None:
        found = self.cell.runs.find(run.id)
        return None if found is None or found.state is RunState.ACTIVE else found


def cell_config(state_dir: Path, policy: Path, limits: dict[str, Any] | None = None, **recipe: Any) -> CellConfig:
    """Configuration of a simulated cell with one recipe, `RECIPE`.

    Args:
        state_dir: folder for latch and ledger.
        policy: ONNX file with its contract.
        limits: fields of the configuration's `limits` that differ.
        **recipe: fields of the recipe that differ.
    """
    fields = {
        "part": "tr",
        "clearance_m": 2.0e-3,
        "policy": policy,
        "start_position_m": START_POSITION_M,
        "start_yaw_rad": START_YAW_RAD,
        "nominal_hole_m": NOMINAL_HOLE_M,
    }
    return CellConfig.model_validate(
        {
            "cell": {"id": "under-test", "state_dir": state_dir},
            "limits": LIMITS | (limits or {}),
            "recipes": {RECIPE: fields | recipe},
        }
    )


@asynccontextmanager
async def lockstep_cell(
    config: CellConfig,
    *,
    wrap: Callable[[Driver], Driver] | None = None,
    inference: InferenceKind | None = InlineInference,
    world: SimulatedCell | None = None,
) -> AsyncGenerator[Bench]:
    """Run a cell on a simulated world in this process while the context lasts. It is READY or LATCHED on entry.

    Args:
        config: of the cell. Its arm is the plain simulated one, whatever `cell.driver` says.
        wrap: puts something between cell and driver, such as a fault injector or a recorder.
        inference: how runs get their inference; None: the policy has a process of its own, as in a control process.
        world: the world to use; None: a new one with the first recipe's part.
    """
    if world is None:
        part: Any = next(iter(config.recipes.values())).part
        world = SimulatedCell(part)
    driver: Driver = InProcessDriver(world)
    if wrap is not None:
        driver = wrap(driver)
    cell = Cell(config, driver, inference=inference)
    bench = Bench(cell, world)
    cell.journal.observers.append(bench)
    async with attended(cell):
        await bench.until(lambda: cell.newest_sample is not None)
        yield bench


class SimulatedCellFactory(Protocol):
    """Type of the fixture `simulated_cell`."""

    def __call__(
        self, policy: Path, *, limits: dict[str, Any] | None = None, **recipe: Any
    ) -> AbstractAsyncContextManager[Bench]: ...


@pytest.fixture
def simulated_cell(tmp_path: Path) -> SimulatedCellFactory:
    """Make cells for one test: call it with a policy, and use the result in `async with`."""

    def make(
        policy: Path, *, limits: dict[str, Any] | None = None, **recipe: Any
    ) -> AbstractAsyncContextManager[Bench]:
        return lockstep_cell(cell_config(tmp_path / "state", policy, limits, **recipe))

    return make
