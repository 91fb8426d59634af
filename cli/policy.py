"""`policy …`: what a policy file is, and whether a cell would run it."""

from collections.abc import Mapping
from contextlib import closing
from math import inf
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from cli.exits import fail
from cli.live import plain_console
from service.cell.policies import PolicyRefusedError, PolicyShelf
from service.cell.policy_process import PolicyProcess
from service.commands.configured import ConfigPath, load_cell
from service.commands.drivers import make_driver
from service.policy.contract import PolicyContract
from service.policy.model import PolicyError
from wire.exits import Exit

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Look into a policy file, or ask whether it fits a cell.",
)
File = Annotated[Path, typer.Argument(help="ONNX file of the policy.")]


@app.command()
def inspect(
    file: File, as_json: Annotated[bool, typer.Option("--json", help="Print the contract as JSON.")] = False
) -> None:
    """Load a policy as a cell would, and print its contract."""
    try:
        # In a process of its own, as in a cell: a model may hang
        with closing(PolicyProcess(file, step_limit_s=inf)) as policy:
            sha256, contract = policy.loaded()
    except PolicyError as error:
        fail("policy inspect", str(error), Exit.USAGE)
    if as_json:
        typer.echo(contract.to_json())
    else:
        plain_console().print(_describe(sha256, contract))


@app.command()
def check(
    file: File,
    recipe: Annotated[str, typer.Option(help="Recipe of the cell that the policy is to run.")],
    config: ConfigPath = None,
) -> None:
    """Say whether a policy fits a recipe of a cell, or every reason for which the cell would refuse it; 1 then."""
    cell = load_cell(config)
    if recipe not in cell.recipes:
        fail("policy check", f"no recipe {recipe!r}; there are {', '.join(cell.recipes)}", Exit.USAGE)
    asked = cell.recipes[recipe].model_copy(update={"policy": file.resolve()})
    try:
        only = cell.model_copy(update={"recipes": {recipe: asked}})
        opener = PolicyProcess.opener(cell.limits.policy_deadline_s, lockstep=False)
        with closing(PolicyShelf(only, make_driver(cell).tick_s, opener)) as shelf:
            policy = shelf.admit(recipe)
    except PolicyRefusedError as error:
        fail("policy check", str(error), Exit.FAILED)
    typer.echo(f"{file} fits recipe {recipe} of {cell.cell.id}; SHA-256 {policy.sha256}")


def _describe(sha256: str, contract: PolicyContract) -> Table:
    low, high = (1e3 * clearance for clearance in contract.clearance_m)
    table = Table.grid(padding=(0, 2))
    for name, value in (
        ("name", contract.name),
        ("SHA-256", sha256),
        ("parts", ", ".join(contract.parts)),
        ("clearance", f"{low:g} to {high:g} mm per face"),
        ("observes", f"{contract.mode}: {', '.join(entry.name for entry in contract.observation)}"),
        ("acts by", ", ".join(f"{entry.name} ±{entry.limit:g} {entry.unit}" for entry in contract.action)),
        ("step", f"{1e3 * contract.period_s:g} ms, at most {contract.max_steps} steps"),
        ("lock", contract.dsl.mode),
        ("stiffness", " ".join(f"{value:g}" for value in contract.compliance.stiffness)),
        ("recurrent", f"{contract.hidden_size} numbers" if contract.hidden_size else "no"),
        *_evaluation(contract),
        ("provenance", ", ".join(_plain(contract.provenance)) or "none stated"),
    ):
        table.add_row(name, escape(value))
    return table


def _plain(provenance: Mapping[str, object]) -> list[str]:
    """The facts that fit a line; `--json` has them all."""
    return [f"{key} {value}" for key, value in provenance.items() if isinstance(value, str | int | float)]


def _evaluation(contract: PolicyContract) -> list[tuple[str, str]]:
    return [
        (
            "measured",
            f"{figure.successes} of {figure.episodes} at {1e3 * figure.clearance_m:g} mm, {figure.conditions}; "
            f"95 % interval {figure.low:.1%} to {figure.high:.1%}",
        )
        for figure in contract.evaluation
    ]
