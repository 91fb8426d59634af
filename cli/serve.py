"""`serve`: one cell behind its HTTP interface."""

import faulthandler
import os
import signal
import socket
import threading
from types import FrameType
from typing import Annotated, NoReturn

import typer
import uvicorn

from cli.exits import fail
from service.commands.configured import ConfigPath
from wire.exits import Exit

GRACE_S = 1
"""Longest wait for open responses once the server is told to end, s; a stop is answered by then."""
END_S = 10.0
"""Time after which a server that was told to end, and has not, ends at once, s."""


class Server(uvicorn.Server):
    """A server that ends in order however often it is told to: its end is that of the control process as well."""

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Take a signal; a second Ctrl-C skips nothing."""
        if not self.should_exit:
            last = threading.Timer(END_S, _end_at_once)
            last.daemon = True
            last.start()
        super().handle_exit(sig, frame)
        self.force_exit = False


def serve(
    config: ConfigPath = None,
    host: Annotated[str | None, typer.Option(help="Address to listen on; default: api.host.")] = None,
    port: Annotated[int | None, typer.Option(min=1, max=65535, help="Port to listen on; default: api.port.")] = None,
) -> None:
    """Serve one cell: API and page, control process, simulator.

    The control process is started where none answers, and the simulator where the configuration asks for one. Ctrl-C,
    SIGTERM and the end of the terminal end what was started. The log goes to standard error, one JSON object a line.
    """
    from api.application import create_app
    from api.connections import Connection, most_waiting
    from api.logs import configure_logs
    from service.config import ConfigError, find, load
    from service.logs import take_over_stderr

    try:
        path = find(config)
        cell = load(path)
        given = {name: value for name, value in (("host", host), ("port", port)) if value is not None}
        cell = cell.model_copy(update={"api": cell.api.model_copy(update=given)})
        app = create_app(cell, path)
    except (ConfigError, ValueError) as error:
        fail("serve", str(error), Exit.USAGE)
    configure_logs()
    take_over_stderr()
    listener = _listen(cell.api.host, cell.api.port)
    typer.echo(f"cell {cell.cell.id}: page on http://{cell.api.host}:{cell.api.port}")
    _end_on_signals()
    # uvicorn takes the signals over while it serves, and raises them again when everything has ended.
    settings = uvicorn.Config(
        app,
        http=Connection,
        ws="none",
        backlog=most_waiting(),
        log_config=None,
        timeout_graceful_shutdown=GRACE_S,
    )
    server = Server(settings)
    server.run(sockets=[listener])
    if not server.started:
        fail("serve", "the server did not start; the log above says why", Exit.HOST)


def _end_at_once() -> None:
    """End a process that hangs. What it started was told to end by the signal itself."""
    faulthandler.dump_traceback(all_threads=True)
    os._exit(Exit.FAILED)


def _listen(host: str, port: int) -> socket.socket:
    """Take the port before anything is started."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except OSError as error:
        fail(
            "serve",
            f"cannot listen on {host}:{port} ({error.strerror}): end what uses it, or give another --port",
            Exit.HOST,
        )


def _end_on_signals() -> None:
    """Let Ctrl-C and SIGTERM end this process in order, and the end of its terminal as well."""

    def leave(_number: int, _frame: FrameType | None) -> NoReturn:
        raise SystemExit(0)

    def hang_up(_number: int, _frame: FrameType | None) -> None:
        signal.raise_signal(signal.SIGTERM)

    signal.signal(signal.SIGINT, leave)
    signal.signal(signal.SIGTERM, leave)
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # as under nohup
        signal.signal(signal.SIGHUP, hang_up)
