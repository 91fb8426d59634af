"""`control`: the control process of one cell, with its simulator where the configuration asks for one."""

import asyncio
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import assert_never

import typer

from service.cell.alone import alone
from service.commands.configured import ConfigPath, load_cell, ur_section
from service.config import CellConfig
from service.drivers.sim_process import Simulator, simulator
from service.logs import take_over_stderr
from wire.exits import Exit
from wire.tls import is_encrypted


def control(config: ConfigPath = None) -> None:
    """Run the control process of a cell until SIGTERM, Ctrl-C or the end of the terminal."""
    cell = load_cell(config)
    take_over_stderr()
    try:
        with alone(cell.cell.state_dir), _world(cell) as world:
            _run(cell, world)
    except OSError as error:
        typer.echo(f"the control process cannot run: {error}", err=True)
        raise typer.Exit(Exit.HOST) from error


def _world(cell: CellConfig) -> AbstractContextManager[Simulator]:
    """Start the driver's simulator where the configuration asks for it."""
    if not cell.sim.autostart or (process := _simulator_of(cell)) is None:
        return nullcontext(Simulator())
    arguments, endpoints = process
    return simulator(arguments, endpoints, cell.cell.state_dir / "logs" / "simulator.log")


def _simulator_of(cell: CellConfig) -> tuple[Sequence[str], Sequence[str]] | None:
    """Return the simulator's arguments and the endpoints at which it listens; None for a real arm."""
    sim = cell.sim
    realtime = ("--realtime",) if cell.asks_realtime else ()
    world = ("--world", sim.world, "--listen", sim.endpoint, *realtime, *_security(cell))
    match cell.cell.driver:
        case "zenoh_sim":
            return ("sim", "serve", "--mode", sim.mode.replace("_", "-"), *world), (sim.endpoint,)
        case "ur":
            ur = ur_section(cell)
            if not ur.simulated:
                return None
            return ("sim", "ur-controller", "--host", ur.host, *world), (f"tcp/{ur.host}:{ur.rtde_port}", sim.endpoint)
        case _ as never:
            assert_never(never)


def _security(cell: CellConfig) -> Sequence[str]:
    """Return the simulator's options for an encrypted endpoint."""
    tls = cell.tls
    if tls is None or not is_encrypted(cell.sim.endpoint):
        return ()
    files = ("--authority", str(tls.authority), "--certificate", str(tls.certificate), "--key", str(tls.key))
    names = (("--commander", tls.commanders), ("--reader", tls.readers))
    return (*files, *(word for option, values in names for value in values for word in (option, value)))


def _run(cell: CellConfig, world: Simulator) -> None:
    # Loaded while the simulator starts.
    import uvloop

    from service.cell import process
    from service.commands.drivers import brake_of, make_driver
    from service.drivers.ur import weighed

    driver = make_driver(cell)

    async def run() -> None:
        watch = asyncio.create_task(world.watch(), name="simulator")
        try:
            await process.run(cell, driver, brake_of(cell), world.listens, weighed.remarks(cell))
        finally:
            watch.cancel()

    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(run())
