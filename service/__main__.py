"""`python -m service run` runs the control process of one cell; `schema` prints what its configuration may hold."""

import asyncio
import json
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

import structlog
import typer
import uvloop

from service.cell import process
from service.config import CellConfig, ConfigError, load
from service.drivers.sim_process import simulator
from service.drivers.zenoh_sim import ZenohSimDriver

EXIT_CONFIG = 2
EXIT_HOST = 3

app = typer.Typer(add_completion=False, no_args_is_help=True, help=__doc__)


@app.command()
def run(
    config: Annotated[
        Path | None, typer.Option(help="TOML file of the cell; default $DSL_ASSEMBLY_CONFIG, else config/cell.toml.")
    ] = None,
) -> None:
    """Run the control process until SIGTERM or Ctrl-C."""
    structlog.configure(logger_factory=structlog.PrintLoggerFactory(sys.stderr))
    try:
        cell = load(config)
    except ConfigError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(EXIT_CONFIG) from error
    sim = cell.sim
    try:
        with simulator(sim.world, sim.endpoint, sim.mode) if sim.autostart else nullcontext():
            driver = ZenohSimDriver(sim.world, [sim.endpoint], sim.mode)
            with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
                runner.run(process.run(cell, driver))
    except OSError as error:
        typer.echo(f"the control process cannot run: {error}", err=True)
        raise typer.Exit(EXIT_HOST) from error


@app.command()
def schema() -> None:
    """Print the JSON schema of the configuration."""
    typer.echo(json.dumps(CellConfig.model_json_schema(), indent=2))


if __name__ == "__main__":
    app()
