"""`python -m service run` runs the control process of one cell; `schema` prints what its configuration may hold.

`python -m service ur …` is for the operator of a Universal Robots arm: the start-up gate, power, the release from a
protective stop, and the gripper.
"""

import asyncio
import json
import sys
import time
from collections.abc import Callable, Coroutine
from contextlib import AbstractContextManager, nullcontext
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, TypeVar

import structlog
import typer
import uvloop
from rich.console import Console
from rich.table import Table

from service.cell import process
from service.config import CellConfig, ConfigError, UrSection, load
from service.drivers.base import Driver, DriverError, Sample
from service.drivers.camera import ZenohCamera
from service.drivers.sim_process import simulator
from service.drivers.ur import gate, recovery
from service.drivers.ur.dashboard import DashboardError
from service.drivers.ur.driver import UrDriver
from service.drivers.ur.gripper import Gripper, GripperError, Status
from service.drivers.ur.program import ProgramError
from service.drivers.world_setup import ZenohWorldSetup
from service.drivers.zenoh_sim import ZenohSimDriver
from service.faults import FaultCode

EXIT_FAILED = 1
EXIT_CONFIG = 2
EXIT_HOST = 3

ConfigPath = Annotated[
    Path | None, typer.Option(help="TOML file of the cell; default $DSL_ASSEMBLY_CONFIG, else config/cell.toml.")
]

T = TypeVar("T")

app = typer.Typer(add_completion=False, no_args_is_help=True, help=__doc__)
ur_app = typer.Typer(add_completion=False, no_args_is_help=True, help="Operate a Universal Robots arm.")
app.add_typer(ur_app, name="ur")


@app.command()
def run(config: ConfigPath = None) -> None:
    """Run the control process until SIGTERM or Ctrl-C."""
    cell = _load(config)
    driver = _driver(cell)
    try:
        with _world(cell), asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
            runner.run(process.run(cell, driver))
    except OSError as error:
        typer.echo(f"the control process cannot run: {error}", err=True)
        raise typer.Exit(EXIT_HOST) from error


@app.command()
def schema() -> None:
    """Print the JSON schema of the configuration."""
    typer.echo(json.dumps(CellConfig.model_json_schema(), indent=2))


@ur_app.command()
def check(config: ConfigPath = None) -> None:
    """Pass the start-up gate once and print the measurements; the arm does not move. Stop the cell first."""
    cell = _load(config)
    _ur_of(cell)
    driver = _driver(cell)
    if not isinstance(driver, UrDriver):
        raise typer.Exit(EXIT_CONFIG)
    failure = _do(lambda: _pass_gate(driver))
    table = Table("check", "verdict", "measured", "what to do")
    for line in driver.checks:
        table.add_row(line.name, line.verdict, line.measured, line.remedy)
    if driver.checks:
        Console(soft_wrap=True).print(table)
    if failure is not None:
        typer.echo(failure, err=True)
    if failure is not None or any(line.verdict is not gate.Verdict.PASSED for line in driver.checks):
        raise typer.Exit(EXIT_FAILED)


@ur_app.command()
def power_on(config: ConfigPath = None) -> None:
    """Switch the arm on and release its brakes; the arm moves by millimetres as they open."""
    ur = _ur_of(_load(config))
    _do(lambda: recovery.power_on(ur))
    typer.echo("the arm is on and holds itself")


@ur_app.command()
def power_off(config: ConfigPath = None) -> None:
    """Switch the arm off; its brakes close."""
    ur = _ur_of(_load(config))
    _do(lambda: recovery.power_off(ur))
    typer.echo("the arm is off")


@ur_app.command()
def unlock(config: ConfigPath = None) -> None:
    """Leave a protective stop whose cause you have inspected. The controller refuses this within the first 5 s."""
    ur = _ur_of(_load(config))
    _do(lambda: recovery.unlock(ur))
    typer.echo("the protective stop is left; no program runs")


class GripperAction(StrEnum):
    """Action of the gripper that an operator may ask for."""

    STATUS = "status"
    ACTIVATE = "activate"
    OPEN = "open"
    CLOSE = "close"


@ur_app.command()
def gripper(action: GripperAction, config: ConfigPath = None) -> None:
    """Ask a Robotiq gripper for its state, or move its fingers. Opening and activating drop the object."""
    ur = _ur_of(_load(config))
    status = _do(lambda: _ask_gripper(Gripper(ur.host, ur.gripper_port), action))
    state = "active" if status.is_active else "not activated"
    held = "holds something" if status.holds_object else "holds nothing"
    typer.echo(f"{state}, {held}, {status.opening_mm:.1f} mm open, fault {status.fault}")


async def _ask_gripper(fingers: Gripper, action: GripperAction) -> Status:
    async with fingers:
        match action:
            case GripperAction.STATUS:
                return await fingers.status()
            case GripperAction.ACTIVATE:
                return await fingers.activate()
            case GripperAction.OPEN:
                return await fingers.open()
            case GripperAction.CLOSE:
                return await fingers.close()


class _Onlooker:
    """Ignores a driver's samples."""

    def on_sample(self, sample: Sample) -> None:
        """Ignore the sample."""

    def on_link_fault(self, code: FaultCode, text: str) -> None:
        """Ignore the fault: the gate's checks say more."""


async def _pass_gate(driver: UrDriver) -> str | None:
    try:
        await driver.connect(_Onlooker())
    except DriverError as error:
        return str(error)
    finally:
        await driver.close()
    return None


def _load(path: Path | None) -> CellConfig:
    structlog.configure(logger_factory=structlog.PrintLoggerFactory(sys.stderr))
    try:
        return load(path)
    except ConfigError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(EXIT_CONFIG) from error


def _ur_of(cell: CellConfig) -> UrSection:
    if cell.ur is None or cell.cell.driver != "ur":
        typer.echo('this cell has no UR arm: set cell.driver = "ur" and describe it under [ur]', err=True)
        raise typer.Exit(EXIT_CONFIG)
    return cell.ur


def _driver(cell: CellConfig) -> Driver:
    """Make the driver that the configuration names; it opens nothing until it is connected."""
    sim, view = cell.sim, cell.camera
    if cell.ur is None or cell.cell.driver != "ur":
        return ZenohSimDriver(sim.world, [sim.endpoint], sim.mode)
    camera = None if view is None else ZenohCamera(view.endpoint, view.key, view.max_age_s, time.monotonic)
    world_setup = ZenohWorldSetup(sim.world, [sim.endpoint]) if cell.ur.simulated else None
    try:
        return UrDriver(cell, camera=camera, world_setup=world_setup)
    except ProgramError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(EXIT_CONFIG) from error


def _world(cell: CellConfig) -> AbstractContextManager[object]:
    """Start the driver's simulator where the configuration asks for it."""
    arguments, ur = cell.simulator_arguments, cell.ur
    if arguments is None or not cell.sim.autostart:
        return nullcontext()
    robot = [f"tcp/{ur.host}:{ur.rtde_port}"] if ur is not None and cell.cell.driver == "ur" else []
    return simulator(arguments, [*robot, cell.sim.endpoint])


def _do(errand: Callable[[], Coroutine[Any, Any, T]]) -> T:
    """Run an operator's errand; print the error and end the command where it fails."""
    try:
        return asyncio.run(errand())
    except (DashboardError, GripperError, OSError) as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(EXIT_FAILED) from error


if __name__ == "__main__":
    app()
