"""Row 70 at a cell's own keys: readings, empty payloads, copies and forgeries, sent by a stranger's own session."""

import asyncio
import json
import secrets
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh

from service import messages
from service.cell import remarks
from service.cell.control_plane import ControlPlane
from service.client import CellClient
from service.config import ClientLossSection
from service.envelope import QUERY_TICKET, TICKET_ANSWER
from service.faults import FaultCode
from service.messages import CellState, EventKind, ResetRequest, StartRequest, StopRequest
from service.testing import RECIPE, Bench, cell_config, lockstep_cell
from tests.service.cell import policies
from tests.service.cell.conftest import EASY
from tests.service.sim_server import free_endpoint
from wire.session import close_session, open_session, query

CELL = "under-test"
STOP, START, RESET = (key.format(cell=CELL) for key in (messages.STOP, messages.START, messages.RESET))
REQUESTS: dict[str, dict[str, Any]] = {STOP: {}, START: {"recipe": RECIPE, "seed": EASY}, RESET: {}}
WILDCARDS = ("**", "cell/**", "*/*/command/*", f"cell/{CELL}/command/*", f"cell/{CELL}/command/st$*", f"{STOP}/**")


class Stranger:
    """A session that is no client of the cell; it sends whatever a test wants."""

    def __init__(self, bench: Bench, client: CellClient, session: zenoh.Session) -> None:
        self.bench = bench
        self.client = client
        self.session = session

    async def ask(self, key: str, payload: bytes) -> list[dict[str, Any]]:
        return [json.loads(answer) for answer in await query(self.session, key, payload, 5.0)]

    async def refused(self, key: str, payload: bytes) -> str:
        """Send a command that must be refused; return the reason."""
        (answer,) = await self.ask(key, payload)
        assert answer["kind"] == "refused", answer
        return answer["problem"]["reason"]

    async def ticket(self, sender: str) -> str:
        answers = await query(self.session, QUERY_TICKET.format(cell=CELL), b'{"sender": "%s"}' % sender.encode(), 5.0)
        answer = TICKET_ANSWER.validate_json(answers[0])
        assert answer.kind == "ticket", answer
        return answer.ticket

    @property
    def lines(self) -> list[str]:
        """Warnings of the journal."""
        return [event.text for event in self.bench.events if event.kind is EventKind.WARNING]


def envelope(request: dict[str, Any], ticket: str | None, number: int = 1, sender: str = "stranger") -> bytes:
    return json.dumps(
        {"schema_version": 1, "sender": sender, "ticket": ticket, "number": number, "request": request}
    ).encode()


@asynccontextmanager
async def attacked(tmp_path: Path, **sections: Any) -> AsyncIterator[Stranger]:
    endpoint = free_endpoint()
    tmp_path.mkdir(exist_ok=True)
    session = open_session(listen=[endpoint])
    strange = open_session(connect=[endpoint])
    config = cell_config(tmp_path / "state", policies.still(tmp_path), conditions="easy").model_copy(update=sections)
    try:
        async with lockstep_cell(config) as bench:
            ControlPlane(bench.cell, session)
            async with CellClient(CELL, [endpoint], sender="operator") as client:
                async with asyncio.timeout(20):
                    while not await query(strange, messages.QUERY_STATUS.format(cell=CELL), b"", 0.5):
                        await asyncio.sleep(0.01)
                    while client._ticket is None:
                        await asyncio.sleep(0.01)
                yield Stranger(bench, client, strange)
    finally:
        close_session(strange)
        close_session(session)


async def running(stranger: Stranger) -> str:
    answer = await stranger.client.start(StartRequest(recipe=RECIPE, seed=EASY))
    await stranger.bench.state(CellState.APPROACH)
    return answer.run.id


async def assert_it_goes_on(stranger: Stranger, run_id: str) -> None:
    """The run is under way and its arm moves, some simulated time later."""
    bench = stranger.bench
    before = bench.cell.newest_sample
    assert before is not None
    await bench.let_pass(0.1)
    after = bench.cell.newest_sample
    assert after is not None
    assert bench.cell.journal.latch is None
    assert bench.cell.runs.active_id == run_id
    assert abs(after.tcp_position - before.tcp_position).max() > 1e-3, "the arm moves on"


