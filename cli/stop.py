"""`stop`: the shortest way to a stop, and a second way past an API that does not answer.

Nothing but the standard library is loaded before the request leaves. It is asked of the API. Meanwhile a second thread
opens a session to the control process of the configured cell. If the API is not there, does not answer at once, does
not reach the control process, or serves another cell, the stop is sent over that session as well.
"""

import http.client
import json
import os
import queue
import threading
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from enum import StrEnum
from typing import Any
from urllib.parse import quote, urlsplit

import typer

from cli.address import DEFAULT_URL, AddressError, CellAddress, CellFile, Url, find_cell, is_address, not_an_address
from cli.exits import leave
from wire.exits import Exit

API_S = 4.0
"""Longest wait for the API's answer, s. A loaded machine has more than the second that the API takes."""
CONFIRM_S = 1.0
"""Time without a confirmation after which the person is told so, s; also the control process's own time for it."""
HEAD_START_S = 0.2
"""Longest time for which the imports of the second way wait until the request to the API has left."""
DIRECT_AFTER_S = 0.5
"""Silence of the API after which the control process is asked as well."""
DELIVERY_S = 3.0
ALL_S = 6.0
"""Longest time for both ways together, from the moment at which the second one is tried, s."""
POLL_S = 0.005
OPERATOR_LENGTH = 64
OWN_STOP = "If the robot may be moving, use the robot's own emergency stop."


class Way(StrEnum):
    """Way to a control process."""

    API = "API"
    DIRECT = "control process"


@dataclass(frozen=True, slots=True)
class Answer:
    """Result of one way to a cell.

    Attributes:
        way: that was taken.
        cell: id of the cell whose control process has the stop; None: nobody has it.
        confirmed: standstill was measured after it.
        text: for people.
    """

    way: Way
    cell: str | None
    confirmed: bool
    text: str


class Attempt:
    """One stop, tried over both ways.

    Args:
        url: of the API.
        cell: the configured cell, if there is one. Its own control process must have the stop.
        names_another: the URL may be that of another cell, so that the configured cell alone is not enough.
    """

    def __init__(self, url: str, cell: CellAddress | None, *, names_another: bool) -> None:
        self._url = url
        self._cell = cell
        self._names_another = names_another
        self._answers: queue.SimpleQueue[Answer] = queue.SimpleQueue()
        self._asked = threading.Event()
        self._send = threading.Event()
        self.heard: list[Answer] = []

    def run(self, tell: Callable[[Answer], object], tell_late: Callable[[], object]) -> None:
        """Try the ways until there is nothing left to wait for.

        Args:
            tell: called at once for each delivery.
            tell_late: called once, if there is no confirmation within `CONFIRM_S`.
        """
        late = threading.Timer(CONFIRM_S, tell_late)
        late.daemon = True
        late.start()
        try:
            self._run(tell)
        finally:
            late.cancel()

    def _run(self, tell: Callable[[Answer], object]) -> None:
        self._try(Way.API, lambda: self._answers.put(_over_http(self._url, self._asked)))
        if (cell := self._cell) is not None:
            self._try(Way.DIRECT, lambda: _past_the_api(cell, self._asked, self._send, self._answers.put))
        deadline = time.monotonic() + DIRECT_AFTER_S
        while not self._is_complete:
            try:
                answer = self._answers.get(timeout=max(0.0, deadline - time.monotonic()))
            except queue.Empty:
                if self._send.is_set():
                    return
            else:
                self.heard.append(answer)
                if answer.cell is not None:
                    tell(answer)
            if not (self._send.is_set() or self._is_complete):
                self._send.set()
                deadline = time.monotonic() + ALL_S

    @property
    def reaches_the_cell(self) -> bool:
        """True if the configured cell has the stop; without a configuration, if any cell has it."""
        return any(answer.cell is not None and answer.cell == self._wanted(answer) for answer in self.heard)

    @property
    def leaves_one_out(self) -> bool:
        """True if the URL may name another cell than the configured one, and its API delivered nothing."""
        return self._names_another and not any(
            answer.way is Way.API and answer.cell is not None for answer in self.heard
        )

    def failures(self) -> str:
        """Say why the ways that delivered nothing did not."""
        said = {answer.way: answer for answer in self.heard}
        texts: list[str] = []
        for way in Way if self._cell is not None else (Way.API,):
            if way not in said:
                where = f" at {self._url}" if way is Way.API else ""
                texts.append(f"the {way}{where} has not answered")
            elif said[way].cell is None:
                texts.append(said[way].text.rstrip("."))
        return "; ".join(texts)

    @property
    def _is_complete(self) -> bool:
        heard = {answer.way for answer in self.heard}
        if heard == set(Way) or (self._cell is None and heard):
            return True
        return self.reaches_the_cell and not (self._names_another and Way.API not in heard)

    def _wanted(self, answer: Answer) -> str | None:
        return answer.cell if self._cell is None else self._cell.cell

    def _try(self, way: Way, work: Callable[[], object]) -> None:
        """Try one way in a thread, which a command that has ended does not wait for."""

        def run() -> None:
            try:
                work()
            except Exception as error:  # whatever it is, the other way must be tried
                text = f"the {way} was not reached: {error or type(error).__name__}"
                self._answers.put(Answer(way, None, False, text))

        threading.Thread(target=run, name=way, daemon=True).start()


