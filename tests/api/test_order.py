"""Starts that wait in this server while a stop goes by: the stop wins, whatever the start waited for."""

import asyncio
import shutil
import socket
import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from api.cell import FROZEN_S
from service.messages import CellState, Run, RunState, StopRequest
from tests.api.wire_cell import RECIPE, Api, WireCell, serving

BODY = b'{"recipe": "%s"}' % RECIPE.encode()
HEAD = (
    b"POST /start HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Type: application/json\r\n"
    b"Content-Length: %d\r\n\r\n" % len(BODY)
)


@contextmanager
def busy_history(config_path: Path) -> Iterator[None]:
    """Hold the lock of the database while the context lasts."""
    lock = sqlite3.connect(config_path.parent / "var" / "runs.sqlite", isolation_level=None)
    lock.execute("BEGIN EXCLUSIVE")
    try:
        yield
    finally:
        lock.execute("ROLLBACK")
        lock.close()


@pytest.mark.parametrize("delivered", [True, False], ids=["delivered", "not_delivered"])
async def test_61_a_start_that_waits_for_the_history_does_not_survive_a_stop(
    api: Api, cell: WireCell, config_path: Path, delivered: bool
) -> None:
    with busy_history(config_path):
        start = asyncio.create_task(api.http.post("/start", json={"recipe": RECIPE}))
        await asyncio.sleep(0.3)
        cell.deaf = not delivered
        stop = await api.http.post("/stop") if delivered else None
        if not delivered:
            stopping = asyncio.create_task(api.http.post("/stop"))
            await asyncio.sleep(0.1)
    answer = await start
    assert (answer.status_code, answer.json()["reason"]) == (409, "STOPPED")
    assert not cell.runs
    if stop is not None:
        assert stop.status_code == 200
    else:
        assert (await stopping).status_code == 503
    cell.deaf = False
    assert (await api.http.post("/start", json={"recipe": RECIPE})).status_code == 202, "asked for after the stop"


async def test_61_a_start_that_waits_for_the_history_does_not_survive_a_stop_past_this_server(
    api: Api, cell: WireCell, config_path: Path
) -> None:
    with busy_history(config_path):
        start = asyncio.create_task(api.http.post("/start", json={"recipe": RECIPE}))
        await asyncio.sleep(0.3)
        await api.runtime.cell.stopper.stop(StopRequest(reason="past the API"))
        await asyncio.sleep(0.3)  # by now this server has heard of it
    assert (await start).json()["reason"] == "STOPPED"
    assert not cell.runs


async def test_61_a_start_that_is_repeated_under_its_key_is_as_old_as_the_first_that_this_server_refused(
    api: Api, cell: WireCell, config_path: Path
) -> None:
    key = {"Idempotency-Key": "k"}
    with busy_history(config_path):
        first = await api.http.post("/start", json={"recipe": RECIPE}, headers=key)
    assert (first.status_code, first.json()["reason"]) == (503, "STORAGE")
    assert (await api.http.post("/stop")).status_code == 200
    again = await api.http.post("/start", json={"recipe": RECIPE}, headers=key)
    assert (again.status_code, again.json()["reason"]) == (409, "STOPPED")
    assert not cell.runs
    started = await api.http.post("/start", json={"recipe": RECIPE}, headers={"Idempotency-Key": "another"})
    assert started.status_code == 202


async def test_61_a_start_whose_body_comes_after_a_stop_is_refused(api: Api, cell: WireCell) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", api.port)
    writer.write(HEAD)
    await writer.drain()
    await asyncio.sleep(0.3)
    assert (await api.http.post("/stop")).status_code == 200
    writer.write(BODY)
    answer = await reader.read()
    writer.close()
    assert b" 409 " in answer.splitlines()[0]
    assert b"STOPPED" in answer
    assert not cell.runs


