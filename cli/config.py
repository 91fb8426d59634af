"""`config …`: the configuration of a cell, and a folder for a new one."""

import json
import re
import shutil
import socket
from contextlib import closing
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from cli import shipped
from cli.exits import fail
from service.config import CellConfig, ConfigError, find, load
from service.program import PROGRAM
from wire.exits import Exit

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Write, check and describe the configuration of a cell.",
)
FILE = "cell.toml"
POLICIES = "policies"
STATE = "state"
_POLICY = re.compile(r"\.\./models/([\w.-]+\.onnx)")
_STATE = re.compile(r'"\.\./var/[\w-]+"')
_ID = re.compile(r'^id = "[^"]+"$', re.MULTILINE)
_PORT = re.compile(r'^(port = |endpoint = "tcp/127\.0\.0\.1:)(\d+)', re.MULTILINE)
_PORT_STEP = 10
_OWN_NAME = re.compile(r" --config config/[\w-]+\.toml")


class Kind(StrEnum):
    """Kind of a new cell."""

    SIMULATED = "simulated"
    UR_EMULATED = "ur-emulated"
    UR3E = "ur3e"

    @property
    def example(self) -> Path:
        """The shipped configuration that it is made from."""
        return shipped.EXAMPLES / ("cell.toml" if self is Kind.SIMULATED else f"{self.value}.toml")


@app.command()
def schema() -> None:
    """Print the JSON schema of the configuration."""
    typer.echo(json.dumps(CellConfig.model_json_schema(), indent=2))


@app.command()
def check(
    file: Annotated[
        Path | None,
        typer.Argument(help="TOML file; default $DSL_ASSEMBLY_CONFIG, else cell.toml, else config/cell.toml."),
    ] = None,
) -> None:
    """Read a configuration as the cell would; name every wrong field, or every recipe whose policy does not fit."""
    try:
        path = find(file)
        cell = load(path)
    except ConfigError as error:
        fail("config check", str(error), Exit.USAGE)
    from service.cell.policies import PolicyRefusedError, PolicyShelf
    from service.cell.policy_process import PolicyProcess
    from service.commands.drivers import make_driver

    opener = PolicyProcess.opener(cell.limits.policy_deadline_s, lockstep=False)
    refused = 0
    with closing(PolicyShelf(cell, make_driver(cell).tick_s, opener)) as shelf:
        for recipe in cell.recipes:
            try:
                shelf.admit(recipe)
            except PolicyRefusedError as error:
                refused += 1
                typer.echo(f"recipe {recipe}: {error}", err=True)
    if refused:
        raise typer.Exit(Exit.FAILED)
    typer.echo(f"{path} can be used: cell {cell.cell.id}, driver {cell.cell.driver}, recipes {', '.join(cell.recipes)}")


@app.command()
def new(
    folder: Annotated[Path, typer.Argument(help="Folder to write; it must not hold anything yet.")],
    kind: Annotated[Kind, typer.Option(help="What the cell's arm is.")] = Kind.SIMULATED,
) -> None:
    """Write a cell's folder: configuration with comments, policies, place for its state.

    The cell's id is the folder's name. A default port that is in use here is replaced by a free one.
    The policies are copies, so an update of this program changes no policy of a cell that works.
    """
    text = kind.example.read_text(encoding="utf-8")
    policies = sorted(set(_POLICY.findall(text)))
    text = _POLICY.sub(rf"{POLICIES}/\1", text)
    text = _STATE.sub(f'"{STATE}"', text)
    text = _OWN_NAME.sub("", text)
    text = _ID.sub(f'id = "{_id_of(folder)}"', text, count=1)
    ports = _free_ports({int(port) for _, port in _PORT.findall(text)})
    text = _PORT.sub(lambda found: f"{found[1]}{ports[int(found[2])]}", text)
    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            fail("config new", f"{folder} is there already and is not empty: name another folder", Exit.USAGE)
        (folder / POLICIES).mkdir(parents=True)
        for name in policies:
            shutil.copyfile(shipped.MODELS / name, folder / POLICIES / name)
        (folder / FILE).write_text(text, encoding="utf-8")
    except OSError as error:
        fail("config new", f"cannot write {error.filename or folder}: {error.strerror}", Exit.HOST)
    typer.echo(f"cell {_id_of(folder)}: wrote {folder / FILE}; policies in {folder / POLICIES}: {', '.join(policies)}")
    for port, taken in ports.items():
        if taken != port:
            typer.echo(f"port {port} is in use here: the cell has {taken} in its place")
    typer.echo(f"Next:\n  cd {folder}")
    if kind is Kind.UR3E:
        typer.echo(f"  measure and write every number marked MEASURE in {FILE}\n  {PROGRAM} ur check")
    typer.echo(f"  {PROGRAM} serve     # then, in another terminal: {PROGRAM} start --wait")


def _id_of(folder: Path) -> str:
    """Return the folder's name as the id of a cell."""
    name = re.sub(r"[^A-Za-z0-9._-]+", "-", folder.resolve().name)
    return name.lstrip("._-")[:64] or "cell"


def _free_ports(ports: set[int]) -> dict[int, int]:
    """Return each port itself where it is free on loopback, else the next free one in steps."""
    found: dict[int, int] = {}
    for port in sorted(ports):
        choice = range(port, 65536, _PORT_STEP)
        found[port] = next((free for free in choice if free not in found.values() and _is_free(free)), port)
    return found


def _is_free(port: int) -> bool:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True
