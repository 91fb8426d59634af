"""The driver of the configured cell, and the brake of its watchdog."""

import time
from typing import assert_never

import typer

from service.commands.configured import ur_section
from service.config import CellConfig
from service.drivers.base import Driver
from wire.exits import Exit


def make_driver(cell: CellConfig) -> Driver:
    """Make the driver that the configuration names; it opens nothing until it is connected. No other is loaded."""
    match cell.cell.driver:
        case "zenoh_sim":
            from service.drivers.zenoh_sim import ZenohSimDriver

            return ZenohSimDriver(
                cell.sim.world, [cell.sim.endpoint], cell.sim.mode, cell=cell.cell.id, certificates=cell.certificates
            )
        case "ur":
            return _make_ur_driver(cell)
        case _ as never:
            assert_never(never)


def brake_of(config: CellConfig) -> tuple[str, ...]:
    """Return the arguments that name the brake of a cell's arm."""
    match config.cell.driver:
        case "zenoh_sim":
            files = config.certificates
            names = () if files is None else (str(files.authority), str(files.certificate), str(files.key))
            return "zenoh", config.sim.world, config.sim.endpoint, *names
        case "ur":
            return () if config.ur is None else ("dashboard", config.ur.host, str(config.ur.dashboard_port))
        case _ as never:
            assert_never(never)


def _make_ur_driver(cell: CellConfig) -> Driver:
    from service.drivers.camera import ZenohCamera
    from service.drivers.ur.driver import UrDriver
    from service.drivers.ur.program import ProgramError
    from service.drivers.world_setup import ZenohWorldSetup

    sim, view, certificates = cell.sim, cell.camera, cell.certificates
    camera = (
        None if view is None else ZenohCamera(view.endpoint, view.key, view.max_age_s, time.monotonic, certificates)
    )
    simulated = ur_section(cell).simulated
    world_setup = ZenohWorldSetup(sim.world, [sim.endpoint], cell.cell.id, certificates) if simulated else None
    try:
        return UrDriver(cell, camera=camera, world_setup=world_setup)
    except ProgramError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(Exit.USAGE) from error
