"""`ur …`: the operator's commands for a Universal Robots arm: the start-up gate, the weighing of the payload, power,
the release from a protective stop, and the gripper.
"""

import asyncio
import json
from collections.abc import Callable, Coroutine
from enum import StrEnum
from typing import Annotated, Any, TypeVar

import typer
from rich.console import Console
from rich.table import Table

from service.commands.configured import ConfigPath, load_cell, ur_section
from service.commands.drivers import make_driver
from service.commands.weighing import document, outcome, payload_line, tables, weigh
from service.drivers.base import DriverError, Load, Sample
from service.drivers.ur import gate, recovery, weighed
from service.drivers.ur.dashboard import DashboardError
from service.drivers.ur.driver import UrDriver
from service.drivers.ur.gripper import Gripper, GripperError, GripperStatus
from service.drivers.ur.weighing import scale_of
from service.faults import FaultCode
from wire.exits import Exit

T = TypeVar("T")

app = typer.Typer(
    add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False, help="Operate a Universal Robots arm."
)


@app.command()
def check(config: ConfigPath = None) -> None:
    """Pass the start-up gate once and print the measurements; the arm does not move. Stop the cell first."""
    cell = load_cell(config)
    ur_section(cell)
    driver = make_driver(cell)
    if not isinstance(driver, UrDriver):
        raise typer.Exit(Exit.USAGE)
    failure = _do(lambda: _pass_gate(driver))
    table = Table("check", "verdict", "measured", "what to do")
    for line in driver.checks:
        table.add_row(line.name, line.verdict, line.measured, line.remedy)
    if driver.checks:
        Console(soft_wrap=True).print(table)
    if failure is not None:
        typer.echo(failure, err=True)
    if failure is not None or any(line.verdict is not gate.Verdict.PASSED for line in driver.checks):
        raise typer.Exit(Exit.FAILED)


@app.command("weigh")
def weigh_payload(
    config: ConfigPath = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Prove signs, gains and axes of the force/torque sensor by the payload's weight at four attitudes or more.

    The operator moves the arm with the pendant; the command reads and does nothing else. It ends when every axis is
    proven: 0 if the sensor shows the configured payload, 1 with a sentence for each thing that is wrong.
    """
    cell = load_cell(config)
    ur = ur_section(cell)
    scale = scale_of(ur)
    if scale.is_too_light:
        typer.echo(
            f"the configured payload of {ur.payload_kg:g} kg weighs {scale.payload.weight_n:.1f} N, too little beside "
            f"an error of the sensor of {scale.limit_n:g} N: grip a heavier thing, and configure its mass and centre "
            "for the weighing",
            err=True,
        )
        raise typer.Exit(Exit.USAGE)
    _do(lambda: asyncio.to_thread(weighed.forget, cell))
    weighing = _do(lambda: weigh(ur, lambda line: typer.echo(line, err=True)))
    if as_json:
        typer.echo(json.dumps(document(weighing), indent=2))
    else:
        console = Console(soft_wrap=True)
        for table in tables(weighing):
            console.print(table)
        typer.echo(payload_line(weighing))
        for line in outcome(weighing):
            typer.echo(line)
    if not weighing.passed:
        raise typer.Exit(Exit.FAILED)
    _do(lambda: asyncio.to_thread(weighed.remember, cell))


@app.command()
def power_on(config: ConfigPath = None) -> None:
    """Switch the arm on and release its brakes; the arm moves by millimetres as they open."""
    ur = ur_section(load_cell(config))
    _do(lambda: recovery.power_on(ur))
    typer.echo("the arm is on and holds itself")


@app.command()
def power_off(config: ConfigPath = None) -> None:
    """Switch the arm off; its brakes close."""
    ur = ur_section(load_cell(config))
    _do(lambda: recovery.power_off(ur))
    typer.echo("the arm is off")


@app.command()
def unlock(config: ConfigPath = None) -> None:
    """Leave a protective stop whose cause you have inspected. The controller refuses this within the first 5 s."""
    ur = ur_section(load_cell(config))
    _do(lambda: recovery.unlock(ur))
    typer.echo("the protective stop is left; no program runs")


class GripperAction(StrEnum):
    """Action of the gripper that an operator may ask for."""

    STATUS = "status"
    ACTIVATE = "activate"
    OPEN = "open"
    CLOSE = "close"


@app.command()
def gripper(action: Annotated[GripperAction, typer.Argument(help="Ask, or move.")], config: ConfigPath = None) -> None:
    """Ask a Robotiq gripper for its state, or move its fingers. Opening and activating drop the object."""
    ur = ur_section(load_cell(config))
    status = _do(lambda: _ask_gripper(Gripper(ur.host, ur.gripper_port), action))
    state = "active" if status.is_active else "not activated"
    held = "holds something" if status.holds_object else "holds nothing"
    typer.echo(f"{state}, {held}, {status.opening_mm:.1f} mm open, fault {status.fault}")


async def _ask_gripper(fingers: Gripper, action: GripperAction) -> GripperStatus:
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

    def overloads(self, load: Load) -> bool:
        """Ask for no stop: no run is under way."""
        return False

    def on_sample(self, sample: Sample) -> None:
        """Ignore the sample."""

    def on_link_fault(self, code: FaultCode, text: str) -> None:
        """Ignore the fault: the gate's checks say more."""

    def on_notice(self, text: str) -> None:
        """Ignore the notice."""


async def _pass_gate(driver: UrDriver) -> str | None:
    try:
        await driver.connect(_Onlooker())
    except DriverError as error:
        return str(error)
    finally:
        await driver.close()
    return None


def _do(errand: Callable[[], Coroutine[Any, Any, T]]) -> T:
    """Run an operator's errand; print the error and end the command where it fails."""
    try:
        return asyncio.run(errand())
    except (DashboardError, DriverError, GripperError, OSError) as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(Exit.FAILED) from error
