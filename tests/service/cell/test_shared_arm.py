"""Rows 70 and 81 at the arm: others reach the simulator of a cell, with its process and their own sessions."""

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

import numpy as np
import pytest
import zenoh

from service.cell.cell import Cell
from service.cell.process import attended
from service.drivers.base import Program
from service.drivers.zenoh_sim import ZenohSimDriver
from service.faults import FaultCode
from service.messages import CellState, RunResult, StartRequest
from service.testing import RECIPE, cell_config
from sim_backend.holding import LEASE_S
from tests.service.cell import policies
from tests.service.cell.conftest import EASY
from tests.service.cell.test_process import until
from tests.service.sim_server import free_endpoint, sim_process
from wire import keys, records
from wire.session import QueryRefusedError, close_session, open_session, query

LIMITS = {"sample_age_s": 0.5, "target_age_s": 1.0, "policy_deadline_s": 0.5}
"""Time limits in a test's configuration, s: so wide that the lateness of a loaded test machine trips none of them."""
LEAST_SPEED_M_S = 1e-3
"""Average speed in the world's own time that an arm on its way has at the least; the descent is the slowest part."""
WORLD = "world-1"
COMMANDS = (records.Kind.ENGAGE, records.Kind.TARGET, records.Kind.STOP, records.Kind.ZERO_FT, records.Kind.UNLOCK)


@asynccontextmanager
async def cell_on(endpoint: str, folder: Path, name: str, mode: str = "real_time") -> AsyncIterator[Cell]:
    folder.mkdir(exist_ok=True)
    config = cell_config(folder / name, policies.still(folder), LIMITS, conditions="easy")
    cell = Cell(config, ZenohSimDriver(WORLD, [endpoint], mode, cell=name))
    async with attended(cell):
        yield cell


async def moving(cell: Cell) -> str:
    """Start a run; return its id once the arm moves."""
    await until(lambda: cell.state is CellState.READY)
    answer = await cell.start(StartRequest(recipe=RECIPE, seed=EASY))
    assert isinstance(answer, RunResult)
    await until(lambda: cell.state in (CellState.APPROACH, CellState.RUNNING, CellState.LATCHED))
    assert cell.journal.latch is None, cell.journal.latch
    return answer.run.id


async def assert_undisturbed(cell: Cell, run_id: str, seconds: float) -> None:
    """The run is under way throughout, its program engaged and its arm where the run wants it."""
    loop = asyncio.get_running_loop()
    deadline = loop.time() + seconds
    first = cell.newest_sample
    while loop.time() < deadline:
        if (latch := cell.journal.latch) is not None:
            assert latch.code in (FaultCode.STALE, FaultCode.OVERRUN), latch
            pytest.skip(f"a loaded test machine was late, so nothing is shown: {latch.text}")
        assert cell.runs.active_id == run_id
        await asyncio.sleep(0.01)
    last = cell.newest_sample
    assert first is not None
    assert last is not None
    assert (last.program, last.episode) == (Program.ENGAGED, first.episode)
    moved_m = np.abs(last.tcp_position - first.tcp_position).max()
    assert moved_m > LEAST_SPEED_M_S * (last.time_s - first.time_s), "the arm moves on"


@pytest.mark.parametrize("mode", ["real_time", "lockstep"])
async def test_81_the_second_cell_on_a_simulator_is_refused_by_the_firsts_name_and_disturbs_nothing(
    tmp_path: Path, mode: str
) -> None:
    endpoint = free_endpoint()
    async with AsyncExitStack() as stack:
        stack.enter_context(sim_process(endpoint, mode.replace("_", "-")))
        first = await stack.enter_async_context(cell_on(endpoint, tmp_path, "left", mode))
        run_id = await moving(first)
        second = await stack.enter_async_context(cell_on(endpoint, tmp_path, "right", mode))
        await until(lambda: "held by cell 'left'" in (second.status().why_not or ""))
        await assert_undisturbed(first, run_id, 0.2 if mode == "lockstep" else 1.0)
        assert second.state in (CellState.OFFLINE, CellState.CONNECTING)
        assert second.journal.latch is None
        assert first.runs.active_id == run_id


