import threading
import time
from collections.abc import Callable, Iterator

import pytest

from service.cell.journal import storage as module
from service.cell.journal.storage import CAPACITY, Storage, StorageFullError

Made = Callable[..., Storage]


@pytest.fixture
def made() -> Iterator[Made]:
    storages: list[Storage] = []

    def make(
        sync: Callable[[], object] = lambda: None, attend: Callable[[bool], bool] = lambda failed: False
    ) -> Storage:
        storages.append(Storage("file", sync, attend))
        return storages[-1]

    yield make
    for storage in storages:
        storage.close(5.0)


def test_51_a_disk_that_does_not_answer_never_blocks_and_is_reported(made: Made) -> None:
    storage = made()
    begun, release = threading.Event(), threading.Event()
    storage.submit(lambda: (begun.set(), release.wait()))
    begun.wait(5.0)
    for _ in range(CAPACITY):
        storage.submit(lambda: None)
    with pytest.raises(StorageFullError, match="writes wait"):
        storage.submit(lambda: None)
    assert storage.fault is not None
    release.set()


@pytest.mark.parametrize("what", ["write", "sync"])
def test_51_a_disk_that_takes_long_is_a_fault_while_it_does(
    made: Made, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    monkeypatch.setattr(module, "SLOW_S", -1.0)
    begun, release = threading.Event(), threading.Event()

    def slow() -> None:
        begun.set()
        release.wait()

    storage = made(sync=slow if what == "sync" else lambda: None)
    written = storage.submit(slow if what == "write" else lambda: None)
    begun.wait(5.0)
    assert storage.fault is not None
    assert "has not answered" in storage.fault
    release.set()
    written.synced.result(5.0)


def test_78_a_write_is_kept_while_the_sync_of_an_earlier_one_is_still_under_way(made: Made) -> None:
    release = threading.Event()
    storage = made(sync=lambda: release.wait())
    first = storage.submit(lambda: None)
    first.kept.result(5.0)
    second = storage.submit(lambda: None)
    second.kept.result(5.0)
    assert not first.synced.done()
    assert not second.synced.done()
    release.set()
    second.synced.result(5.0)


def test_a_failed_write_is_a_fault_until_one_succeeds(made: Made) -> None:
    storage = made()

    def fail() -> None:
        raise OSError("disk full")

    assert isinstance(storage.submit(fail).synced.exception(5.0), OSError)
    assert storage.fault is not None
    assert "disk full" in storage.fault
    storage.submit(lambda: None).synced.result(5.0)
    assert storage.fault is None


def test_51_a_fault_of_the_disk_ends_by_itself_once_the_file_can_be_written_again(made: Made) -> None:
    broken = [True]

    def write() -> None:
        if broken:
            raise OSError("disk full")

    def attend(failed: bool) -> bool:
        if failed:
            write()
        return failed

    storage = made(attend=attend)
    storage.submit(write).synced.exception(5.0)
    assert storage.fault is not None
    broken.clear()
    while storage.fault is not None:
        time.sleep(0.01)


def test_an_owed_write_is_tried_again_and_a_fault_until_it_is_done(made: Made) -> None:
    storage, broken, done = made(), [True], threading.Event()

    def write() -> None:
        if broken:
            raise OSError("read-only")
        done.set()

    assert isinstance(storage.submit(write, owed=True).synced.exception(5.0), OSError)
    storage.submit(lambda: None).synced.result(5.0)
    assert storage.fault is not None, "another write's success does not hide it"
    assert "read-only" in storage.fault
    broken.clear()
    assert done.wait(5.0), "it is tried again by itself"
    storage.submit(lambda: None).synced.result(5.0)
    assert storage.fault is None


def test_an_owed_write_that_was_replaced_by_a_newer_one_never_comes_after_it(made: Made) -> None:
    written: list[int] = []
    broken = [True]

    def first() -> None:
        if broken:
            raise OSError("read-only")
        written.append(1)

    storage = made()
    storage.submit(first, owed=True).synced.exception(5.0)
    storage.submit(lambda: written.append(2), owed=True).synced.result(5.0)
    broken.clear()
    storage.submit(lambda: None).synced.result(5.0)
    assert written == [2]


def test_a_write_that_nobody_waits_for_any_more_is_carried_out(made: Made) -> None:
    written: list[int] = []
    job = made().submit(lambda: written.append(1))
    assert not job.synced.cancel()
    job.synced.result(5.0)
    assert written == [1]
