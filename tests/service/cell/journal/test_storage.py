import threading

import pytest

from service.cell.journal.storage import CAPACITY, StorageFullError, StorageThread


def test_a_disk_that_does_not_answer_never_blocks_and_is_reported(storage: StorageThread) -> None:
    begun, release = threading.Event(), threading.Event()
    storage.submit(lambda: (begun.set(), release.wait()))
    begun.wait(5.0)
    for _ in range(CAPACITY):
        storage.submit(lambda: None)
    with pytest.raises(StorageFullError, match="writes wait"):
        storage.submit(lambda: None)
    assert storage.fault is not None
    release.set()


def test_a_failed_write_is_a_fault_until_one_succeeds(storage: StorageThread) -> None:
    def fail() -> None:
        raise OSError("disk full")

    assert isinstance(storage.submit(fail).exception(5.0), OSError)
    assert storage.fault is not None
    assert "disk full" in storage.fault
    storage.submit(lambda: None).result(5.0)
    assert storage.fault is None


def test_an_owed_write_is_tried_again_and_a_fault_until_it_is_done(storage: StorageThread) -> None:
    broken, done = [True], threading.Event()

    def write() -> None:
        if broken:
            raise OSError("read-only")
        done.set()

    assert isinstance(storage.submit(write, owed=True).exception(5.0), OSError)
    storage.submit(lambda: None).result(5.0)
    assert storage.fault is not None, "another job's success does not hide it"
    assert "read-only" in storage.fault
    broken.clear()
    assert done.wait(5.0), "it is tried again by itself"
    storage.submit(lambda: None).result(5.0)
    assert storage.fault is None
