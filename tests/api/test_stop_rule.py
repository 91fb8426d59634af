"""One rule for stops: only a page of another site is refused, whatever else is odd about the request."""

import asyncio
import json
from pathlib import Path
from typing import Any

import httpx
import pytest
import uvicorn

from api.application import create_app
from api.connections import Connection
from service.config import load
from service.messages import CellState
from tests.api.wire_cell import RECIPE, Api, WireCell, until


async def send(api: Api, request: str | bytes, *, half_close: bool = False) -> str:
    """Send these bytes over a connection of their own; return everything that comes back."""
    reader, writer = await asyncio.open_connection("127.0.0.1", api.port)
    writer.write(request.encode() if isinstance(request, str) else request)
    if half_close:
        writer.write_eof()
    answer = await reader.readuntil(b"}") if not half_close else await reader.read()
    writer.close()
    return answer.decode()


async def run_under_way(api: Api, cell: WireCell) -> None:
    await api.http.post("/start", json={"recipe": RECIPE})
    await api.wait_for_state(CellState.RUNNING)
    assert not cell.stops


@pytest.mark.parametrize(
    "head",
    [
        "POST /stop HTTP/1.0\r\n",
        "POST /stop HTTP/1.1\r\n",
        "POST /stop HTTP/1.1\r\nHost: robots.example\r\n",
        "POST /stop HTTP/1.1\r\nHost: 127.0.0.2:8000\r\n",
        "POST /stop HTTP/1.1\r\nHost: a\r\nHost: b\r\n",
        "POST /stop/ HTTP/1.1\r\nHost: localhost\r\n",
        "POST //stop HTTP/1.1\r\nHost: localhost\r\n",
        "POST /Stop?x HTTP/1.1\r\nHost: localhost\r\n",
        "POST /%73top HTTP/1.1\r\nHost: localhost\r\n",
        "POST /cells/3/stop HTTP/1.1\r\nHost: localhost\r\n",
        "POST http://127.0.0.1:8000/stop HTTP/1.1\r\nHost: localhost\r\n",
        "post /stop HTTP/1.1\r\nHost: localhost\r\n",
        "PUT /stop HTTP/1.1\r\nHost: localhost\r\n",
        "POST /stop HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n",
        "POST /stop HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/x-unheard-of\r\n",
        "POST /stop HTTP/1.1\r\nHost: localhost\r\nContent-Length: none\r\n",
        "POST /stop HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000000000\r\n",
        "POST /stop HTTP/1.1\r\nHost: localhost\r\nContent-Length: 3\r\nExpect: 100-continue\r\n",
        "POST /stop HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: gzip\r\n",
        "POST /stop HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\nno chunk",
        "POST /stop HTTP/1.1\nHost: localhost\n",
        "POST /stop HTTP/9.9\r\nHost: localhost\r\n",
        "POST /stop HTTP/1.1\r\nHost: localhost\r\nBad Header \x01: x\r\n",
        "POST /stop\r\n",
        "POST /stop HTTP/1.1\r\nHost: localhost\r\nX: " + 100_000 * "x" + "\r\n",
        "POST /stop HTTP/1.1\r\nHost: cell.example\r\nOrigin: http://cell.example\r\n",
        "POST /stop HTTP/1.1\r\nHost: cell.example\r\nOrigin: https://cell.example:8443\r\n",
        "POST /stop HTTP/1.1\r\nHost: inside\r\nX-Forwarded-Host: cell.example\r\nOrigin: http://cell.example\r\n",
        'POST /stop HTTP/1.1\r\nHost: inside\r\nForwarded: for=x;host="cell.example"\r\nOrigin: http://cell.example\r\n',
        "POST /stop HTTP/1.1\r\nHost: inside\r\nOrigin: http://cell.example\r\nSec-Fetch-Site: same-origin\r\n",
    ],
    ids=lambda head: head.replace("\r\n", " ").strip()[:70],
)
async def test_75_an_odd_stop_is_carried_out(api: Api, cell: WireCell, head: str) -> None:
    await run_under_way(api, cell)
    answer = await send(api, head + "\r\n")
    assert answer.startswith("HTTP/1.1 200"), answer
    assert '"confirmed":true' in answer
    assert cell.stops == ["stop over HTTP"]
    assert cell.state is CellState.LATCHED


@pytest.mark.parametrize("head", ["POST /stop HTTP/1.1\r\nHost: localhost\r\n", "POST /stop HTTP/1.0"])
async def test_75_a_stop_of_a_client_that_sends_no_more_is_answered(api: Api, cell: WireCell, head: str) -> None:
    for end in ("\r\n", ""):  # a whole request, and one that was cut off
        answer = await send(api, head + end, half_close=True)
        assert answer.startswith("HTTP/1.1 200"), answer
    assert len(cell.stops) == 2