def stop(url: Url = None, config: CellFile = None) -> None:
    """Stop whatever moves, now.

    Without an answer from the API of the configured cell the stop goes straight to its control process. Status 0:
    standstill was measured. 6: delivered, standstill is not measured yet. 4: not delivered to the cell.

    This is process protection. It is not the robot's emergency stop and replaces none of its certified safety
    functions.
    """
    cell, unread = None, None
    try:
        cell = find_cell(config)
    except AddressError as error:
        unread = str(error)
    asked = url or (cell.url if cell is not None else DEFAULT_URL)
    # A file that is named by --config, and a URL that is that of the file, leave no doubt about the cell.
    in_doubt = cell is not None and config is None and url is not None and not (is_address(url) and cell.is_at(url))
    attempt = Attempt(asked, cell, names_another=in_doubt)
    attempt.run(
        lambda answer: typer.echo(f"cell {answer.cell}: {answer.text}"),
        lambda: _say(f"NOT CONFIRMED within {CONFIRM_S:g} s; still trying. {OWN_STOP}"),
    )
    why = "; ".join(text for text in (unread, attempt.failures()) if text)
    delivered = [answer for answer in attempt.heard if answer.cell is not None]
    if unread is not None or not attempt.reaches_the_cell:
        whom = "nobody" if not delivered else "the configured cell" if cell is None else f"cell {cell.cell}"
        said = "delivered to" if not delivered else "not delivered to"
        _say(f"NOT CONFIRMED: {said} {whom}: {why}. {OWN_STOP}")
        leave(Exit.UNREACHABLE)
    if attempt.leaves_one_out:
        _say(f"NOT CONFIRMED: if {asked} is the API of another cell, that one has no stop: {why}. {OWN_STOP}")
        leave(Exit.UNCONFIRMED)
    if not all(answer.confirmed for answer in delivered):
        _say(f"NOT CONFIRMED: standstill is not measured. {OWN_STOP}")
        leave(Exit.UNCONFIRMED)
    leave(0)


def _operator() -> str:
    """Return the account that stops, for the record."""
    name = os.environ.get("LOGNAME") or os.environ.get("USER") or f"user {os.getuid()}"
    return f"{name} by the command line"


def _say(text: str) -> None:
    typer.echo(f"stop: {text}", err=True)


def _over_http(url: str, asked: threading.Event) -> Answer:
    try:
        if not is_address(url):
            raise ValueError(not_an_address(url))
        address = urlsplit(url)
        kind = http.client.HTTPSConnection if address.scheme == "https" else http.client.HTTPConnection
        with closing(kind(address.hostname or "", address.port, timeout=API_S)) as connection:
            path = f"{address.path.rstrip('/')}/stop?operator={quote(_operator())}"
            connection.request("POST", path, headers={"Content-Length": "0"})
            asked.set()
            with connection.getresponse() as response:
                said: dict[str, Any] = json.loads(response.read())
    finally:
        asked.set()
    if response.status not in {200, 202}:
        return Answer(Way.API, None, False, str(said.get("detail") or f"the API answered {response.status}"))
    return Answer(Way.API, str(said["cell"]), bool(said["confirmed"]), f"{said['state']}: {said['detail']}")


def _past_the_api(
    cell: CellAddress, asked: threading.Event, send: threading.Event, put: Callable[[Answer], object]
) -> None:
    """Get ready to ask the control process itself, and do it as soon as `send` is set."""
    asked.wait(HEAD_START_S)
    import asyncio

    from service.client import CellClient
    from service.messages import StopRequest
    from service.stopping import confirm, deliver

    async def ask(client: CellClient) -> Answer:
        request = StopRequest(reason="stop past the API", requested_by=_operator()[:OPERATOR_LENGTH])
        stopped = await confirm(client, await deliver(client, request, DELIVERY_S), CONFIRM_S)
        status = stopped.status
        said = "standstill is measured" if stopped.confirmed else "delivered, but standstill is not measured yet"
        return Answer(Way.DIRECT, status.cell, stopped.confirmed, f"{status.state}: {said}")

    async def wait_and_ask() -> None:
        async with CellClient(cell.cell, [cell.endpoint], certificates=cell.certificates) as client:
            async with asyncio.timeout(ALL_S):  # by then a stop that needs no second way has ended the command
                while not send.is_set():
                    await asyncio.sleep(POLL_S)
            try:
                answer = await ask(client)
            except Exception as error:  # said before the session is closed, which a frozen process holds up
                answer = Answer(Way.DIRECT, None, False, f"the {Way.DIRECT} was not reached: {error}")
            put(answer)

    asyncio.run(wait_and_ask())
