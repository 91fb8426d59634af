"""The control process on the wire that the API's tests have, and a served API before it."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.api.conftest import cell, cell_port, config_path
from tests.api.wire_cell import WireCell, free_port
from tests.cli.serving import served, wait_for_state

__all__ = ["cell", "cell_port", "config_path"]


@pytest.fixture
def url(config_path: Path, cell: WireCell) -> Iterator[str]:
    """Address of an API that hears its control process, which is READY."""
    port = free_port()
    with served(config_path, port):
        address = f"http://127.0.0.1:{port}"
        wait_for_state(address, "READY")
        yield address
