"""The command behind `make run`: starts the API, presses start over HTTP as an operator would, shows what happens.

`python -m api.demo [--once] [--port 8000]`. Ends with status 1 under `--once` if the peg did not go in.
"""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Generator
from http import HTTPStatus
from pathlib import Path
from typing import Annotated, Any, NoReturn

import httpx
import typer
from rich.console import Console
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from service.config import DEFAULT_PATH, PATH_VARIABLE, CellConfig, ConfigError, load

READY_S = 60.0
RUN_S = 180.0
DEFAULT_SEED = 3
"""The world of the picture in the README, so that a first look is the same for everyone."""
END_S = 20.0
EXIT_USAGE = 2
MARKS = {"SUCCEEDED": "green", "ACTIVE": "blue"}

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
console = Console(highlight=False, soft_wrap=True)


class DemoError(Exception):
    """The demonstration cannot go on; the text is all that a person needs."""


@app.command()
def demo(
    once: Annotated[bool, typer.Option("--once", help="Exit after the insertion, 1 if the peg did not go in.")] = False,
    port: Annotated[
        int | None, typer.Option(min=1, max=65535, help="Port of the page; else the configured one.")
    ] = None,
    recipe: Annotated[str | None, typer.Option(help="Recipe to start; else the first one configured.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the simulated world.")] = DEFAULT_SEED,
) -> None:
    """Start the cell, insert one peg, stay up until Ctrl-C."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job would ignore it
    try:
        code = _demonstrate(once=once, port=port, recipe=recipe, seed=seed)
    except (DemoError, ConfigError) as error:
        _fail(str(error))
    except KeyboardInterrupt:
        code = 130
    raise typer.Exit(code)


def _demonstrate(*, once: bool, port: int | None, recipe: str | None, seed: int) -> int:
    path = Path(os.environ.get(PATH_VARIABLE, DEFAULT_PATH)).resolve()
    config = load(path)
    port = config.api.port if port is None else port
    recipe = recipe or next(iter(config.recipes))
    _check(config, recipe, port)
    with _serving(config, path, port) as (server, http, log):
        console.print(f"cell [bold]{config.cell.id}[/]: page on [bold]http://127.0.0.1:{port}[/], log in {log}")
        _wait_ready(server, http, log, once=once)
        run = _insert(server, http, recipe, seed)
        inserted = run["state"] == "SUCCEEDED"
        _print_outcome(run)
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
    """Run uvicorn as a child for as long as the context lasts."""
    log = config.cell.state_dir / "logs" / "api.log"
    try:
        log.parent.mkdir(parents=True, exist_ok=True)
        output = log.open("wb")
    except OSError as error:
        raise DemoError(f"cannot write {log}: {error.strerror}") from error
    command = [sys.executable, "-m", "uvicorn", "api.app:app", "--host", "127.0.0.1", "--port", str(port)]
    with output:
        # A session of its own: Ctrl-C reaches this process, which then ends the server in order.
        server = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            start_new_session=True,
            env=os.environ | {PATH_VARIABLE: str(path)},
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
    progress = Progress(run["id"])
    threading.Thread(target=progress.follow_frames, args=(str(http.base_url),), daemon=True).start()
    deadline = time.monotonic() + RUN_S
    with Live(console=console, refresh_per_second=12, get_renderable=progress.render, transient=True):
        while time.monotonic() < deadline:
            if server.poll() is not None:
                raise DemoError(f"the server ended during the run with status {server.returncode}")
            with contextlib.suppress(httpx.TransportError, json.JSONDecodeError):
                progress.take(http.get("/status").json())
                run = http.get(where).json()
                if run["state"] != "ACTIVE" and progress.status["state"] in {"READY", "LATCHED"}:
                    return run
            time.sleep(0.1)
    raise DemoError(f"run {run['id']} has not ended after {RUN_S:.0f} s; the cell says {progress.status.get('state')}")


class Progress:
    """What the terminal shows of a run.

    Args:
        run_id: the run that is followed.
    """

    def __init__(self, run_id: str) -> None:
        self.run_id = run_id
        self.status: dict[str, Any] = {}
        self.frame: dict[str, Any] = {}

    def take(self, status: dict[str, Any]) -> None:
        """Take in a status; where no terminal shows it live, say each change of state."""
        if not console.is_terminal and status["state"] != self.status.get("state"):
            console.print(f"  {status['state']}")
        self.status = status

    def follow_frames(self, base_url: str) -> None:
        """Read the telemetry stream until it ends."""
        forever = httpx.Timeout(10, read=None)
        with contextlib.suppress(httpx.HTTPError), httpx.Client(trust_env=False, timeout=forever) as http:
            self._read(http, f"{base_url}/telemetry")

    def _read(self, http: httpx.Client, url: str) -> None:
        with http.stream("GET", url) as response:
            for line in response.iter_lines():
                if line.startswith("data: "):
                    self.frame = json.loads(line.removeprefix("data: "))

    def render(self) -> Table:
        run: dict[str, Any] = self.status.get("run") or {}
        ceiling_n = self.status.get("force_ceiling_n") or 1.0
        force_n = self.frame.get("force_peak_n", 0.0)
        table = Table.grid(padding=(0, 2))
        table.add_row("state", Text(self.status.get("state", "…"), style="bold"), f"step {run.get('steps', 0)}")
        bar = ProgressBar(total=ceiling_n, completed=min(force_n, ceiling_n), width=40)
        table.add_row("force", bar, f"{force_n:5.1f} N of {ceiling_n:.0f}")
        depth = _millimetres(self.frame.get("depth_m"))
        table.add_row(
            "depth", depth, f"peak {run.get('peak_force_n', 0.0):.1f} N, lock {self.frame.get('phase') or '–'}"
        )
        return table


def _print_outcome(run: dict[str, Any]) -> None:
    colour = MARKS.get(run["state"], "red")
    words = "the peg is in" if run["state"] == "SUCCEEDED" else f"{run['code'] or run['state']}: {run['text']}"
    console.print(
        f"[bold {colour}]{run['state']}[/]: {words}. depth {_millimetres(run['depth_m'])}, "
        f"peak force {run['peak_force_n']:.1f} N, {run['steps']} steps, {run['duration_s']:.1f} s"
    )


def _millimetres(metres: float | None) -> str:
    return "–" if metres is None else f"{1e3 * metres:.1f} mm"


def _last_line(log: Path) -> str:
    lines = log.read_text(errors="replace").strip().splitlines()
    return lines[-1][:400] if lines else f"{log} is empty"


def _fail(text: str) -> NoReturn:
    typer.echo(f"demo: {text}", err=True)
    raise typer.Exit(EXIT_USAGE)


if __name__ == "__main__":
    app()
