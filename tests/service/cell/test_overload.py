"""The ceiling judged on the transport's thread: the arm is stopped though the loop is blocked, and the loop follows."""

import asyncio
import json
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.cell.cell import Cell
from service.cell.process import attended
from service.drivers.base import Program, Sample, StopReason
from service.drivers.zenoh_sim import ZenohSimDriver
from service.faults import FaultCode
from service.messages import CellState, RunResult, RunState, StartRequest, StopRequest
from service.testing import RECIPE, cell_config
from tests.service.cell import policies
from tests.service.cell.conftest import EASY, FaultyCell
from tests.service.cell.test_faults import with_wrench
from tests.service.cell.test_process import LIMITS, until
from tests.service.cell.test_watchdog import Witness
from tests.service.sim_server import free_endpoint
from training.environment.design import LAW
from wire import keys
from wire.session import close_session, open_session, query

CEILING_N = 9.0
ABOVE_M = 0.1215
"""Height of the TCP at which the loop is blocked: 2 mm above the block."""
BLOCKED_S = 0.3
BORNE_N = 13.0
"""True force well below the 21 N to which the arm goes on to press without a stop."""


@contextmanager
def unlimited_world(endpoint: str) -> Iterator[None]:
    """Serve a world whose arm does not stop by itself."""
    program = Path(__file__).with_name("unlimited_world.py")
    process = subprocess.Popen([sys.executable, str(program), endpoint, "world-1"], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        assert process.stdout.readline().startswith("ready")
        yield
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


@asynccontextmanager
async def approaching(tmp_path: Path, endpoint: str) -> AsyncIterator[Cell]:
    """Yield a cell that leads a slow arm by so much that it presses harder and harder on what is in its way."""
    slow = replace(LAW, damping=(1300.0, 1300.0, 1300.0, *LAW.damping[3:]))
    policy = policies.still(tmp_path, compliance=slow)
    recipe: dict[str, Any] = {"force_ceiling_n": CEILING_N, "impact_n": 90.0, "approach_speed_m_s": 0.05}
    config = cell_config(tmp_path / "state", policy, LIMITS, conditions="easy", **recipe)
    cell = Cell(config, ZenohSimDriver("world-1", [endpoint], "real_time"))
    async with attended(cell):
        await until(lambda: cell.state is CellState.READY)
        yield cell


async def test_50_an_arm_that_presses_is_stopped_at_the_ceiling_while_the_loop_is_blocked(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with unlimited_world(endpoint):
        session, witness = await asyncio.to_thread(open_session, (), [endpoint]), Witness()
        session.declare_subscriber(keys.STATE.format(world="world-1"), witness.keep)
        try:
            async with approaching(tmp_path, endpoint) as cell:
                answer = await cell.start(StartRequest(recipe=RECIPE, seed=EASY))
                assert isinstance(answer, RunResult)
                async with asyncio.timeout(15.0):
                    while cell.state is not CellState.APPROACH or witness.samples[-1].tcp_position[2] > ABOVE_M:
                        assert cell.runs.find(answer.run.id).state is RunState.ACTIVE, cell.status().run
                        await asyncio.sleep(1e-3)
                time.sleep(BLOCKED_S)
                stopped = next(one for one in reversed(witness.samples) if one.program is Program.ENGAGED)
                assert witness.samples[-1].program is not Program.ENGAGED, "stopped before the loop turns again"
                assert witness.samples[-1].stop_reason is StopReason.COMMAND, "by a command: the arm has no ceiling"
                await until(lambda: cell.state is CellState.LATCHED)
                latch, run = cell.journal.latch, cell.runs.find(answer.run.id)
                assert latch is not None
                assert run is not None
                assert (latch.code, run.code, run.state) == (FaultCode.FORCE_CEILING,) * 2 + (RunState.LATCHED,)
                assert (run.peak_force_n or 0.0) >= CEILING_N
                resting = witness.samples[-1]
                assert np.linalg.norm(resting.tcp_velocity[:3]) < 2e-3
                assert resting.command_seq == stopped.command_seq, "no later target was taken"
                truth = json.loads((await query(session, keys.TRUTH.format(world="world-1"), b"", 2.0))[0])
                assert CEILING_N / 2.0 < truth["largest_n"] < BORNE_N
        finally:
            await asyncio.to_thread(close_session, session)


def above(sample: Sample) -> Sample:
    return with_wrench(sample, fz=40.0)


def overloads_meanwhile(cell: Cell, sample: Sample) -> bool:
    """Judge a sample on another thread, without a turn of the loop."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(cell.overloads, sample.load).result()


FINDS: dict[str, Callable[[Cell], object]] = {
    "a stale link": lambda cell: cell.on_link_fault(FaultCode.STALE, "no sample for 300 ms"),
    "an operator's stop": lambda cell: cell.stop(StopRequest()),
    "an ordinary sample": lambda cell: None,
}


@pytest.mark.parametrize("finds", FINDS.values(), ids=FINDS)
async def test_50_an_overload_is_the_cause_of_the_latch_whatever_the_loop_finds_first(
    faulty_cell: FaultyCell, finds: Callable[[Cell], object]
) -> None:
    async with faulty_cell() as faulty:
        cell = faulty.bench.cell
        run = await faulty.running()
        assert overloads_meanwhile(cell, above(faulty.driver.truth))
        finds(cell)
        ended = await faulty.assert_latched(run, FaultCode.FORCE_CEILING)
        assert ended.text.startswith("force 40")


async def test_50_an_overload_is_judged_in_a_run_alone_and_by_its_ceiling(faulty_cell: FaultyCell) -> None:
    async with faulty_cell(force_ceiling_n=20.0, impact_n=30.0) as faulty:
        cell, driver = faulty.bench.cell, faulty.driver
        assert not cell.overloads(above(driver.truth).load), "READY: the loop judges"
        await faulty.running()
        assert cell.overloads(with_wrench(driver.truth, fz=21.0).load)
        assert not cell.overloads(with_wrench(driver.truth, fz=19.0).load)
        assert not cell.overloads(with_wrench(driver.truth, fz=float("nan")).load), "no sample to stop for by its force"
        assert not cell.overloads(replace(above(driver.truth), epoch=driver.truth.epoch + 1).load), "another's sample"
        await faulty.bench.state(CellState.LATCHED)
        assert not cell.overloads(above(driver.truth).load), "latched: nothing is under way"


async def test_50_an_overload_is_the_cause_although_the_process_is_told_to_end_first(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        cell = faulty.bench.cell
        run = await faulty.running()
        assert overloads_meanwhile(cell, above(faulty.driver.truth))
        await cell.close()
        latch, ended = cell.journal.latch, cell.runs.find(run.id)
        assert latch is not None
        assert ended is not None
        assert (latch.code, ended.code) == (FaultCode.FORCE_CEILING,) * 2


async def test_a_turn_of_the_watch_latches_an_overload_though_no_sample_comes(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        cell = faulty.bench.cell
        run = await faulty.running()
        assert overloads_meanwhile(cell, above(faulty.driver.truth))
        cell.watch()
        assert cell.state is CellState.STOPPING
        await faulty.assert_latched(run, FaultCode.FORCE_CEILING)
