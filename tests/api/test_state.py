import asyncio
import errno
import os
import threading
from pathlib import Path

import anyio.to_thread
import pytest

from api.protection import SECURITY_HEADERS
from service import logs
from service.logs import LogWriter
from service.messages import CellState
from tests.api.wire_cell import RECIPE, Api, WireCell, serving, until


async def test_status_is_unknown_when_no_control_process_was_ever_heard(lonely_api: Api) -> None:
    status = (await lonely_api.http.get("/status")).json()
    assert status["state"] == "UNKNOWN"
    assert status["heartbeat_age_s"] is None
    assert status["can_start"] is False
    assert "never heard" in status["why_not"]


async def test_status_turns_unknown_with_an_age_when_the_control_process_falls_silent(api: Api, cell: WireCell) -> None:
    cell.heartbeat = False
    status = await api.wait_for_state(CellState.UNKNOWN)
    assert status["heartbeat_age_s"] >= 0.5
    assert status["last_known_state"] == "READY"
    assert status["measured"] is None
    later = (await api.http.get("/status")).json()
    assert later["heartbeat_age_s"] > status["heartbeat_age_s"]


async def test_76_a_log_of_the_server_that_takes_nothing_is_told_in_the_status(
    api: Api, cell: WireCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not any("this server" in line for line in (await api.http.get("/status")).json()["degradations"])
    with open("/dev/full", "wb", buffering=0) as full:
        monkeypatch.setattr(logs, "_writer", LogWriter(full.fileno()))
        logs.log_writer().put("a line\n")
        logs.log_writer().drain()
        told = (await api.http.get("/status")).json()["degradations"]
        cell.heartbeat = False
        unknown = (await api.wait_for_state(CellState.UNKNOWN))["degradations"]
    expected = f"this server: the log: 1 lines are lost: {os.strerror(errno.ENOSPC)}"
    assert expected in told
    assert unknown == [expected]


async def test_status_says_what_is_measured_not_what_was_commanded(api: Api, cell: WireCell) -> None:
    cell.arm_stops = False
    await api.http.post("/start", json={"recipe": RECIPE})
    await api.http.post("/stop")
    status = await api.wait_for_state(CellState.STOPPING)
    assert status["measured"]["moving"] is True


async def test_the_status_is_answered_without_a_thread(api: Api) -> None:
    limiter = anyio.to_thread.current_default_thread_limiter()
    release = threading.Event()
    async with asyncio.TaskGroup() as tasks:
        for _ in range(int(limiter.total_tokens)):
            tasks.create_task(anyio.to_thread.run_sync(release.wait))
        try:
            await until(lambda: limiter.available_tokens == 0)
            async with asyncio.timeout(10.0):
                assert (await api.http.get("/status")).status_code == 200
        finally:
            release.set()


async def test_an_answer_has_each_header_once(api: Api) -> None:
    for path in ("/status", "/page/operator.js", "/nothing"):
        answer = await api.http.get(path)
        names = [name.lower() for name, _ in answer.headers.raw]
        assert len(set(names)) == len(names), path
        assert {name.lower() for name in SECURITY_HEADERS} <= {name.decode() for name in names}, path


async def test_a_sample_ages_between_heartbeats(api: Api) -> None:
    ages: set[float] = set()
    for _ in range(5):
        status = (await api.http.get("/status")).json()
        assert status["measured"]["sample_age_s"] >= 0.002 + status["heartbeat_age_s"] - 1e-9
        ages.add(status["measured"]["sample_age_s"])
        await asyncio.sleep(0.007)
    assert len(ages) > 1


async def test_the_api_hears_a_control_process_that_comes_back(lonely_api: Api, cell_port: int) -> None:
    for epoch in ("e1", "e2"):
        with WireCell(f"tcp/127.0.0.1:{cell_port}", epoch=epoch):
            status = await lonely_api.wait_for_state(CellState.READY)
            assert status["service_epoch"] == epoch
        await lonely_api.wait_for_state(CellState.UNKNOWN)


async def test_health_is_alive_without_a_cell_and_not_ready(lonely_api: Api) -> None:
    health = await lonely_api.http.get("/health")
    assert health.status_code == 200
    assert health.json()["alive"] is True
    assert health.json()["ready"] is False
    ready = await lonely_api.http.get("/health/ready")
    assert ready.status_code == 503
    assert "control_process" in ready.json()["detail"]


async def test_health_is_ready_with_a_cell_whose_samples_flow(api: Api, cell: WireCell) -> None:
    assert (await api.http.get("/health/ready")).status_code == 200
    assert cell.measured is not None
    cell.measured = cell.measured.model_copy(update={"sample_age_s": 3.0})
    async with asyncio.timeout(15):
        while (await api.http.get("/health/ready")).status_code != 503:
            await asyncio.sleep(0.02)
    health = (await api.http.get("/health")).json()
    assert health["checks"]["arm"].startswith("no sample for 3")


@pytest.mark.parametrize("path", ["/nowhere", "/runs/none-such"])
async def test_what_is_not_there_is_a_problem(api: Api, path: str) -> None:
    response = await api.http.get(path)
    assert response.status_code == 404
    assert response.headers["content-type"] == "application/problem+json"
    assert response.json()["instance"] == path
    assert response.json()["request_id"] == response.headers["X-Request-ID"]


async def test_a_wrong_method_is_a_problem(api: Api) -> None:
    response = await api.http.get("/stop")
    assert response.status_code == 405
    assert response.headers["content-type"] == "application/problem+json"
    assert response.headers["allow"] == "POST"


async def test_an_error_of_the_servers_own_is_a_problem_without_a_trace(config_path: Path) -> None:
    async with serving(config_path) as api:
        # A configuration cannot break a handler, so its runtime is taken away from under it.
        runtime, api.application.state.runtime = api.runtime, None
        response = await api.http.get("/status")
        api.application.state.runtime = runtime
    assert response.status_code == 500
    assert response.headers["content-type"] == "application/problem+json"
    assert "Traceback" not in response.text
