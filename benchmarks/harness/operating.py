"""An operator's actions for measurements of the real processes: wait for a state, start, reset."""

import asyncio
import contextlib
import time
from collections import Counter

from benchmarks.harness.result import UnavailableError
from service.client import CellClient, CellRefusedError, CellSilentError
from service.messages import CellState, RefusalReason, ResetRequest, RunState, StartRequest

STATE_TIMEOUT_S = 60.0
POLL_S = 0.005


class LatchedError(Exception):
    """The cell latched by itself; on a loaded host its own watch causes that. Reset it and continue."""


async def until(client: CellClient, *wanted: CellState) -> CellState:
    """Wait for one of several states.

    Raises:
        LatchedError: the cell latches although that was not awaited.
        UnavailableError: none of the states comes.
    """
    deadline = time.monotonic() + STATE_TIMEOUT_S
    while client.state not in wanted:
        status = client.last_status
        if client.state is CellState.LATCHED and status is not None and status.latch is not None:
            raise LatchedError(status.latch.code)
        if time.monotonic() > deadline:
            raise UnavailableError(f"the cell is {client.state}, where {' or '.join(wanted)} was awaited")
        await asyncio.sleep(POLL_S)
    return client.state


async def start(client: CellClient, recipe: str, seed: int) -> str:
    """Start a run once the cell is READY; return its id.

    Raises:
        LatchedError: the cell has latched.
        UnavailableError: the start is refused.
    """
    while True:
        await until(client, CellState.READY)
        try:
            return (await client.start(StartRequest(recipe=recipe, seed=seed))).run.id
        except CellRefusedError as error:
            if error.problem.reason is RefusalReason.LATCHED:
                raise LatchedError(str(error.problem.code)) from error
            if error.problem.reason is not RefusalReason.WRONG_STATE:  # READY was half a heartbeat ago
                raise UnavailableError(f"the run was refused: {error}") from error
        await asyncio.sleep(POLL_S)


async def approach(client: CellClient, recipe: str, seed: int) -> bool:
    """Start a run and wait until the arm moves; return False if the run fails its pre-flight instead.

    Raises:
        LatchedError: the cell latches.
    """
    run_id = await start(client, recipe, seed)
    while True:
        status = client.last_status
        if status is not None and status.run is not None and status.run.id == run_id:
            if status.run.state is RunState.LATCHED:
                raise LatchedError(str(status.run.code))
            if status.run.state is not RunState.ACTIVE:
                return False
            if status.state is CellState.APPROACH:
                return True
        await asyncio.sleep(POLL_S)


async def insert_repeatedly(client: CellClient, recipe: str, seconds: float) -> Counter[str]:
    """Insert until the time is over, and reset what latches; return how often each fault latched."""
    until_s = time.monotonic() + seconds
    latches: Counter[str] = Counter()
    seed = 0
    while time.monotonic() < until_s:
        status = client.last_status
        if client.state is CellState.LATCHED and status is not None and status.latch is not None:
            latches[status.latch.code] += 1
            await reset(client)
        elif client.state is CellState.READY:
            with contextlib.suppress(LatchedError):
                await start(client, recipe, seed)
            seed += 1
        await asyncio.sleep(0.05)
    return latches


async def reset(client: CellClient) -> None:
    """Reset once the stop is complete and the arm at rest.

    Raises:
        UnavailableError: the reset stays refused.
    """
    await until(client, CellState.LATCHED)
    deadline = time.monotonic() + STATE_TIMEOUT_S
    while True:
        try:
            answered = await client.reset(ResetRequest())
        except (CellRefusedError, CellSilentError) as error:
            if time.monotonic() > deadline:
                raise UnavailableError(f"the reset was refused: {error}") from error
            await asyncio.sleep(0.05)
        else:
            break
    while (heard := client.last_status) is None or heard.seq < answered.seq:  # earlier heartbeats are still arriving
        await asyncio.sleep(POLL_S)