@pytest.mark.parametrize("payload", [b"", b"{}", envelope({}, None)], ids=["empty", "braces", "envelope"])
async def test_70_a_wildcard_is_a_reading_and_stops_nothing(tmp_path: Path, payload: bytes) -> None:
    async with attacked(tmp_path) as stranger:
        run_id = await running(stranger)
        for key in WILDCARDS:
            answers = await stranger.ask(key, payload)
            assert all(answer["kind"] != "run" for answer in answers)
        await assert_it_goes_on(stranger, run_id)
        assert len(await stranger.ask("cell/**", b"")) == 7, "every query answers a reading, under its own key"
        assert any("refused a stop at" in line for line in stranger.lines)
        await stranger.client.stop(StopRequest())
        await stranger.bench.state(CellState.LATCHED)
        for key in WILDCARDS:
            await stranger.ask(key, payload)
        latch = stranger.bench.cell.journal.latch
        assert latch is not None, "a reading acknowledges nothing"
        assert latch.code is FaultCode.OPERATOR_STOP


async def test_70_an_empty_payload_commands_nothing(tmp_path: Path) -> None:
    async with attacked(tmp_path) as stranger:
        assert await stranger.refused(START, b"") == "INVALID_REQUEST"
        assert stranger.bench.cell.state is CellState.READY
        run_id = await running(stranger)
        assert await stranger.refused(STOP, b"") == "INVALID_REQUEST"
        await assert_it_goes_on(stranger, run_id)
        await stranger.client.stop(StopRequest())
        await stranger.bench.state(CellState.LATCHED)
        assert await stranger.refused(RESET, b"") == "INVALID_REQUEST"
        assert stranger.bench.cell.state is CellState.LATCHED
        assert sum("it is empty" in line for line in stranger.lines) == 3


async def test_70_a_copy_of_a_command_is_refused(tmp_path: Path) -> None:
    async with attacked(tmp_path) as stranger:
        bench, ticket = stranger.bench, await stranger.ticket("stranger")
        start, stop, reset = (
            envelope(request, ticket, number)
            for number, request in enumerate((REQUESTS[START], REQUESTS[STOP], REQUESTS[RESET]), 1)
        )
        assert (await stranger.ask(START, start))[0]["kind"] == "run"
        await bench.state(CellState.APPROACH)
        assert (await stranger.ask(STOP, stop))[0]["kind"] == "status"
        await bench.state(CellState.LATCHED)
        assert (await stranger.ask(RESET, reset))[0]["kind"] == "status"
        assert bench.cell.state is CellState.READY

        assert await stranger.refused(START, start) == "REPLAYED"
        assert bench.cell.state is CellState.READY
        run_id = await running(stranger)
        assert await stranger.refused(STOP, stop) == "REPLAYED"
        await assert_it_goes_on(stranger, run_id)
        await stranger.client.stop(StopRequest())
        await bench.state(CellState.LATCHED)
        assert await stranger.refused(RESET, reset) == "REPLAYED"
        assert bench.cell.state is CellState.LATCHED
        assert sum("was used before by 'stranger'" in line for line in stranger.lines) == 3


async def test_70_a_copy_from_an_earlier_process_is_refused(tmp_path: Path) -> None:
    async with attacked(tmp_path / "earlier") as stranger:
        start = envelope(REQUESTS[START], await stranger.ticket("stranger"))
        assert (await stranger.ask(START, start))[0]["kind"] == "run"
    async with attacked(tmp_path / "later") as stranger:
        assert await stranger.refused(START, start) == "UNKNOWN_SENDER"
        assert stranger.bench.cell.state is CellState.READY


async def test_70_a_forged_start_or_reset_is_refused(tmp_path: Path) -> None:
    async with attacked(tmp_path) as stranger:
        bench, own, word = stranger.bench, await stranger.ticket("stranger"), secrets.token_hex(16)
        forged = {
            "made up": (word, "operator"),
            "in another's name": (own, "operator"),
            "without a ticket": (None, "operator"),
        }
        for ticket, sender in forged.values():
            assert await stranger.refused(START, envelope(REQUESTS[START], ticket, 9, sender)) == "UNKNOWN_SENDER"
        for payload in (json.dumps(REQUESTS[START]).encode(), envelope(REQUESTS[START], own).replace(b": 1,", b": 2,")):
            assert await stranger.refused(START, payload) == "INVALID_REQUEST"
        assert bench.cell.state is CellState.READY
        await running(stranger)
        await stranger.client.stop(StopRequest())
        await bench.state(CellState.LATCHED)
        for ticket, sender in forged.values():
            assert await stranger.refused(RESET, envelope({}, ticket, 10, sender)) == "UNKNOWN_SENDER"
        assert bench.cell.state is CellState.LATCHED
        assert len(stranger.lines) == 8


