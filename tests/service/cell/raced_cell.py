"""A cell in lockstep whose starts are raced, and what must hold of it: its arm, the orders, the record, the answers."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np

from service.messages import CellState, EventKind, Message, RefusalReason, Refused, RunState
from service.testing import Bench, cell_config, lockstep_cell
from tests.service.cell import policies
from tests.service.cell.conftest import EASY
from tests.service.cell.faulty_driver import FaultyDriver, Wrapping


@asynccontextmanager
async def ready_cell(tmp_path: Path) -> AsyncIterator[tuple[Bench, FaultyDriver]]:
    wrap = Wrapping(FaultyDriver)
    config = cell_config(tmp_path / "state", policies.straight(tmp_path), conditions="easy")
    async with lockstep_cell(config, wrap=wrap) as bench:
        await bench.state(CellState.READY)
        yield bench, wrap.driver


async def assert_nothing_moves(bench: Bench, driver: FaultyDriver) -> None:
    assert driver.truth is not None
    before = driver.truth.tcp_position
    await bench.let_pass(1.0)
    assert np.abs(driver.truth.tcp_position - before).max() < 2e-4
    assert driver.said("engage") == driver.said("target") == []
    assert bench.cell.runs.active is None


def assert_no_run_was_told(bench: Bench) -> None:
    assert bench.cell.journal.newest(100) == ()
    assert bench.cell.status().run is None
    assert [event for event in bench.events if event.kind is EventKind.RUN or event.run_id] == []


def reason_of(answer: Message) -> RefusalReason:
    assert isinstance(answer, Refused), answer
    return answer.problem.reason


async def ends_well(bench: Bench, **request: Any) -> None:
    """A start that was received after the stop is carried out."""
    assert (await bench.ended(await bench.start(EASY, **request))).state is RunState.SUCCEEDED
