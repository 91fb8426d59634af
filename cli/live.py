"""Terminal output: the cell while it changes, and the outcome of a run."""

import contextlib
import json
import threading
import time
from collections.abc import Callable
from typing import Any

import httpx
from rich.console import Console
from rich.markup import escape
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

COLOURS = {"SUCCEEDED": "green", "ACTIVE": "blue", "READY": "green", "LATCHED": "red", "UNKNOWN": "red"}
STREAM_SILENCE_S = 3.0
"""Longer than the API is ever silent on `/events`."""
RECONNECT_S = 0.5
PIPE_WIDTH = 240


def plain_console() -> Console:
    """Return a console for tables: what is piped elsewhere is cut at no edge of a terminal."""
    console = Console(highlight=False, soft_wrap=True)
    if not console.is_terminal:
        console.width = PIPE_WIDTH
    return console


class View:
    """The live view of one cell.

    Args:
        console: that it is shown on. Where that is no terminal, each change of state is a line.
    """

    def __init__(self, console: Console) -> None:
        self.status: dict[str, Any] = {}
        self.frame: dict[str, Any] = {}
        self._console = console

    def take(self, status: dict[str, Any]) -> None:
        """Take in a status."""
        if not self._console.is_terminal and status["state"] != self.status.get("state"):
            why = status.get("why_not") if status["state"] in {"LATCHED", "UNKNOWN"} else None
            self._console.print(f"  {status['state']}{f': {why}' if why else ''}", markup=False)
        self.status = status

    def follow_frames(self, url: str) -> None:
        """Read `/telemetry` in a thread, again where it breaks off, for as long as this process lives."""

        def take(_kind: str, frame: dict[str, Any]) -> None:
            self.frame = frame

        def read() -> None:
            while True:
                with contextlib.suppress(httpx.HTTPError):
                    read_stream(f"{url}/telemetry", None, take)
                time.sleep(RECONNECT_S)

        threading.Thread(target=read, name="telemetry", daemon=True).start()

    def render(self) -> Table:
        """Draw what was taken in."""
        run: dict[str, Any] = self.status.get("run") or {}
        ceiling_n = self.status.get("force_ceiling_n")
        force_n = self.frame.get("force_peak_n", 0.0)
        state = self.status.get("state", "…")
        table = Table.grid(padding=(0, 2))
        table.add_row("state", Text(state, style=f"bold {COLOURS.get(state, '')}"), f"step {run.get('steps', 0)}")
        if ceiling_n is None:
            table.add_row("force", f"{force_n:5.1f} N", "the ceiling in force is not known")
        else:
            bar = ProgressBar(total=ceiling_n, completed=min(force_n, ceiling_n), width=40)
            table.add_row("force", bar, f"{force_n:5.1f} N of {ceiling_n:.0f}")
        table.add_row(
            "depth",
            millimetres(self.frame.get("depth_m")),
            f"peak {run.get('peak_force_n', 0.0):.1f} N, lock {self.frame.get('phase') or '–'}",
        )
        return table


def read_stream(url: str, silence_s: float | None, take: Callable[[str, Any], object]) -> None:
    """Read server-sent events and hand each one's kind and JSON to `take`, until the server ends the stream.

    Raises:
        httpx.HTTPError: no connection, or silence for longer than `silence_s`; None: however long.
    """
    kind = "message"
    with (
        httpx.Client(trust_env=False, timeout=httpx.Timeout(10.0, read=silence_s)) as http,
        http.stream("GET", url) as response,
    ):
        response.raise_for_status()
        for line in response.iter_lines():
            field, _, value = line.partition(": ")
            if field == "event":
                kind = value
            elif field == "data":
                take(kind, json.loads(value))


def outcome(run: dict[str, Any]) -> str:
    """Say in one line, with rich's markup, how a run ended."""
    colour = COLOURS.get(run["state"], "red")
    words = "the peg is in" if run["state"] == "SUCCEEDED" else escape(f"{run['code'] or run['state']}: {run['text']}")
    return (
        f"[bold {colour}]{run['state']}[/]: {words}. depth {millimetres(run['depth_m'])}, "
        f"peak force {run['peak_force_n']:.1f} N, {run['steps']} steps, {run['duration_s']:.1f} s"
    )


def millimetres(metres: float | None) -> str:
    """Write a length for people."""
    return "–" if metres is None else f"{1e3 * metres:.1f} mm"