async def test_70_a_stop_in_anothers_name_is_refused_and_one_of_an_unknown_ticket_stops(tmp_path: Path) -> None:
    async with attacked(tmp_path) as stranger:
        run_id = await running(stranger)
        ticket = await stranger.ticket("stranger")
        assert await stranger.refused(STOP, envelope({}, ticket, 1, "operator")) == "UNKNOWN_SENDER"
        await assert_it_goes_on(stranger, run_id)
        await stranger.ask(STOP, envelope({}, secrets.token_hex(16), 1, "a client of the process before"))
        await stranger.bench.state(CellState.LATCHED)
        latch = stranger.bench.cell.journal.latch
        assert latch is not None
        assert "by a client of the process before" in latch.text


async def test_70_the_record_names_the_sender_of_a_stop_and_of_a_reset(tmp_path: Path) -> None:
    async with attacked(tmp_path) as stranger:
        await running(stranger)
        await stranger.client.stop(StopRequest())
        await stranger.bench.state(CellState.LATCHED)
        await stranger.client.reset(ResetRequest())
        texts = [event.text for event in stranger.bench.events if event.kind in (EventKind.FAULT, EventKind.RESET)]
        assert texts == ["stopped by operator", "OPERATOR_STOP acknowledged by operator"]


async def test_70_a_flood_of_refused_commands_fills_no_disk_and_holds_up_no_stop(tmp_path: Path) -> None:
    async with attacked(tmp_path) as stranger:
        await running(stranger)
        flood = [asyncio.create_task(stranger.ask(key, b"")) for key in (START, STOP, RESET, "cell/**") * 500]
        await asyncio.sleep(0)
        assert (await stranger.client.stop(StopRequest(), 5.0)).state in (CellState.STOPPING, CellState.LATCHED)
        await asyncio.gather(*flood)
        await stranger.bench.state(CellState.LATCHED)
        assert 1 <= len(stranger.lines) <= remarks.BURST + 2


async def test_70_what_is_no_clients_sign_of_presence_does_not_count_as_a_client(tmp_path: Path) -> None:
    loss = ClientLossSection(policy="stop", limit_s=0.3)
    async with attacked(tmp_path, client_loss=loss) as stranger:
        bench, key, ticket = stranger.bench, messages.CLIENT.format(cell=CELL), await stranger.ticket("stranger")
        await running(stranger)
        await stranger.client.close()
        while bench.cell.journal.latch is None:
            stranger.session.put(key, b"")
            stranger.session.put("cell/**", envelope({}, ticket, 2))
            stranger.session.put(key, envelope({}, ticket, 1))
            stranger.session.put(key, envelope({}, secrets.token_hex(16), 1))
            await bench.let_pass(0.02)
            bench.cell.watch()
        assert bench.cell.journal.latch.code is FaultCode.CLIENT_LOST
        assert any("ignored a sign of presence" in line for line in stranger.lines)


async def test_a_client_whose_ticket_was_withdrawn_draws_another_and_is_obeyed(tmp_path: Path) -> None:
    async with attacked(tmp_path) as stranger:
        bench = stranger.bench
        stranger.client._ticket = stranger.client._ticket.model_copy(update={"ticket": secrets.token_hex(16)})
        assert (await stranger.client.start(StartRequest(recipe=RECIPE, seed=EASY))).created
        await bench.state(CellState.APPROACH)


@pytest.mark.parametrize("number", [2**53 - 1, 40], ids=["far_ahead", "next"])
async def test_70_a_stop_whose_number_somebody_else_has_used_stops(tmp_path: Path, number: int) -> None:
    async with attacked(tmp_path) as stranger:
        client = stranger.client
        await running(stranger)
        assert client._ticket is not None
        await stranger.refused(RESET, envelope({}, client._ticket.ticket, number, sender="operator"))
        client._number = 39
        status = await client.stop(StopRequest(reason="mine"))
        assert status.latch is not None
        assert status.latch.code is FaultCode.OPERATOR_STOP
