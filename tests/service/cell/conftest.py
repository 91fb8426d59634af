from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.cell.inference import InlineInference
from service.config import CellConfig, ClientLossSection
from service.faults import FaultCode
from service.messages import CellState, Run
from service.testing import Bench, SimulatedCellFactory, cell_config, lockstep_cell
from tests.service.cell import policies
from tests.service.cell.faulty_driver import FaultyDriver, Wrapping, speed
from tests.service.drivers.ur.emulated import lockstep_ur_cell, ur_cell_config

EASY = 1872
"""A seed of the easy conditions whose hole is where the camera says and turned by next to nothing."""


@dataclass
class FaultyBench:
    """A cell whose driver can be spoilt."""

    bench: Bench
    driver: FaultyDriver
    state_dir: Path

    async def running(self, seed: int = EASY, steps: int = 5) -> Run:
        """Start a run and let the policy take some steps."""
        run = await self.bench.start(seed)
        await self.bench.until(lambda: len(self.bench.records) >= steps or self.bench.cell.journal.latch is not None)
        assert self.bench.cell.journal.latch is None, self.bench.cell.journal.latch
        return run

    async def assert_latched(self, run: Run, code: FaultCode) -> Run:
        """Assert what LATCH(code) means, in the motion and in the record."""
        bench, driver = self.bench, self.driver
        stopped_at = driver.said("stop")[-1] if bench.cell.state is CellState.LATCHED else None
        await bench.state(CellState.LATCHED)
        first_stop = min(time_s for time_s in driver.said("stop") if time_s >= self._fault_time(run))
        assert [t for t in driver.said("target") if t > first_stop] == [], "no motion command follows the stop"
        assert stopped_at is None or stopped_at >= first_stop
        latch = bench.cell.journal.latch
        assert latch is not None
        assert latch.code is code
        assert latch.run_id == run.id
        ended = bench.cell.runs.find(run.id)
        assert ended is not None
        assert ended.code is code
        assert driver.truth is not None
        resting = driver.truth.tcp_position
        await bench.let_pass(0.3)
        assert speed(driver.truth) < 2e-3
        assert np.abs(driver.truth.tcp_position - resting).max() < 2e-4, "the arm stands, by measurement"
        return ended

    def _fault_time(self, run: Run) -> float:
        return max(0.0, self.driver.said("engage")[-1] if self.driver.said("engage") else 0.0)


FaultyCell = Callable[..., Any]


@dataclass(frozen=True)
class Arm:
    """The arm behind the driver: the same world, reached in another way."""

    config: Callable[..., CellConfig]
    cell: Callable[..., AbstractAsyncContextManager[Bench]]


ARMS = {"simulated": Arm(cell_config, lockstep_cell), "ur": Arm(ur_cell_config, lockstep_ur_cell)}


@pytest.fixture(params=ARMS)
def arm(request: pytest.FixtureRequest) -> Arm:
    """Every test of the cell runs on each arm."""
    return ARMS[request.param]


@pytest.fixture
def simulated_cell(arm: Arm, tmp_path: Path) -> SimulatedCellFactory:
    """`service.testing.simulated_cell`, on each arm."""

    def make(policy: Path, *, limits: dict[str, Any] | None = None, **recipe: Any) -> Any:
        return arm.cell(arm.config(tmp_path / "state", policy, limits, **recipe))

    return make


@pytest.fixture
def faulty_cell(arm: Arm, tmp_path: Path) -> FaultyCell:
    """Cells whose driver can be spoilt: `async with faulty_cell() as faulty`."""

    @asynccontextmanager
    async def make(
        policy: Path | None = None,
        *,
        real_time: bool = False,
        limits: dict[str, Any] | None = None,
        inference: Any = InlineInference,
        client_loss: ClientLossSection | None = None,
        **recipe: Any,
    ) -> AsyncIterator[FaultyBench]:
        wrap = Wrapping(FaultyDriver)
        recipe.setdefault("conditions", "easy")
        config = arm.config(tmp_path / "state", policy or policies.straight(tmp_path), limits, **recipe)
        if client_loss is not None:
            config = config.model_copy(update={"client_loss": client_loss})
        async with arm.cell(config, wrap=wrap, inference=inference) as bench:
            # Only now: the cell's own watch would go by the host's time, which here is not the arm's
            wrap.driver.real_time = real_time
            yield FaultyBench(bench, wrap.driver, tmp_path / "state")

    return make
