"""HTTP to a running API, with errors that are one line each."""

from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Annotated, Any, Self

import httpx
import typer

from cli.address import DEFAULT_URL, URL_VARIABLE, AddressError, find_cell, is_address, not_an_address
from cli.exits import fail
from service.program import PROGRAM
from wire.exits import Exit

TIMEOUT_S = 15.0
SILENT = frozenset({"CELL_SILENT", "STOP_NOT_DELIVERED", "SHUTTING_DOWN"})
"""Reasons of an API behind which nobody acted."""

AsJson = Annotated[bool, typer.Option("--json", help="Print the API's answer as JSON.")]


class Api:
    """One API, asked by one command.

    Args:
        command: that asks, for its error texts.
        url: of the API.
        cell: id of the cell that it must serve; None: of any.
    """

    def __init__(self, command: str, url: str, cell: str | None = None) -> None:
        self.command = command
        self.url = url.rstrip("/")
        self._cell = cell
        if not is_address(self.url):
            fail(command, not_an_address(url), Exit.USAGE)
        self._http = httpx.Client(base_url=self.url, trust_env=False, timeout=TIMEOUT_S)

    @classmethod
    def chosen(cls, command: str, url: str | None, config: Path | None) -> Self:
        """Return the API at `url`, else that of the configuration that is found, else the one at the default address.

        Args:
            command: that asks, for its error texts.
            url: of the API, where one is given.
            config: file of the cell, where one is given. The API must then serve that cell, at whatever address.
        """
        if url is not None and config is None:
            return cls(command, url)
        try:
            found = find_cell(config)
        except AddressError as error:
            fail(command, str(error), Exit.USAGE)
        return cls(command, url or DEFAULT_URL) if found is None else cls(command, url or found.url, found.cell)

    def __enter__(self) -> Self:
        try:
            self._check_cell()
        except BaseException:
            self._http.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._http.close()

    def get(self, path: str, **query: Any) -> Any:
        """Return the JSON of an answer; one that is an error ends the command."""
        return self._ask("GET", path, params=query)

    def post(self, path: str, body: Mapping[str, Any], headers: Mapping[str, str] | None = None) -> Any:
        """Send a command, once; an error ends this command."""
        return self._ask("POST", path, json=body, headers=headers)

    def status(self) -> dict[str, Any]:
        """Return the status; a cell that is UNKNOWN is one too."""
        return self.get("/status")

    def status_if_up(self) -> dict[str, Any] | None:
        """Return the status; None while the API does not answer."""
        try:
            return self._http.get("/status").json()
        except httpx.TransportError:
            return None

    def _check_cell(self) -> None:
        if self._cell is not None and (served := self.status()["cell"]) != self._cell:
            text = f"the API at {self.url} serves cell {served}, not the configured cell {self._cell}"
            fail(self.command, f"{text}: name the API of {self._cell} by --url", Exit.UNREACHABLE)

    def _ask(self, method: str, path: str, **rest: Any) -> Any:
        try:
            response = self._http.request(method, path, **rest)
            answer = response.json()
        except httpx.ConnectError as error:
            fail(self.command, unreachable(self.url, error), Exit.UNREACHABLE)
        except httpx.TransportError as error:
            why = str(error) or type(error).__name__
            text = f"the API at {self.url} gave no answer ({why})"
            if method != "GET":
                text += f"; whether it acted is not known: look at `{PROGRAM} status`"
            fail(self.command, text, Exit.UNREACHABLE)
        except ValueError:
            fail(self.command, f"{self.url} is no API of a cell: it does not answer in JSON", Exit.UNREACHABLE)
        if response.is_success:
            return answer
        reason = answer.get("reason")
        text = f"{reason or response.status_code}: {answer.get('detail') or response.reason_phrase}"
        fail(self.command, text, Exit.UNREACHABLE if reason in SILENT else Exit.REFUSED)


def unreachable(url: str, error: Exception) -> str:
    """Say that no API answers, and what to do."""
    why = str(error) or type(error).__name__
    return f"no API answers at {url} ({why}): start one by `{PROGRAM} serve`, or name it by --url or ${URL_VARIABLE}"
