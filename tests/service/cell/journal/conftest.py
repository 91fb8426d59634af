from collections.abc import Iterator

import pytest

from service.cell.journal.storage import StorageThread


@pytest.fixture
def storage() -> Iterator[StorageThread]:
    thread = StorageThread()
    yield thread
    thread.close(5.0)
