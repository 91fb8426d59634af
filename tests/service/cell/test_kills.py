"""Control processes that are killed while the disk is slow or the state directory has been altered."""

import asyncio
import shutil
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from service.client import CellClient, CellSilentError
from service.faults import FaultCode
from service.messages import CellState, RunState, StartRequest, StopRequest
from tests.service.cell.conftest import EASY
from tests.service.cell.test_process import ROOT, configured, control_process, run_service, until

SLOW_DISK = """
import os, pathlib, sys, time
flag, sync = pathlib.Path(sys.argv.pop(1)), os.fsync
def slow(number):
    while flag.exists():
        time.sleep(0.01)
    sync(number)
os.fsync = slow
from cli.__main__ import app
app()
"""


@asynccontextmanager
async def on_a_slow_disk(
    path: Path, endpoint: str, slow: Path
) -> AsyncIterator[tuple[subprocess.Popen[bytes], CellClient]]:
    """Run a control process every `fsync` of which waits while the file `slow` exists."""
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", SLOW_DISK, str(slow), "control", "--config", str(path)], cwd=ROOT
    )
    try:
        async with CellClient("cell-1", [endpoint]) as client:
            await until(lambda: client.state in (CellState.READY, CellState.LATCHED), 60.0)
            yield process, client
    finally:
        process.kill()
        process.wait()


async def test_78_the_cause_of_a_stop_survives_a_kill_at_its_answer_while_the_disk_is_slow(tmp_path: Path) -> None:
    path, endpoint = configured(tmp_path)
    slow = tmp_path / "slow"
    async with on_a_slow_disk(path, endpoint, slow) as (process, client):
        run = (await client.start(StartRequest(recipe="triangle-2mm", seed=EASY))).run
        await until(lambda: client.state in (CellState.APPROACH, CellState.RUNNING))
        slow.touch()
        await client.stop(StopRequest(reason="enough", requested_by="tester"))
        process.kill()
    async with control_process(path, endpoint) as (_, client):
        status = client.last_status
        assert status is not None
        assert status.latch is not None
        assert (status.latch.code, status.latch.text) == (FaultCode.OPERATOR_STOP, "stopped by tester: enough")
        found = await client.run(run.id)
        assert (found.state, found.code) == (RunState.STOPPED, FaultCode.OPERATOR_STOP)


async def test_78_a_start_that_a_slow_disk_kept_from_its_answer_moves_nothing_afterwards(tmp_path: Path) -> None:
    path, endpoint = configured(tmp_path)
    slow = tmp_path / "slow"
    async with on_a_slow_disk(path, endpoint, slow) as (_, client):
        slow.touch()
        with pytest.raises(CellSilentError):
            await client.start(StartRequest(recipe="triangle-2mm", seed=EASY), timeout_s=1.0)
        slow.unlink()
        await until(lambda: client.last_status is not None and client.last_status.can_start)
        await asyncio.sleep(0.5)
        assert (client.state, client.last_status.run) == (CellState.READY, None)
        assert await client.runs() == ()


async def test_69_a_state_directory_that_was_deleted_in_a_run_forgets_neither_run_nor_latch(tmp_path: Path) -> None:
    path, endpoint = configured(tmp_path)
    async with control_process(path, endpoint) as (process, client):
        run = (await client.start(StartRequest(recipe="triangle-2mm", seed=EASY))).run
        await until(lambda: client.state in (CellState.APPROACH, CellState.RUNNING))
        shutil.rmtree(tmp_path / "state")
        ledger = tmp_path / "state" / "ledger.jsonl"
        await until(lambda: ledger.exists() and run.id in ledger.read_text())
        await until(lambda: any("state directory" in text for text in client.last_status.degradations))
        process.kill()
        process.wait()
    async with control_process(path, endpoint) as (_, client):
        assert client.last_status is not None
        assert client.last_status.latch is not None
        assert client.last_status.latch.code is FaultCode.INTERRUPTED
        assert (await client.run(run.id)).state is RunState.INTERRUPTED


@pytest.mark.parametrize("lost", [None, "lock", ""], ids=["locked", "lock_deleted", "directory_deleted"])
async def test_69_a_second_control_process_is_refused_before_it_starts_anything(
    tmp_path: Path, lost: str | None
) -> None:
    path, endpoint = configured(tmp_path)
    async with control_process(path, endpoint) as (_, client):
        state = tmp_path / "state"
        if lost is not None:
            (state / lost).rename(tmp_path / "moved")
        second = tmp_path / "second.toml"
        second.write_text(path.read_text().replace(endpoint, "tcp/127.0.0.1:1"))
        ended = await asyncio.to_thread(run_service, "control", "--config", str(second))
        assert ended.returncode == 3
        assert "another control process uses" in ended.stderr
        assert "started" not in ended.stderr
        assert client.state is CellState.READY