async def test_75_a_stop_behind_an_unfinished_request_does_not_wait_for_it(api: Api, cell: WireCell) -> None:
    await run_under_way(api, cell)
    reader, writer = await asyncio.open_connection("127.0.0.1", api.port)
    writer.write(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")
    await reader.readuntil(b"event: status")
    writer.write(b"POST /stop HTTP/1.1\r\nHost: localhost\r\n\r\n")
    await until(lambda: cell.stops)
    await reader.read()
    assert cell.state is CellState.LATCHED
    writer.close()


async def test_75_a_stop_over_a_unix_socket_and_another_loopback_address(
    config_path: Path, cell: WireCell, tmp_path: Path
) -> None:
    config = load(config_path)
    socket = tmp_path / "api.socket"
    servers = [
        uvicorn.Server(uvicorn.Config(create_app(config, config_path), http=Connection, log_config=None, **where))
        for where in ({"uds": str(socket)}, {"host": "127.0.0.9", "port": 0})
    ]
    serving = [asyncio.create_task(server.serve()) for server in servers]
    await until(lambda: all(server.started for server in servers))
    port = servers[1].servers[0].sockets[0].getsockname()[1]
    transports = {
        "http://localhost": httpx.AsyncHTTPTransport(uds=str(socket)),
        f"http://127.0.0.9:{port}": httpx.AsyncHTTPTransport(),
    }
    for number, (url, transport) in enumerate(transports.items(), 1):
        async with httpx.AsyncClient(base_url=url, transport=transport, trust_env=False) as http:
            assert (await http.get("/status")).status_code == 200
            assert (await http.post("/stop")).status_code == 200
            assert len(cell.stops) == number
    for server in servers:
        server.should_exit = True
    await asyncio.gather(*serving)


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://elsewhere.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
        {"Origin": "http://[elsewhere"},
        {"Origin": "http://elsewhere.example", "X-Forwarded-Host": "cell.example"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site", "Origin": "http://127.0.0.1:1"},
    ],
)
async def test_58_a_stop_of_a_page_of_another_site_is_refused(
    api: Api, cell: WireCell, headers: dict[str, str]
) -> None:
    for path in ("/stop", "/stop/", "/x/stop"):
        response = await api.http.post(path, headers=headers)
        assert response.status_code == 403
        assert response.json()["reason"] == "CROSS_SITE"
        assert response.json()["confirmed"] is False
    origin = "".join(f"{name}: {value}\r\n" for name, value in headers.items())
    answer = await send(api, f"POST /stop HTTP/1.1\r\n{origin}Content-Length: none\r\n\r\n")
    assert answer.startswith("HTTP/1.1 403"), "one that the parser refuses is judged the same"
    assert not cell.stops


@pytest.mark.parametrize("request_line", ["GET /stop", "HEAD /stop", "OPTIONS /stop", "TRACE /stop", "POST /stopped"])
async def test_75_what_only_reads_or_names_something_else_stops_nothing(
    api: Api, cell: WireCell, request_line: str
) -> None:
    method, path = request_line.split()
    for where in (path, f"{path}/", f"{path}?operator=x"):
        response = await api.http.request(method, where)
        assert response.status_code in {307, 404, 405}
    assert not cell.stops


async def test_75_a_stop_in_the_body_of_a_request_stops_nothing(api: Api, cell: WireCell) -> None:
    response = await api.http.post("/start", content=b"POST /stop HTTP/1.1\r\n\r\n", headers={"Origin": "http://x.y"})
    assert response.status_code == 403
    assert not cell.stops


async def test_a_stop_names_who_asked(api: Api, cell: WireCell) -> None:
    await api.http.post("/stop?operator=M.%20Sato%0A", headers={"User-Agent": "curl/8.5.0 (x)"})
    await api.http.post("/stop", headers={"User-Agent": ""})
    name, nameless = cell.stopped_by
    assert name.startswith("M. Sato at 127.0.0.1:")
    assert name.endswith("with curl/8.5.0")
    assert nameless.startswith("somebody at 127.0.0.1:")


async def test_75_a_stop_is_not_confirmed_by_an_older_sample(api: Api, cell: WireCell) -> None:
    """The arm starts to move with the sample after the stop, and no sample comes at all."""
    cell.moves_after_stop = True
    response = await api.http.post("/stop")
    assert response.status_code == 202
    assert response.json()["confirmed"] is False
    cell.moves_after_stop, cell.samples_come = False, False
    response = await api.http.post("/stop")
    assert response.json()["confirmed"] is False
    assert "NOT CONFIRMED" in response.json()["detail"]
    assert "robot's own emergency stop" in response.json()["detail"]


async def test_75_an_undelivered_stop_is_said_to_be_unconfirmed(lonely_api: Api) -> None:
    said: dict[str, Any] = json.loads((await lonely_api.http.post("/stop")).content)
    assert said["confirmed"] is False
    assert said["detail"].startswith("NOT CONFIRMED")
