"""A cell as its clients see it: over Zenoh, with the client that the API uses."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh

from service import messages
from service.cell.control_plane import MAX_REQUEST_BYTES, ControlPlane
from service.client import CellClient, CellRefusedError, CellSilentError
from service.faults import FaultCode
from service.messages import CellState, RefusalReason, ResetRequest, RunsRequest, RunState, StartRequest, StopRequest
from service.testing import RECIPE, Bench, cell_config, lockstep_cell
from tests.service.cell import policies
from tests.service.cell.conftest import EASY
from tests.service.sim_server import free_endpoint
from wire.session import close_session, open_session, query

CELL = "under-test"


@asynccontextmanager
async def served(tmp_path: Path, policy: Path) -> AsyncIterator[tuple[Bench, CellClient]]:
    endpoint = free_endpoint()
    session = open_session(listen=[endpoint])
    try:
        async with lockstep_cell(cell_config(tmp_path / "state", policy, conditions="easy")) as bench:
            plane = ControlPlane(bench.cell, session)
            status = asyncio.create_task(plane.publish_status())
            async with CellClient(CELL, [endpoint]) as client:
                async with asyncio.timeout(20):
                    while not client.is_alive:
                        await asyncio.sleep(0.01)
                yield bench, client
            status.cancel()
    finally:
        close_session(session)


async def test_a_client_starts_a_run_follows_it_and_reads_its_record(tmp_path: Path) -> None:
    async with (
        served(tmp_path, policies.straight(tmp_path)) as (bench, client),
        client.events() as events,
        client.telemetry() as telemetry,
    ):
        answer = await client.start(StartRequest(recipe=RECIPE, seed=EASY, idempotency_key="k"))
        again = await client.start(StartRequest(recipe=RECIPE, seed=EASY, idempotency_key="k"))
        assert (answer.created, again.created, again.run.id) == (True, False, answer.run.id)
        await bench.ended(answer.run)
        run = await client.run(answer.run.id)
        assert run.state is RunState.SUCCEEDED
        assert (await client.runs(RunsRequest(limit=1)))[0] == run
        async with asyncio.timeout(10):
            states = []
            while CellState.RETRACT not in states:
                states.append((await events.get()).state)
            point = await telemetry.get()
        assert point.force_magnitude_n >= 0.0
        assert (await client.status()).run == run


async def test_a_refusal_carries_its_reason_and_the_field(tmp_path: Path) -> None:
    async with served(tmp_path, policies.still(tmp_path)) as (_, client):
        with pytest.raises(CellRefusedError) as refused:
            await client.start(StartRequest(recipe="nothing"))
        assert (refused.value.problem.reason, refused.value.problem.field) == (RefusalReason.UNKNOWN_RECIPE, "recipe")
        with pytest.raises(CellRefusedError) as refused:
            await client.reset(ResetRequest())
        assert refused.value.problem.reason is RefusalReason.NOT_LATCHED
        with pytest.raises(CellRefusedError) as refused:
            await client.run("run-nowhere")
        assert refused.value.problem.reason is RefusalReason.UNKNOWN_RUN


async def test_a_client_says_until_when_its_start_is_valid_and_the_cell_goes_by_it(tmp_path: Path) -> None:
    async with served(tmp_path, policies.still(tmp_path)) as (bench, client):
        clock = bench.cell.journal.clock
        sent = client._ask

        async def late(*request: Any) -> Any:
            bench.cell.journal.clock = lambda: clock() + 60.0
            return await sent(*request)

        client._ask = late
        with pytest.raises(CellRefusedError) as refused:
            await client.start(StartRequest(recipe=RECIPE, seed=EASY), timeout_s=30.0)
        assert refused.value.problem.reason is RefusalReason.EXPIRED
        assert bench.cell.state is CellState.READY
        bench.cell.journal.clock = clock
        client._ask = sent
        assert (await client.start(StartRequest(recipe=RECIPE, seed=EASY), timeout_s=30.0)).created


async def test_a_stop_and_its_reset_over_the_wire(tmp_path: Path) -> None:
    async with served(tmp_path, policies.still(tmp_path)) as (bench, client):
        await client.start(StartRequest(recipe=RECIPE, seed=EASY))
        await bench.state(CellState.RUNNING)
        status = await client.stop(StopRequest(reason="enough", requested_by="tester"))
        assert status.state in (CellState.STOPPING, CellState.LATCHED)
        await bench.state(CellState.LATCHED)
        with pytest.raises(CellRefusedError) as refused:
            await client.start(StartRequest(recipe=RECIPE))
        assert (refused.value.problem.reason, refused.value.problem.code) == (
            RefusalReason.LATCHED,
            FaultCode.OPERATOR_STOP,
        )
        assert (await client.reset(ResetRequest(acknowledge=FaultCode.OPERATOR_STOP))).state is CellState.READY


async def ask(client: CellClient, key: str, payload: bytes) -> bytes:
    session = client._session
    assert isinstance(session, zenoh.Session)
    return (await query(session, key.format(cell=CELL), payload, 5.0))[0]


@pytest.mark.parametrize("payload", [b"{", b'{"more": 1}', b"\xff", b"x" * (MAX_REQUEST_BYTES + 1)])
async def test_a_stop_that_cannot_be_read_stops_all_the_same(tmp_path: Path, payload: bytes) -> None:
    async with served(tmp_path, policies.still(tmp_path)) as (bench, client):
        await client.start(StartRequest(recipe=RECIPE, seed=EASY))
        await bench.state(CellState.APPROACH)
        messages.STATUS_ANSWER.validate_json(await ask(client, messages.STOP, payload))
        await bench.state(CellState.LATCHED)
        assert bench.cell.journal.latch is not None
        assert bench.cell.journal.latch.code is FaultCode.OPERATOR_STOP


@pytest.mark.parametrize("payload", [b"{", b"[]", b'{"recipe": 5}', b'{"recipe": "r", "more": 1}', b"\xff", b"1e999"])
async def test_another_request_that_cannot_be_read_is_refused_and_changes_nothing(
    tmp_path: Path, payload: bytes
) -> None:
    async with served(tmp_path, policies.still(tmp_path)) as (bench, client):
        answer = messages.RUN_ANSWER.validate_json(await ask(client, messages.START, payload))
        assert answer.kind == "refused"
        assert answer.problem.reason is RefusalReason.INVALID_REQUEST
        assert bench.cell.state is CellState.READY


async def test_40_a_stop_does_not_wait_for_other_requests(tmp_path: Path) -> None:
    async with served(tmp_path, policies.still(tmp_path)) as (bench, client):
        await client.start(StartRequest(recipe=RECIPE, seed=EASY))
        await bench.state(CellState.RUNNING)
        flood = [asyncio.create_task(client.runs(RunsRequest(limit=500), 20.0)) for _ in range(200)]
        status = await client.stop(StopRequest(), 10.0)
        assert status.state is not CellState.RUNNING
        assert not all(request.done() for request in flood), "it was answered before the flood had drained"
        await bench.state(CellState.LATCHED)
        await asyncio.gather(*flood, return_exceptions=True)


async def test_47_a_cell_that_falls_silent_is_unknown_and_asking_it_says_so(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    now = [0.0]
    async with CellClient(CELL, [endpoint], clock=lambda: now[0]) as client:
        assert client.state is CellState.UNKNOWN
        session = open_session(listen=[endpoint])
        try:
            async with lockstep_cell(cell_config(tmp_path / "state", policies.still(tmp_path))) as bench:
                plane = ControlPlane(bench.cell, session)
                status = asyncio.create_task(plane.publish_status())
                async with asyncio.timeout(20):
                    while client.state is not CellState.READY:
                        await asyncio.sleep(0.01)
                status.cancel()
        finally:
            close_session(session)
        now[0] = 0.6
        assert client.state is CellState.UNKNOWN
        assert client.last_status is not None
        with pytest.raises(CellSilentError, match="dsl-assembly control"):
            await client.status(timeout_s=0.2)
