"""`demo`, behind `make run`: starts the API, presses start over HTTP as an operator would, shows what happens."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import time
from collections.abc import Generator
from http import HTTPStatus
from pathlib import Path
from typing import Annotated, Any, NoReturn

import httpx
import typer
from rich.console import Console
from rich.live import Live

from cli.exits import Exit, fail
from cli.live import View, outcome
from service.commands.configured import ConfigPath
from service.config import CellConfig, ConfigError, find, load
from service.program import command

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
    with _serving(config, path, port) as (server, http, log):
        console.print(f"cell [bold]{config.cell.id}[/]: page on [bold]http://127.0.0.1:{port}[/], log in {log}")
        _wait_ready(server, http, log, once=once)
        run = _insert(server, http, recipe, seed)
        inserted = run["state"] == "SUCCEEDED"
        console.print(outcome(run))
        if once:
            return 0 if inserted else 1
        with contextlib.suppress(KeyboardInterrupt):
            console.print(f"The cell stays up: [bold]http://127.0.0.1:{port}[/]. Ctrl-C ends it.")
            server.wait()
            raise DemoError(f"the server ended by itself with status {server.returncode}; see {log}")
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
def _serving(
    config: CellConfig, path: Path, port: int
) -> Generator[tuple[subprocess.Popen[bytes], httpx.Client, Path]]:
    """Run `serve` as a child for as long as the context lasts."""
    log = config.cell.state_dir / "logs" / "api.log"
    try:
        log.parent.mkdir(parents=True, exist_ok=True)
        output = log.open("wb")
    except OSError as error:
        raise DemoError(f"cannot write {log}: {error.strerror}") from error
    with output:
        # A session of its own: Ctrl-C reaches this process, which then ends the server in order.
        server = subprocess.Popen(
            command("serve", "--config", str(path), "--host", "127.0.0.1", "--port", str(port)),
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            start_new_session=True,
        )
    # `make run` in a closed terminal, or ended by a supervisor, must leave nothing behind either.
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _interrupt)
    try:
        with httpx.Client(base_url=f"http://127.0.0.1:{port}", trust_env=False, timeout=15) as http:
            yield server, http, log
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second Ctrl-C must not leave the cell behind
        if server.poll() is None:
            console.print("ending the cell")
            server.terminate()
        try:
            server.wait(END_S)
        except subprocess.TimeoutExpired:
            server.kill()
            server.wait()


def _interrupt(_number: int, _frame: Any) -> NoReturn:
    raise KeyboardInterrupt


def _wait_ready(server: subprocess.Popen[bytes], http: httpx.Client, log: Path, *, once: bool) -> None:
    deadline = time.monotonic() + READY_S
    said = "starting"
    told_of_latch = False
    with console.status(said) as spinner:
        while time.monotonic() < deadline or told_of_latch:
            if server.poll() is not None:
                raise DemoError(f"the server did not start: {_last_line(log)}")
            with contextlib.suppress(httpx.TransportError):
                status = http.get("/status").json()
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
            time.sleep(0.1)
    raise DemoError(f"the cell is not ready after {READY_S:.0f} s. {said}")


def _insert(server: subprocess.Popen[bytes], http: httpx.Client, recipe: str, seed: int) -> dict[str, Any]:
    """Press start and follow the run to its end."""
    body = {"recipe": recipe, "seed": seed}
    key = f"demo-{os.getpid()}-{time.time_ns()}"
    response = http.post("/start", json=body, headers={"Idempotency-Key": key})
    if response.status_code != HTTPStatus.ACCEPTED:
        raise DemoError(f"the cell refused the start: {response.json()['detail']}")
    run: dict[str, Any] = response.json()
    where = response.headers["Location"]
    console.print(f"POST /start accepted: run [bold]{run['id']}[/], recipe {recipe}, seed {run['seed']}")
    view = View(console)
    view.follow_frames(str(http.base_url).rstrip("/"))
    deadline = time.monotonic() + RUN_S
    with Live(console=console, refresh_per_second=12, get_renderable=view.render, transient=True):
        while time.monotonic() < deadline:
            if server.poll() is not None:
                raise DemoError(f"the server ended during the run with status {server.returncode}")
            with contextlib.suppress(httpx.TransportError, json.JSONDecodeError):
                view.take(http.get("/status").json())
                run = http.get(where).json()
                if run["state"] != "ACTIVE" and view.status["state"] in {"READY", "LATCHED"}:
                    return run
            time.sleep(0.1)
    raise DemoError(f"run {run['id']} has not ended after {RUN_S:.0f} s; the cell says {view.status.get('state')}")


def _last_line(log: Path) -> str:
    lines = log.read_text(errors="replace").strip().splitlines()
    return lines[-1][:400] if lines else f"{log} is empty"
