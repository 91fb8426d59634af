"""The driver of the configured cell."""

import time

import typer

from service.commands.configured import EXIT_CONFIG
from service.config import CellConfig
from service.drivers.base import Driver
from service.drivers.camera import ZenohCamera
from service.drivers.ur.driver import UrDriver
from service.drivers.ur.program import ProgramError
from service.drivers.world_setup import ZenohWorldSetup
from service.drivers.zenoh_sim import ZenohSimDriver


def make_driver(cell: CellConfig) -> Driver:
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