async def test_61_a_start_that_lay_unread_while_this_server_was_frozen_does_not_survive_a_stop_past_it(
    api: Api, cell: WireCell
) -> None:
    with socket.create_connection(("127.0.0.1", api.port)) as connection:
        await asyncio.sleep(0.1)
        connection.sendall(HEAD + BODY)
        cell.stop("past the API")
        time.sleep(2.0 * FROZEN_S)  # this loop is the server's: it stands still, while Zenoh's threads go on
        connection.setblocking(False)
        answer = await asyncio.get_running_loop().sock_recv(connection, 4096)
    assert b" 409 " in answer.splitlines()[0]
    assert not cell.runs


async def test_61_a_start_whose_client_has_gone_before_it_was_sent_on_is_not_sent_on(
    api: Api, cell: WireCell, config_path: Path
) -> None:
    with busy_history(config_path):
        start = asyncio.create_task(api.http.post("/start", json={"recipe": RECIPE}, timeout=0.3))
        await asyncio.gather(start, return_exceptions=True)
    await asyncio.sleep(1.5)
    assert not cell.runs


async def test_52_a_locked_history_refuses_a_start_with_the_reason_and_a_stop_works(
    api: Api, cell: WireCell, config_path: Path
) -> None:
    with busy_history(config_path):
        refused = await api.http.post("/start", json={"recipe": RECIPE})
        assert (refused.status_code, refused.json()["reason"]) == (503, "STORAGE")
        assert "locked" in refused.json()["detail"]
        assert (await api.http.post("/stop")).status_code == 200
    assert not cell.runs
    assert (await api.http.post("/start", json={"recipe": RECIPE})).status_code == 202


@pytest.mark.parametrize("whole", [True, False], ids=["the_folder", "the_file"])
async def test_69_a_history_that_was_taken_away_is_made_anew_from_the_ledger(
    api: Api, cell: WireCell, config_path: Path, whole: bool
) -> None:
    cell.runs = [ended(1), ended(2)]
    folder = config_path.parent / "var"
    if whole:
        shutil.rmtree(folder)
    else:
        (folder / "runs.sqlite").rename(config_path.parent / "moved")
    assert (await api.http.post("/start", json={"recipe": RECIPE})).status_code == 202
    async with asyncio.timeout(15):
        while len((await api.http.get("/runs")).json()["runs"]) < 3:
            await asyncio.sleep(0.02)
    assert (folder / "runs.sqlite").exists()


async def test_69_a_run_that_the_ledger_does_not_have_any_more_is_not_active_for_ever(
    cell: WireCell, config_path: Path
) -> None:
    async with serving(config_path) as api:
        await api.wait_for_state(CellState.READY)
        await api.http.post("/start", json={"recipe": RECIPE})
        async with asyncio.timeout(15):
            while not (await api.http.get("/runs")).json()["runs"]:
                await asyncio.sleep(0.02)
        cell.runs, cell.run, cell.state, cell.epoch = [], None, CellState.READY, "e2"
        async with asyncio.timeout(15):
            while (run := (await api.http.get("/runs/run-1")).json())["state"] == "ACTIVE":
                await asyncio.sleep(0.02)
    assert (run["state"], run["code"]) == ("INTERRUPTED", "INTERRUPTED")


def ended(number: int) -> Run:
    return Run(
        id=f"old-{number}", seq=number, recipe=RECIPE, seed=number, state=RunState.SUCCEEDED, requested_at=2e9 - number
    )


async def test_79_runs_are_listed_in_the_order_of_the_ledger_whatever_their_stamps(
    cell: WireCell, config_path: Path
) -> None:
    cell.runs = [ended(number) for number in range(1, 6)]
    async with serving(config_path) as api:
        async with asyncio.timeout(15):
            while len((await api.http.get("/runs")).json()["runs"]) < 5:
                await asyncio.sleep(0.02)
        first = (await api.http.get("/runs?limit=3")).json()
        rest = (await api.http.get(first["next"])).json()
    assert [run["id"] for run in first["runs"] + rest["runs"]] == [f"old-{number}" for number in range(5, 0, -1)]