async def test_81_the_second_cell_has_the_simulator_once_the_first_has_left(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    async with AsyncExitStack() as stack:
        stack.enter_context(sim_process(endpoint))
        async with cell_on(endpoint, tmp_path, "left") as first:
            await until(lambda: first.state is CellState.READY)
            second = await stack.enter_async_context(cell_on(endpoint, tmp_path, "right"))
            await until(lambda: "held by cell 'left'" in (second.status().why_not or ""))
        await until(lambda: second.state is CellState.READY)
        await moving(second)


async def test_81_a_cell_that_was_silent_and_was_replaced_is_told_by_whom(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    async with AsyncExitStack() as stack:
        stack.enter_context(sim_process(endpoint))
        first = await stack.enter_async_context(cell_on(endpoint, tmp_path, "left"))
        await until(lambda: first.state is CellState.READY)
        driver = first.driver
        assert isinstance(driver, ZenohSimDriver)
        assert driver._holding is not None
        driver._holding.cancel()  # its process is frozen, as far as the simulator can tell
        await asyncio.sleep(LEASE_S + 0.2)
        second = await stack.enter_async_context(cell_on(endpoint, tmp_path, "right"))
        await until(lambda: second.state is CellState.READY)
        driver._holding = asyncio.create_task(driver._keep_hold(driver._session))
        await until(lambda: "held by cell 'right'" in (first.status().why_not or ""))
        assert first.state in (CellState.OFFLINE, CellState.CONNECTING)
        await moving(second)


def forged(kind: records.Kind, states: list[np.void], client: int, seq: int) -> bytes:
    """A command that would be obeyed if its sender were the holder: the right epoch, a pose in reach, a sane law."""
    state, record = states[-1], records.new(records.COMMAND, kind)
    record["client"], record["epoch"], record["seq"] = client, state["epoch"], seq
    record["position"], record["rotvec"] = state["tcp_position"] + [0.0, 0.0, 0.01], state["tcp_rotvec"]
    record["stiffness"], record["damping"], record["inertia"] = (
        [800] * 3 + [40] * 3,
        [120] * 3 + [4] * 3,
        [2] * 3 + [0.1] * 3,
    )
    record["max_speed"], record["max_step"] = [0.1, 0.5], [0.05, 0.5]
    record["workspace"] = [[-1, -1, -1], [1, 1, 1]]
    record["force_ceiling"], record["target_age"] = 50.0, 10.0
    return record.tobytes()


@asynccontextmanager
async def stranger_at(endpoint: str) -> AsyncIterator[tuple[zenoh.Session, list[np.void]]]:
    """A session that listens to every state of the world."""
    session, states = await asyncio.to_thread(open_session, connect=[endpoint]), []
    key = keys.STATE.format(world=WORLD)

    def keep(sample: zenoh.Sample) -> None:
        if str(sample.key_expr) == key:  # its own wildcards come back to it
            states.append(records.decode(sample.payload.to_bytes(), records.STATE)[0])

    session.declare_subscriber(key, keep)
    try:
        await until(lambda: states)
        yield session, states
    finally:
        await asyncio.to_thread(close_session, session)


async def test_70_commands_to_the_arm_by_another_than_the_holder_have_no_effect(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    async with AsyncExitStack() as stack:
        stack.enter_context(sim_process(endpoint))
        cell = await stack.enter_async_context(cell_on(endpoint, tmp_path, "left"))
        run_id = await moving(cell)
        session, states = await stack.enter_async_context(stranger_at(endpoint))
        seen = int(states[-1]["client"])
        assert seen, "what a state says of the holder"
        for client in (seen, 0, 12345):
            for kind in COMMANDS:
                for key in (keys.COMMAND.format(world=WORLD), "sim/**"):
                    session.put(key, forged(kind, states, client, 10**6))
        for name in ("reset", "advance?ticks=5", "release", f"reset?client={seen};seq=99"):
            with pytest.raises(QueryRefusedError, match=r"held by cell 'left'|real time"):
                await query(session, f"sim/{WORLD}/{name}", b'{"seed": 1}', 5.0)
        for selector in (f"sim/{WORLD}/res$*", "sim/*/reset", "sim/**", f"sim/*/claim?client={seen}"):
            with pytest.raises(QueryRefusedError):
                await query(session, selector, b'{"seed": 1}', 5.0)
        await assert_undisturbed(cell, run_id, 0.3)
        info = json.loads((await query(session, keys.INFO.format(world=WORLD), b"", 5.0))[0])
        assert info["holder"]["cell"] == "left"
        assert info["counters"]["commands_refused"] >= 15, "of those that no STOP had discarded before"
        ledger = tmp_path / "left" / "ledger.jsonl"
        await until(lambda: "commands or requests that were not this cell's" in ledger.read_text())


async def test_70_copies_of_the_holders_own_commands_have_no_effect(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    async with AsyncExitStack() as stack:
        stack.enter_context(sim_process(endpoint))
        cell = await stack.enter_async_context(cell_on(endpoint, tmp_path, "left"))
        await until(lambda: cell.state is CellState.READY)
        driver = cell.driver
        assert isinstance(driver, ZenohSimDriver)
        assert driver._publisher is not None
        copies: list[bytes] = []
        put = driver._publisher.put

        class Tapped:
            def put(self, payload: bytes) -> None:
                copies.append(payload)
                put(payload)

        driver._publisher = Tapped()  # type: ignore[assignment]
        run_id = await moving(cell)
        session, states = await stack.enter_async_context(stranger_at(endpoint))
        for payload in list(copies):
            session.put(keys.COMMAND.format(world=WORLD), payload)
        await assert_undisturbed(cell, run_id, 0.3)
        await cell.close()
        await until(lambda: states[-1]["program"] == records.Program.IDLE)
        rest = states[-1]["tcp_position"].copy()
        for payload in list(copies):
            session.put(keys.COMMAND.format(world=WORLD), payload)
        await asyncio.sleep(0.5)
        assert states[-1]["program"] == records.Program.IDLE
        assert np.abs(states[-1]["tcp_position"] - rest).max() < 1e-3


async def test_81_the_simulator_of_a_killed_cell_is_free_after_the_lease(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with sim_process(endpoint):
        gone = open_session(connect=[endpoint])
        claimant = json.dumps({"cell": "gone", "host": "here", "pid": 1}).encode()
        while not await query(gone, keys.CLAIM.format(world=WORLD), claimant, 0.5):
            await asyncio.sleep(0.05)
        close_session(gone)  # without a release, as a killed process leaves it
        async with cell_on(endpoint, tmp_path, "left") as cell:
            await until(lambda: "held by cell 'gone'" in (cell.status().why_not or ""))
            await until(lambda: cell.state is CellState.READY, LEASE_S + 5.0)
