"""`demo`, behind `make run`: starts the API, presses start over HTTP as an operator would, shows what happens."""

import contextlib
import os
import signal
import socket
import time
from collections.abc import Callable, Generator
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, NoReturn

import typer
from rich.console import Console

from cli.connection import Api
from cli.exits import fail
from cli.live import outcome
from cli.operate import POLL_S, follow
from service.commands.configured import ConfigPath
from service.config import CellConfig, ConfigError, find, load
from service.program import Child
from wire.exits import Exit

READY_S = 60.0
RUN_S = 180.0
DEFAULT_SEED = 3
"""The world of the picture in the README, so that a first look is the same for everyone."""
END_S = 20.0
console = Console(highlight=False, soft_wrap=True)


class DemoError(Exception):
    """The demonstration cannot go on; the text is all that a person needs."""


def demo(
    config: ConfigPath = None,
    once: Annotated[bool, typer.Option("--once", help="Exit after the insertion, 1 if the peg did not go in.")] = False,
    port: Annotated[
        int | None, typer.Option(min=1, max=65535, help="Port of the page; else the configured one.")
    ] = None,
    recipe: Annotated[str | None, typer.Option(help="Recipe to start; else the first one configured.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the simulated world.")] = DEFAULT_SEED,
) -> None:
    """Start the cell, insert one peg, stay up until Ctrl-C.

    What can be checked before anything starts is checked first, and said in one line.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job would ignore it
    try:
        code = _demonstrate(config, once=once, port=port, recipe=recipe, seed=seed)
    except (DemoError, ConfigError) as error:
        fail("demo", str(error), Exit.USAGE)
    except KeyboardInterrupt:
        code = Exit.INTERRUPTED
    raise typer.Exit(code)


def _demonstrate(file: Path | None, *, once: bool, port: int | None, recipe: str | None, seed: int) -> int:
    path = find(file)
    config = load(path)
    port = config.api.port if port is None else port
    recipe = recipe or next(iter(config.recipes))
    _check(config, recipe, port)
    with _serving(config, path, port) as server, Api("demo", f"http://127.0.0.1:{port}") as api:
        console.print(f"cell [bold]{config.cell.id}[/]: page on [bold]{api.url}[/], log in {server.log}")
        _wait_ready(server, api, once=once)
        run = _insert(server, api, recipe, seed)
        inserted = run["state"] == "SUCCEEDED"
        console.print(outcome(run))
        if once:
            return 0 if inserted else 1
        with contextlib.suppress(KeyboardInterrupt):
            console.print(f"The cell stays up: [bold]{api.url}[/]. Ctrl-C ends it.")
            server.process.wait()
            raise DemoError(f"{server.ending()}; see {server.log}")
    return 0


def _check(config: CellConfig, recipe: str, port: int) -> None:
    """Say what is missing before anything is started."""
    if recipe not in config.recipes:
        raise DemoError(f"no recipe {recipe!r}; there are {', '.join(config.recipes)}")
    policy = config.recipes[recipe].policy
    if not policy.is_file():
        raise DemoError(f"recipe {recipe} wants the policy {policy}, which is not there: check it out, or train one")
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            raise DemoError(
                f"port {port} on 127.0.0.1 cannot be used ({error.strerror}): end what uses it, or give --port "
                "(make run PORT=8001)"
            ) from error


@contextlib.contextmanager
def _serving(config: CellConfig, path: Path, port: int) -> Generator[Child]:
    """Run `serve` as a child for as long as the context lasts."""
    log = config.cell.state_dir / "logs" / "api.log"
    arguments = ("serve", "--config", str(path), "--host", "127.0.0.1", "--port", str(port))
    told: list[int] = []
    # An interrupt between the fork and the first line of the `try` would leave a server that nobody ends.
    _on_signals(lambda number, _frame: told.append(number))
    try:
        # A session of its own: Ctrl-C reaches this process, which then ends the server in order. So does the kernel, if
        # this process is killed.
        server = Child.start("server", arguments, log, ends_with_parent=signal.SIGTERM)
    except OSError as error:
        raise DemoError(f"cannot write {log}: {error.strerror}") from error
    try:
        _on_signals(_interrupt)
        if told:
            raise KeyboardInterrupt
        yield server
    finally:
        _on_signals(signal.SIG_IGN)
        if server.ending() is None:
            console.print("ending the cell")
        server.end(END_S)


def _on_signals(handler: Callable[[int, FrameType | None], Any] | signal.Handlers) -> None:
    """Set what Ctrl-C, a supervisor's SIGTERM and the end of the terminal do."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, handler)


def _interrupt(_number: int, _frame: FrameType | None) -> NoReturn:
    _on_signals(signal.SIG_IGN)  # a second Ctrl-C must not leave the cell behind
    raise KeyboardInterrupt


def _wait_ready(server: Child, api: Api, *, once: bool) -> None:
    deadline = time.monotonic() + READY_S
    said = "starting"
    told_of_latch = False
    with console.status(said) as spinner:
        while time.monotonic() < deadline or told_of_latch:
            _check_server(server)
            if (status := api.status_if_up()) is not None:
                if status["can_start"]:
                    return
                said = f"{status['state']}: {status['why_not'] or ''}"
                if "ended with status" in said:
                    raise DemoError(said)
                spinner.update(said)
                if status["state"] == "LATCHED" and not told_of_latch:
                    latch = status["latch"]
                    told = f"the cell is latched from before by {latch['code']} ({latch['text']})"
                    if once:
                        raise DemoError(f"{told}: run without --once (make run) and reset it on the page")
                    console.print(f"[bold red]LATCHED[/]: {told}. Reset it on the page; the insertion follows.")
                    told_of_latch = True
            time.sleep(POLL_S)
    raise DemoError(f"the cell is not ready after {READY_S:.0f} s. {said}")


def _insert(server: Child, api: Api, recipe: str, seed: int) -> dict[str, Any]:
    """Press start and follow the run to its end."""
    key = f"demo-{os.getpid()}-{time.time_ns()}"
    run: dict[str, Any] = api.post("/start", {"recipe": recipe, "seed": seed}, {"Idempotency-Key": key})
    console.print(f"POST /start accepted: run [bold]{run['id']}[/], recipe {recipe}, seed {run['seed']}")
    deadline = time.monotonic() + RUN_S

    def check() -> None:
        _check_server(server)
        if time.monotonic() > deadline:
            raise DemoError(f"run {run['id']} has not ended after {RUN_S:.0f} s")

    return follow(api, run["id"], console, check)


def _check_server(server: Child) -> None:
    if (ending := server.ending()) is not None:
        raise DemoError(ending)
