"""`stop`: the shortest way to a stop, and a second way past an API that does not answer.

Nothing but the standard library is loaded before the request leaves. It is asked of the API. If the API is not there,
does not answer at once, or does not reach the control process, the control process is asked itself.
"""

import http.client
import json
import queue
import threading
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import urlsplit

import typer

from cli.address import DEFAULT_URL, Url, is_address
from cli.exits import fail
from wire.exits import Exit

API_S = 4.0
"""Longest wait for the API's answer, s: it takes up to 1 s for the delivery and 1 s for the standstill."""
DIRECT_AFTER_S = 1.0
"""Silence of the API after which the control process is asked as well."""
DELIVERY_S = 3.0
ALL_S = 6.0
"""Longest time for both ways together, from the moment at which the second one is tried, s."""


@dataclass(frozen=True, slots=True)
class Answer:
    """Result of one way to the cell.

    Attributes:
        delivered: the control process has the stop.
        confirmed: standstill was measured after it.
        text: for people.
    """

    delivered: bool
    confirmed: bool
    text: str


def stop(
    url: Url = DEFAULT_URL,
    config: Annotated[
        Path | None,
        typer.Option(help="TOML file of the cell, to stop it past its API; default: that of the working directory."),
    ] = None,
) -> None:
    """Stop whatever moves, now.

    Without an answer from the API the stop goes straight to the control process of the configured cell. Status 0:
    standstill was measured. 6: delivered, standstill is not measured yet. 4: delivered to nobody.

    This is process protection. It is not the robot's emergency stop and replaces none of its certified safety
    functions.
    """
    if not is_address(url):
        fail("stop", f"{url} is no address of an API: it looks like {DEFAULT_URL}", Exit.USAGE)
    answers: queue.SimpleQueue[Answer] = queue.SimpleQueue()
    failures: list[str] = []
    _try(lambda: _over_http(url), "API", answers)
    answered = _take(answers, DIRECT_AFTER_S, failures)
    _try(lambda: _past_the_api(url, config), "control process", answers)
    deadline = time.monotonic() + ALL_S
    for _ in range(1 if answered else 2):
        _take(answers, deadline - time.monotonic(), failures)
    why = "; ".join(failures) or f"the API at {url} has not answered"
    text = f"delivered to nobody: {why}. If the robot may be moving, use the robot's own emergency stop"
    fail("stop", text, Exit.UNREACHABLE)


def _take(answers: "queue.SimpleQueue[Answer]", seconds: float, failures: list[str]) -> bool:
    """Wait for an answer, and return whether there is one; one that delivered the stop ends the command."""
    try:
        answer = answers.get(timeout=max(0.0, seconds))
    except queue.Empty:
        return False
    if answer.delivered:
        _end(answer)
    failures.append(answer.text)
    return True


def _end(answer: Answer) -> None:
    typer.echo(answer.text)
    raise typer.Exit(0 if answer.confirmed else Exit.UNCONFIRMED)


def _try(way: Callable[[], Answer], by: str, answers: "queue.SimpleQueue[Answer]") -> None:
    """Try one way in a thread, which a command that has ended does not wait for."""

    def run() -> None:
        try:
            answers.put(way())
        except Exception as error:  # whatever it is, the other way must be tried
            answers.put(Answer(False, False, f"the {by} was not reached: {error or type(error).__name__}"))

    threading.Thread(target=run, name=by, daemon=True).start()


def _over_http(url: str) -> Answer:
    address = urlsplit(url)
    kind = http.client.HTTPSConnection if address.scheme == "https" else http.client.HTTPConnection
    with closing(kind(address.hostname or "", address.port, timeout=API_S)) as connection:
        connection.request("POST", f"{address.path.rstrip('/')}/stop", headers={"Content-Length": "0"})
        response = connection.getresponse()
        said: dict[str, Any] = json.loads(response.read())
    if response.status not in {200, 202}:
        return Answer(False, False, str(said.get("detail") or f"the API answered {response.status}"))
    return Answer(True, bool(said["confirmed"]), f"{said['state']}: {said['detail']}")


def _past_the_api(url: str, config: Path | None) -> Answer:
    """Ask the control process of the configured cell, if that is the cell whose API was asked."""
    import asyncio

    from service.config import load

    cell = load(config)
    address = urlsplit(url)
    if config is None and (address.hostname not in {"127.0.0.1", "localhost", "::1"} or address.port != cell.api.port):
        raise ValueError(f"the configured cell {cell.cell.id} is not that of {url}: name its file by --config")
    return asyncio.run(_directly(cell.cell.id, cell.cell.endpoint))


async def _directly(cell_id: str, endpoint: str) -> Answer:
    from service.client import CellClient
    from service.messages import StopRequest
    from service.stopping import confirm, deliver, is_standing

    async with CellClient(cell_id, [endpoint]) as client:
        request = StopRequest(reason="stop past the API", requested_by="cli")
        status = await confirm(client, await deliver(client, request, DELIVERY_S))
        standing = is_standing(status)
        said = "standstill is measured" if standing else "delivered, but standstill is not measured yet"
        return Answer(True, standing, f"{status.state}: {said}")
