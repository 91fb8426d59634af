import asyncio
import json
import sqlite3
from pathlib import Path

import pytest

from api.history import HistoryError, RunHistory
from service.messages import Run, RunState


def run(state: RunState = RunState.ACTIVE) -> Run:
    return Run(id="run-1", recipe="tr-2mm", seed=1, state=state, requested_at=1.0)


def url(folder: Path) -> str:
    return f"sqlite+aiosqlite:///{folder / 'runs.sqlite'}"


async def test_an_ended_run_never_becomes_active_again(tmp_path: Path) -> None:
    history = RunHistory(url(tmp_path))
    await history.open()
    await history.record([run(RunState.SUCCEEDED)])
    await history.record([run(RunState.ACTIVE)])
    found = await history.find("run-1")
    await history.close()
    assert found is not None
    assert found.state is RunState.SUCCEEDED


async def test_a_locked_database_is_told_and_the_run_is_written_once_it_is_free(tmp_path: Path) -> None:
    history = RunHistory(url(tmp_path))
    await history.open()
    lock = sqlite3.connect(tmp_path / "runs.sqlite", isolation_level=None)
    lock.execute("BEGIN EXCLUSIVE")
    history.put(run())
    with pytest.raises(HistoryError, match="locked"):
        await history.check()
    with pytest.raises(HistoryError, match="locked"):
        await history.flush()
    lock.execute("ROLLBACK")
    lock.close()
    await history.check()
    writer = asyncio.create_task(history.write_forever())
    async with asyncio.timeout(15):
        while await history.find("run-1") is None:
            await asyncio.sleep(0.02)
    writer.cancel()
    await asyncio.gather(writer, return_exceptions=True)
    await history.close()
    assert history.problem is None


async def test_79_a_database_of_an_older_version_opens_and_its_runs_stand_before_the_numbered_ones(
    tmp_path: Path,
) -> None:
    database = sqlite3.connect(tmp_path / "runs.sqlite")
    database.execute(
        "CREATE TABLE runs (id VARCHAR(64) NOT NULL PRIMARY KEY, requested_at FLOAT NOT NULL, recipe VARCHAR(64) "
        "NOT NULL, state VARCHAR(16) NOT NULL, code VARCHAR(32), document JSON NOT NULL)"
    )
    database.execute("CREATE INDEX runs_newest_first ON runs (requested_at, id)")
    for number in (1, 2):
        document = run(RunState.SUCCEEDED).model_dump(mode="json") | {
            "id": f"old-{number}",
            "requested_at": 1e9 + number,
        }
        del document["seq"]
        values = (f"old-{number}", 1e9 + number, "tr-2mm", "SUCCEEDED", None, json.dumps(document))
        database.execute("INSERT INTO runs VALUES (?, ?, ?, ?, ?, ?)", values)
    database.commit()
    database.close()
    history = RunHistory(url(tmp_path))
    await history.open()
    await history.record([run().model_copy(update={"seq": 1})])
    assert history.problem is None
    assert [found.id for found in await history.newest(10)] == ["run-1", "old-2", "old-1"]
    assert [found.id for found in await history.newest(10, before="old-2")] == ["old-1"]
    await history.close()


async def test_a_folder_that_cannot_be_made_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    history = RunHistory(f"sqlite+aiosqlite:///{tmp_path / 'file' / 'runs.sqlite'}")
    await history.open()
    with pytest.raises(HistoryError, match=r"runs\.sqlite"):
        await history.check()
    await history.close()


@pytest.mark.parametrize("wrong", ["postgresql+asyncpg://host/db", "sqlite+aiosqlite://", "sqlite:///file"])
def test_another_database_is_refused_by_name_of_the_field(wrong: str) -> None:
    with pytest.raises(ValueError, match=r"api\.database"):
        RunHistory.check_url(wrong)
