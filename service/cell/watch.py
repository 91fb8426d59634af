"""The two tasks that attend a cell: one keeps the driver connected, one watches while no sample comes."""

import asyncio

import structlog

from service.cell.cell import Cell
from service.cell.states import WITH_RUN
from service.drivers.base import DriverError
from service.faults import FaultCode
from service.messages import CellState

RECONNECT_S = 0.5
PERIOD_S = 0.005
OVERRUN_S = 0.02
"""Lateness of one turn of the watch that counts as an overrun."""
OVERRUNS_IN_A_ROW = 5

_log = structlog.get_logger("service.cell")


async def keep_linked(cell: Cell) -> None:
    """Connect, and connect again whenever the link is lost, until cancelled. A run is never resumed."""
    while True:
        await cell.unlinked.wait()
        if cell.state is CellState.OFFLINE:
            cell.enter(CellState.CONNECTING)
        try:
            await cell.driver.connect(cell)
        except (DriverError, OSError) as error:
            cell.lose_link(str(error))
            await asyncio.sleep(RECONNECT_S)
        except Exception as error:  # a defect must not leave the cell unlinked for good
            _log.exception("connect")
            cell.lose_link(f"{type(error).__name__}: {error}")
            await asyncio.sleep(RECONNECT_S)
        else:
            cell.linked()
            await asyncio.sleep(RECONNECT_S)  # a link that breaks at once is not tried without pause


async def keep_watch(cell: Cell) -> None:
    """Check for silence and lateness in real time. In lockstep no time passes without samples, so this returns."""
    if cell.driver.mode == "lockstep":
        return
    in_a_row = 0
    before = cell.driver.clock()
    well = True
    while True:
        await asyncio.sleep(PERIOD_S)
        now = cell.driver.clock()
        late = now - before - PERIOD_S > OVERRUN_S
        in_a_row = in_a_row + 1 if late else 0
        cell.overruns += late
        before = now
        if in_a_row >= OVERRUNS_IN_A_ROW and cell.state in WITH_RUN:
            cell.halt(FaultCode.OVERRUN, f"the control loop was more than {OVERRUN_S * 1e3:g} ms late {in_a_row} times")
        try:
            cell.watch()
        except Exception as error:
            cell.driver.stop()
            cell.halt(FaultCode.INTERNAL, f"{type(error).__name__} in the watch: {error}")
            if well:  # once, not two hundred times a second
                _log.exception("watch")
            well = False
        else:
            well = True
