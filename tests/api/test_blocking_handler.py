"""A handler of the API that blocks its event loop: the control process judges every sample all the same."""

import asyncio
import time
from pathlib import Path

import pytest

from api.models import CellStatus
from api.runtime import Runtime
from service.messages import CellState, Status
from tests.api.wire_cell import Api, serving, until
from tests.test_end_to_end import RECIPE, config_path

__all__ = ["config_path"]

BLOCK_S = 0.25


def last(api: Api) -> Status:
    status = api.runtime.cell.last_status
    assert status is not None
    return status


async def test_49_a_handler_that_blocks_misses_no_tick_of_the_monitor(
    config_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    status = Runtime.status

    def blocking(runtime: Runtime) -> CellStatus:
        time.sleep(BLOCK_S)
        return status(runtime)

    async with serving(config_path) as api:
        await until(lambda: api.runtime.cell.client.state is CellState.READY)
        monkeypatch.setattr(Runtime, "status", blocking)
        run = (await api.http.post("/start", json={"recipe": RECIPE, "seed": 7})).json()
        await until(lambda: api.runtime.cell.client.state is CellState.RUNNING)
        before = last(api)
        for _ in range(4):
            await api.http.get("/status")
        await until(lambda: last(api).seq > before.seq + 4)
        after = last(api)
        assert after.counters.samples_missed == before.counters.samples_missed
        assert after.counters.samples_dropped == before.counters.samples_dropped
        assert before.measured is not None
        assert after.measured is not None
        seen = after.measured.sample_seq - before.measured.sample_seq
        assert seen > BLOCK_S / 0.002
        assert after.counters.samples - before.counters.samples == seen, "each of them was judged"
        async with asyncio.timeout(30):
            while (ended := (await api.http.get(f"/runs/{run['id']}")).json())["state"] == "ACTIVE":
                await asyncio.sleep(0.1)
        assert ended["state"] in {"SUCCEEDED", "FAILED"}, ended
