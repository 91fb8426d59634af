"""A control process and its simulator behind TLS: who holds which certificate may do what, on real sessions."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from service import messages
from service.client import CellClient, CellError, CellSilentError
from service.envelope import QUERY_TICKET
from service.faults import FaultCode
from service.messages import CellState, StartRequest, StopRequest
from tests.certificates import Authority
from tests.service.cell.conftest import EASY
from tests.service.cell.test_process import configured, started_control, until
from tests.service.sim_server import free_endpoint
from wire import keys
from wire.session import close_session, open_session, query
from wire.tls import Certificates

CELL = "cell-1"
SETTLED_S = 1.0
"""Time in which a session that is let in has connected."""


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    return Authority(tmp_path / "certificates")


@asynccontextmanager
async def secured(tmp_path: Path, authority: Authority) -> AsyncIterator[tuple[str, str]]:
    """A control process that started its own simulator, both on TLS; yields their endpoints."""
    authority.certify(CELL, "serverAuth,clientAuth")
    cell, sim = (free_endpoint().replace("tcp/", "tls/") for _ in range(2))
    path, _ = configured(tmp_path, **{"tcp/127.0.0.1:7447": cell, "tcp/127.0.0.1:7448": sim})
    with path.open("a") as file:
        file.write(
            '\n[tls]\nauthority = "certificates/authority.pem"\ncertificate = "certificates/cell-1.pem"\n'
            'key = "certificates/cell-1.key"\ncommanders = ["cell-1", "operator"]\nreaders = ["viewer"]\n'
        )
    with started_control(path):
        yield cell, sim


async def heard(endpoint: str, certificates: Certificates | None) -> tuple[int, dict[str, int]]:
    """Return what a session gets: publications under the cell, and answers by the key that was asked."""
    session = await asyncio.to_thread(open_session, (), [endpoint], certificates)
    try:
        told: list[str] = []
        session.declare_subscriber("**", lambda sample: told.append(str(sample.key_expr)))
        session.declare_subscriber(messages.STATUS.format(cell=CELL), lambda sample: told.append("status"))
        await asyncio.sleep(SETTLED_S)
        asked = (QUERY_TICKET, messages.QUERY_STATUS, messages.STOP, messages.RESET, messages.START)
        answers = {
            key: len(await query(session, key.format(cell=CELL), b'{"sender": "x"}', 0.5)) for key in (*asked, "**")
        }
        return len(told), answers
    finally:
        await asyncio.to_thread(close_session, session)


async def test_only_named_certificates_read_and_only_commanders_command(tmp_path: Path, authority: Authority) -> None:
    async with secured(tmp_path, authority) as (cell, sim):
        operator, viewer, guest = (authority.certify(name) for name in ("operator", "viewer", "guest"))
        foreign = Authority(tmp_path / "foreign").certify("operator")
        async with CellClient(CELL, [cell], certificates=operator) as client:
            await until(lambda: client.state is CellState.READY, 60.0)
            await client.start(StartRequest(recipe="triangle-2mm", seed=EASY))
            await until(lambda: client.state in (CellState.APPROACH, CellState.RUNNING))

            strangers = {
                "no certificate": None,
                "no certificate of its own": Certificates(authority.file, foreign.certificate, foreign.key),
                "another authority": foreign,
                "a name without rights": guest,
            }
            for who, certificates in strangers.items():
                told, answers = await heard(cell, certificates)
                assert (told, sum(answers.values())) == (0, 0), who
            told, answers = await heard(cell, viewer)
            assert told > 0
            assert {key for key, count in answers.items() if count} == {QUERY_TICKET, messages.QUERY_STATUS}
            async with CellClient(CELL, [cell], certificates=viewer) as reader:
                await until(lambda: reader.state is not CellState.UNKNOWN)
                with pytest.raises(CellSilentError):
                    await reader.stop(StopRequest(), 0.5)
                with pytest.raises(CellError):
                    await reader.start(StartRequest(recipe="triangle-2mm"), 0.5)
            latch = (await client.status()).latch  # a loaded test machine may have stopped the run
            assert latch is None or latch.code is not FaultCode.OPERATOR_STOP, "nobody without rights stopped it"
            assert await asked_of_the_simulator(sim, guest) == 0
            assert await asked_of_the_simulator(sim, viewer) == 1, "the holder is told to a reader"
            assert (await client.stop(StopRequest())).state in (CellState.STOPPING, CellState.LATCHED, CellState.READY)


async def asked_of_the_simulator(endpoint: str, certificates: Certificates) -> int:
    """Return how many of `info`, `reset` and `claim` are answered."""
    session = await asyncio.to_thread(open_session, (), [endpoint], certificates)
    try:
        await asyncio.sleep(SETTLED_S)
        asked = [key.format(world="world-1") for key in (keys.INFO, keys.RESET, keys.CLAIM)]
        return sum([len(await query(session, key, b"{}", 0.5)) for key in asked])
    finally:
        await asyncio.to_thread(close_session, session)
