from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest

from service.messages import CellState
from tests.api.wire_cell import Api, WireCell, free_port, serving, write_config


@pytest.fixture
def cell_port() -> int:
    return free_port()


@pytest.fixture
def config_path(tmp_path: Path, cell_port: int) -> Path:
    return write_config(tmp_path, cell_port)


@pytest.fixture
def cell(cell_port: int) -> Iterator[WireCell]:
    with WireCell(f"tcp/127.0.0.1:{cell_port}") as cell:
        yield cell


@pytest.fixture
async def lonely_api(config_path: Path) -> AsyncIterator[Api]:
    """An API whose control process is not there."""
    async with serving(config_path) as api:
        yield api


@pytest.fixture
async def api(cell: WireCell, lonely_api: Api) -> Api:
    """An API that hears its control process, which is READY."""
    await lonely_api.wait_for_state(CellState.READY)
    return lonely_api
