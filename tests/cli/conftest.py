"""The control process on the wire that the API's tests have, and a served API before it."""

import sys
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


@pytest.fixture(autouse=True)
def test_process_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    """`stop` ends its process at once, which here is that of the tests."""
    monkeypatch.setattr("cli.stop.leave", sys.exit)


@pytest.fixture(autouse=True)
def nothing_is_configured(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    """No variable and no file of the working directory names a cell unless the test says so."""
    monkeypatch.delenv("DSL_ASSEMBLY_URL", raising=False)
    monkeypatch.delenv("DSL_ASSEMBLY_CONFIG", raising=False)
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
