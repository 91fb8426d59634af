"""A slow disk and a state directory that others alter: nothing moves for a client that was told no."""

import asyncio
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from service.cell.journal.ledger import FILE_NAME
from service.faults import FaultCode
from service.messages import CellState, RefusalReason, Refused, ResetRequest, StartRequest, StatusResult, StopRequest
from service.testing import RECIPE, Bench
from tests.service.cell.conftest import EASY
from tests.service.cell.raced_cell import (
    assert_no_run_was_told,
    assert_nothing_moves,
    ends_well,
    ready_cell,
    reason_of,
)


@contextmanager
def held_disk(monkeypatch: pytest.MonkeyPatch) -> Iterator[threading.Event]:
    """Hold every `fsync` of this process until the event is set, or the context ends."""
    release, sync = threading.Event(), os.fsync

    def slow(number: int) -> None:
        release.wait(30.0)
        sync(number)

    monkeypatch.setattr(os, "fsync", slow)
    try:
        yield release
    finally:
        release.set()
        monkeypatch.setattr(os, "fsync", sync)


async def waiting_for_the_disk(bench: Bench, **request: Any) -> asyncio.Task[Any]:
    start = asyncio.create_task(bench.cell.start(StartRequest(recipe=RECIPE, seed=EASY, **request)))
    await bench.until(lambda: b'"run"' in (bench.cell.config.cell.state_dir / FILE_NAME).read_bytes())
    await bench.let_pass(0.1)
    assert not start.done()
    assert_no_run_was_told(bench)
    assert not bench.cell.status().can_start
    return start


async def test_78_a_stop_while_a_start_waits_for_the_disk_refuses_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with ready_cell(tmp_path) as (bench, driver):
        with held_disk(monkeypatch) as release:
            start = await waiting_for_the_disk(bench)
            assert bench.cell.stop(StopRequest()).status.state is CellState.READY
            release.set()
            assert reason_of(await start) is RefusalReason.STOPPED
        await assert_nothing_moves(bench, driver)
        assert_no_run_was_told(bench)
    async with ready_cell(tmp_path) as (bench, _):
        assert bench.cell.journal.latch is None, "the next process knows that it was refused"
        assert_no_run_was_told(bench)


async def test_78_a_start_whose_client_gave_up_while_the_disk_was_slow_moves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with ready_cell(tmp_path) as (bench, driver):
        clock = bench.cell.journal.clock
        with held_disk(monkeypatch) as release:
            start = await waiting_for_the_disk(bench, valid_until=clock() + 8.0, idempotency_key="k")
            monkeypatch.setattr(bench.cell.journal, "clock", lambda: clock() + 12.0)
            release.set()
            assert reason_of(await start) is RefusalReason.EXPIRED
        await assert_nothing_moves(bench, driver)
        assert_no_run_was_told(bench)
        await ends_well(bench, idempotency_key="k")


async def test_78_a_latch_while_a_start_waits_for_the_disk_refuses_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with ready_cell(tmp_path) as (bench, driver):
        with held_disk(monkeypatch) as release:
            start = await waiting_for_the_disk(bench)
            bench.cell.halt(FaultCode.FORCE_CEILING, "injected")
            await bench.state(CellState.LATCHED)
            release.set()
            assert reason_of(await start) is RefusalReason.LATCHED
        await assert_nothing_moves(bench, driver)


async def test_51_a_slow_disk_refuses_starts_with_the_reason_and_a_stop_works(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with ready_cell(tmp_path) as (bench, driver):
        run = await bench.start(EASY)
        await bench.state(CellState.APPROACH)
        monkeypatch.setattr("service.cell.journal.storage.SLOW_S", 0.2)
        with held_disk(monkeypatch) as release:
            status = bench.cell.stop(StopRequest()).status
            assert status.state is CellState.STOPPING
            await bench.state(CellState.LATCHED)
            async with asyncio.timeout(10):
                while not bench.cell.status().degradations:
                    await asyncio.sleep(0.01)
            assert "has not answered" in bench.cell.status().degradations[-1]
            monkeypatch.setattr("service.cell.journal.journal.RESET_S", 0.2)
            assert reason_of(await bench.cell.reset(ResetRequest())) is RefusalReason.STORAGE
            release.set()
        async with asyncio.timeout(10):
            while bench.cell.journal.fault is not None:
                await asyncio.sleep(0.01)
        assert isinstance(await bench.cell.reset(ResetRequest()), StatusResult)
        found = bench.cell.journal.find(run.id)
        assert found is not None
        assert found.code is FaultCode.OPERATOR_STOP
        assert len(driver.said("engage")) == 1


# --- a state directory that others alter


@pytest.mark.parametrize("name", [FILE_NAME, "latch.json", ""], ids=["ledger", "latch", "directory"])
async def test_69_what_was_moved_away_is_said_and_refuses_every_start(tmp_path: Path, name: str) -> None:
    async with ready_cell(tmp_path) as (bench, driver):
        (tmp_path / "state" / name).rename(tmp_path / "moved")
        answer = await bench.cell.start(StartRequest(recipe=RECIPE, seed=EASY))
        async with asyncio.timeout(10):
            while not bench.cell.status().degradations:
                await asyncio.sleep(0.01)
        assert "was altered, moved or deleted" in bench.cell.status().degradations[-1]
        if name != "latch.json":
            assert reason_of(answer) is RefusalReason.STORAGE, "it was asked for at once, and wanted its line there"
            await assert_nothing_moves(bench, driver)
        if isinstance(answer, Refused):
            again = await bench.cell.start(StartRequest(recipe=RECIPE, seed=EASY))
            assert reason_of(again) is RefusalReason.STORAGE
