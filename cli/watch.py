"""`watch`: the cell live in the terminal."""

import contextlib
import time
from typing import Any

import httpx
from rich.console import Console
from rich.live import Live
from rich.markup import escape

from cli.address import CellFile, Url
from cli.connection import Api, unreachable
from cli.live import RECONNECT_S, STREAM_SILENCE_S, View, outcome, read_stream


def watch(url: Url = None, config: CellFile = None) -> None:
    """Show the cell live in the terminal until Ctrl-C.

    A lost connection is said and taken up again. Without a terminal each change of state and each run's end is a line.
    """
    console = Console(highlight=False, soft_wrap=True)
    with Api.chosen("watch", url, config) as api:
        view = View(console)
        view.take(api.status())
    live = Live(console=console, refresh_per_second=12, get_renderable=view.render, transient=True)
    with contextlib.suppress(KeyboardInterrupt), live if console.is_terminal else contextlib.nullcontext():
        view.follow_frames(api.url)
        told = Told(view, console)
        while True:
            try:
                read_stream(f"{api.url}/events", STREAM_SILENCE_S, told.take)
            except httpx.HTTPError as error:
                told.lose(unreachable(api.url, error))
            time.sleep(RECONNECT_S)


class Told:
    """The newest content of the stream of events.

    Args:
        view: takes in each status.
        console: each ended run and each lost connection is a line of it.
    """

    def __init__(self, view: View, console: Console) -> None:
        self._view = view
        self._console = console
        self._run: dict[str, Any] | None = view.status.get("run")

    def take(self, kind: str, data: Any) -> None:
        """Take in one event of the stream."""
        if kind != "status":
            return
        self._view.take(data)
        run = data.get("run")
        if run is not None and run["state"] != "ACTIVE" and self._is_news(run):
            self._console.print(f"{run['id']} {outcome(run)}")
        self._run = run or self._run

    def lose(self, why: str) -> None:
        """Say once that the connection is lost; what is shown is no longer known."""
        if self._view.status.get("state") != "UNKNOWN":
            self._console.print(f"[red]connection lost[/]: {escape(why)}")
        self._view.status = {**self._view.status, "state": "UNKNOWN"}

    def _is_news(self, run: dict[str, Any]) -> bool:
        before = self._run
        return before is None or before["id"] != run["id"] or before["state"] == "ACTIVE"
