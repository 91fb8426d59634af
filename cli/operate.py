"""`start`, `status`, `reset` and `runs`: what an operator asks of a running API."""

import json
import time
import uuid
from collections.abc import Callable
from datetime import datetime
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.table import Table

from cli.address import CellFile, Url
from cli.connection import Api, AsJson
from cli.exits import fail
from cli.live import View, millimetres, outcome, plain_console
from service.program import PROGRAM
from wire.exits import Exit

POLL_S = 0.1
SILENCE_S = 3.0
"""Longest silence of the control process while a run is followed, s."""
Seed = Annotated[int | None, typer.Option(min=0, help="Seed of the simulated world; drawn if left out.")]


def start(
    recipe: Annotated[str | None, typer.Argument(help="Recipe; may be left out where the cell has only one.")] = None,
    seed: Seed = None,
    operator: Annotated[str | None, typer.Option(help="Who asks, for the record.")] = None,
    wait: Annotated[bool, typer.Option("--wait", help="Follow the run; 1 if the peg did not go in.")] = False,
    url: Url = None,
    config: CellFile = None,
    as_json: AsJson = False,
) -> None:
    """Ask a running cell for one insertion.

    Without --wait the command ends when the cell has accepted the run, which goes on by itself.
    """
    with Api.chosen("start", url, config) as api:
        found = api.status()
        cell: str = found["cell"]
        body = {"recipe": recipe or _only_recipe(api, found), "seed": seed, "operator": operator}
        accepted: dict[str, Any] = api.post(
            "/start",
            {name: value for name, value in body.items() if value is not None},
            {"Idempotency-Key": f"cli-{uuid.uuid4()}"},
        )
        console = Console(highlight=False, soft_wrap=True, stderr=as_json)
        run_of = f"run [bold]{accepted['id']}[/], recipe {body['recipe']}, seed {accepted['seed']}"
        console.print(f"cell {cell}: accepted: {run_of}")
        try:
            run = follow(api, accepted["id"], console) if wait else accepted
        except KeyboardInterrupt:
            fail("start", f"the run of cell {cell} goes on; `{PROGRAM} stop` stops it", Exit.INTERRUPTED)
    if as_json:
        typer.echo(json.dumps(run))
    elif wait:
        console.print(f"cell {cell}: {outcome(run)}")
    if wait and run["state"] != "SUCCEEDED":
        raise typer.Exit(Exit.FAILED)


def status(url: Url = None, config: CellFile = None, as_json: AsJson = False) -> None:
    """Say what is measured now; 4 where the cell is UNKNOWN."""
    with Api.chosen("status", url, config) as api:
        found = api.status()
    if as_json:
        typer.echo(json.dumps(found))
    else:
        plain_console().print(_describe(found))
    if found["state"] == "UNKNOWN":
        raise typer.Exit(Exit.UNREACHABLE)


def reset(
    operator: Annotated[str, typer.Option(help="Who looked at the cell.")],
    comment: Annotated[str, typer.Option(help="What was found; stands in the cell's journal.")] = "",
    acknowledge: Annotated[
        str | None, typer.Option(metavar="CODE", help="The fault that was seen; default: the one in force.")
    ] = None,
    url: Url = None,
    config: CellFile = None,
) -> None:
    """Acknowledge the latched fault after looking at the cell.

    Nothing moves, and no run is taken up again. The request names the fault in force: if another one takes its place
    meanwhile, the cell refuses.
    """
    with Api.chosen("reset", url, config) as api:
        found = api.status()
        latch = found["latch"]
        code = acknowledge or (latch and latch["code"])
        body = {"operator": operator, "comment": comment} | ({"acknowledge": code} if code else {})
        answer = api.post("/reset", body)
    typer.echo(f"cell {found['cell']}: {code} acknowledged; the cell is {answer['state']}")


def runs(
    limit: Annotated[int, typer.Option(min=1, max=200, help="How many.")] = 20,
    before: Annotated[str | None, typer.Option(metavar="RUN", help="Only older ones than this.")] = None,
    url: Url = None,
    config: CellFile = None,
    as_json: AsJson = False,
) -> None:
    """List the runs, newest first."""
    with Api.chosen("runs", url, config) as api:
        page: list[dict[str, Any]] = api.get("/runs", limit=limit, **({"before": before} if before else {}))["runs"]
    if as_json:
        typer.echo(json.dumps(page))
        return
    table = Table("run", "requested", "recipe", "seed", "outcome", "steps", "depth", "peak force", box=None)
    for run in page:
        table.add_row(
            run["id"],
            f"{datetime.fromtimestamp(run['requested_at']).astimezone():%Y-%m-%d %H:%M:%S}",
            run["recipe"],
            "–" if run["seed"] is None else str(run["seed"]),
            run["code"] or run["state"],
            str(run["steps"]),
            millimetres(run["depth_m"]),
            f"{run['peak_force_n']:.1f} N",
        )
    plain_console().print(table if page else "no run yet")


def _only_recipe(api: Api, found: dict[str, Any]) -> str:
    recipes: list[str] = found["recipes"]
    if not recipes:
        fail(api.command, found["why_not"] or "the cell names no recipe", Exit.UNREACHABLE)
    if len(recipes) > 1:
        fail(api.command, f"name one of the cell's recipes: {', '.join(recipes)}", Exit.USAGE)
    return recipes[0]


def follow(api: Api, run_id: str, console: Console, check: Callable[[], None] = lambda: None) -> dict[str, Any]:
    """Show a run until it has ended and the cell is READY or LATCHED; return it.

    Args:
        api: of the cell.
        run_id: the run to follow.
        console: that the run is shown on.
        check: called before each question to the API; it raises where the run cannot be followed any more.
    """
    view = View(console)
    view.follow_frames(api.url)
    with Live(console=console, refresh_per_second=12, get_renderable=view.render, transient=True):
        heard = time.monotonic()
        while True:
            check()
            view.take(api.status())
            if view.status["state"] != "UNKNOWN":
                heard = time.monotonic()
            elif time.monotonic() - heard > SILENCE_S:
                fail(api.command, f"run {run_id} was lost sight of: {view.status['why_not']}", Exit.UNREACHABLE)
            run: dict[str, Any] = api.get(f"/runs/{run_id}")
            if run["state"] != "ACTIVE" and view.status["state"] in {"READY", "LATCHED"}:
                return run
            time.sleep(POLL_S)


def _describe(found: dict[str, Any]) -> Table:
    table = Table.grid(padding=(0, 2))
    table.add_row("cell", found["cell"])
    table.add_row("state", f"[bold]{found['state']}[/]")
    if found["why_not"]:
        table.add_row("cannot start", escape(found["why_not"]))
    if latch := found["latch"]:
        table.add_row("latch", escape(f"{latch['code']}: {latch['text']}"))
    if run := found["run"]:
        table.add_row("run", f"{run['id']}, {run['recipe']}: {run['state']}, {run['steps']} steps")
    if measured := found["measured"]:
        position = ", ".join(f"{1e3 * value:.1f}" for value in measured["tcp_position_m"])
        moves = "moving" if measured["moving"] else "standing"
        table.add_row("arm", f"{moves}, TCP at {position} mm, {measured['force_magnitude_n']:.1f} N")
    for line in found["degradations"]:
        table.add_row("degraded", escape(line))
    table.add_row("recipes", ", ".join(found["recipes"]) or "–")
    return table
