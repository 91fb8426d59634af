"""`control`: the control process of one cell, with its simulator where the configuration asks for one."""

import asyncio
from contextlib import AbstractContextManager, nullcontext

import typer

from service.commands.configured import EXIT_HOST, ConfigPath, load_cell
from service.config import CellConfig
from service.drivers.sim_process import Simulator, simulator


def control(config: ConfigPath = None) -> None:
    """Run the control process of a cell until SIGTERM or Ctrl-C."""
    cell = load_cell(config)
    try:
        with _world(cell) as world:
            _run(cell, world)
    except OSError as error:
        typer.echo(f"the control process cannot run: {error}", err=True)
        raise typer.Exit(EXIT_HOST) from error


def _world(cell: CellConfig) -> AbstractContextManager[Simulator]:
    """Start the driver's simulator where the configuration asks for it."""
    arguments, ur = cell.simulator_arguments, cell.ur
    if arguments is None or not cell.sim.autostart:
        return nullcontext(Simulator())
    robot = [f"tcp/{ur.host}:{ur.rtde_port}"] if ur is not None and cell.cell.driver == "ur" else []
    return simulator(arguments, [*robot, cell.sim.endpoint], cell.cell.state_dir / "logs" / "simulator.log")


def _run(cell: CellConfig, world: Simulator) -> None:
    # Loaded while the simulator starts.
    import uvloop

    from service.cell import process
    from service.commands.drivers import make_driver

    driver = make_driver(cell)
    world.await_listening()

    async def run() -> None:
        watch = asyncio.create_task(world.watch(), name="simulator")
        try:
            await process.run(cell, driver)
        finally:
            watch.cancel()

    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(run())
