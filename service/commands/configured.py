"""The cell that a command is about: its configuration, or the end of the command."""

from pathlib import Path
from typing import Annotated

import typer

from service.config import CellConfig, ConfigError, UrSection, load
from service.logs import configure_logs
from wire.exits import Exit

ConfigPath = Annotated[
    Path | None,
    typer.Option(help="TOML file of the cell; default $DSL_ASSEMBLY_CONFIG, else cell.toml, else config/cell.toml."),
]


def load_cell(path: Path | None) -> CellConfig:
    """Read the configuration; one that cannot be used ends the command and says why. The log goes to standard error."""
    configure_logs()
    try:
        return load(path)
    except ConfigError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(Exit.USAGE) from error


def ur_section(cell: CellConfig) -> UrSection:
    """Return the section of the UR arm; a cell without one ends the command."""
    if cell.ur is None or cell.cell.driver != "ur":
        typer.echo('this cell has no UR arm: set cell.driver = "ur" and describe it under [ur]', err=True)
        raise typer.Exit(Exit.USAGE)
    return cell.ur
