import asyncio
from pathlib import Path
from typing import Any

import httpx
import pytest

from api.protection import BODY_LIMIT_BYTES, Protection
from tests.api.wire_cell import RECIPE, Api, WireCell


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://elsewhere.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
        {"Origin": "http://127.0.0.1.elsewhere.example:8000"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
    ],
)
async def test_a_post_from_another_site_is_refused(api: Api, cell: WireCell, headers: dict[str, str]) -> None:
    for path in ("/start", "/stop", "/reset"):
        response = await api.http.post(path, json={"recipe": RECIPE, "operator": "x"}, headers=headers)
        assert response.status_code == 403
        assert response.json()["reason"] == "CROSS_SITE"
    assert (cell.runs, cell.stops, cell.resets) == ([], [], [])


@pytest.mark.parametrize("method", ["GET", "POST"])
async def test_a_rebound_name_is_refused(api: Api, method: str) -> None:
    for host in ("elsewhere.example", "127.0.0.1.elsewhere.example", "127.0.0.1@elsewhere.example", "", "[::1"):
        response = await api.http.request(method, "/status", headers={"Host": host})
        assert response.status_code in {400, 421}, host


async def test_the_names_of_this_machine_are_accepted(api: Api) -> None:
    for host in ("localhost", "127.0.0.1:8000", "[::1]:8000", "LOCALHOST:1"):
        assert (await api.http.get("/status", headers={"Host": host})).status_code == 200, host


async def test_the_pages_own_post_is_accepted(api: Api, cell: WireCell) -> None:
    origin = {"Origin": f"http://127.0.0.1:{api.port}", "Sec-Fetch-Site": "same-origin"}
    assert (await api.http.post("/stop", headers=origin)).status_code == 200
    assert cell.stops


async def _answering(scope: Any, receive: Any, send: Any) -> None:
    await send({"type": "http.response.start", "status": 204, "headers": []})
    await send({"type": "http.response.body"})


async def _get(app: Protection, server: str, host: str) -> httpx.Response:
    async def at(scope: Any, receive: Any, send: Any) -> None:
        await app({**scope, "server": (server, 8000)}, receive, send)

    async with httpx.AsyncClient(transport=httpx.ASGITransport(at), base_url=f"http://{host}") as http:
        return await http.get("/")


@pytest.mark.parametrize("address", ["192.0.2.7", "2001:db8::1", "10.0.0.1"])
async def test_a_connection_from_outside_is_refused_unless_it_is_allowed(address: str) -> None:
    closed = Protection(_answering, hosts=["cell.example"])
    opened = Protection(_answering, hosts=["cell.example"], allow_remote=True)
    refused = await _get(closed, address, "cell.example")
    assert refused.status_code == 403
    assert "allow_remote" in refused.json()["detail"]
    assert (await _get(opened, address, "cell.example")).status_code == 204


async def test_an_ipv4_loopback_address_in_ipv6_clothes_is_loopback() -> None:
    assert (await _get(Protection(_answering), "::ffff:127.0.0.1", "localhost")).status_code == 204


async def test_a_long_body_is_413_whether_its_length_is_told_or_not(api: Api, cell: WireCell) -> None:
    body = b" " * (BODY_LIMIT_BYTES + 1)

    async def chunks() -> Any:
        for start in range(0, len(body), 1000):
            yield body[start : start + 1000]

    for content in (body, chunks()):
        response = await api.http.post("/start", content=content, headers={"Content-Type": "application/json"})
        assert response.status_code == 413
        assert response.headers["content-type"] == "application/problem+json"
    assert not cell.runs


async def test_every_answer_forbids_what_the_page_does_not_need(api: Api) -> None:
    for path in ("/", "/status", "/nowhere", "/page/operator.js"):
        headers = (await api.http.get(path)).headers
        policy = headers["content-security-policy"]
        assert policy.startswith("default-src 'none'")
        assert "unsafe" not in policy
        assert "http" not in policy
        assert headers["x-content-type-options"] == "nosniff"


def test_the_page_refers_to_nothing_elsewhere() -> None:
    folder = Path(__file__).parents[2] / "api" / "page"
    own = [path for path in folder.iterdir() if path.is_file()]
    assert len(own) >= 4
    for path in own:
        text = path.read_text().replace("http://www.w3.org/2000/svg", "").replace("http://127.0.0.1:8000/stop", "")
        assert "http://" not in text, path
        assert "https://" not in text, path
        assert " style=" not in text, path


async def test_requests_have_ids_of_their_own(api: Api) -> None:
    answers = await asyncio.gather(*(api.http.get("/health") for _ in range(5)))
    assert len({answer.headers["X-Request-ID"] for answer in answers}) == 5
