"""The two tasks that attend a cell: one keeps the driver connected, one watches while no sample comes."""

import asyncio
from collections.abc import Callable, Sequence

import structlog

from service.cell.cell import Cell
from service.cell.states import WITH_RUN
from service.drivers.base import DriverError
from service.faults import FaultCode
from service.messages import CellState
from wire.modes import RESTING_PERIOD_S

RECONNECT_S = 0.5
PERIOD_S = 0.005
"""Time from one turn of the watch to the next while a run or a stop is under way, s."""
OVERRUNS_IN_A_ROW = 5
"""Overruns without an ordinary turn between them at which a run is latched."""

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


async def keep_watch(cell: Cell, beats: Sequence[Callable[[], None]] = ()) -> None:
    """Check for silence and lateness in real time. In lockstep no time passes without samples, so this returns.

    Args:
        cell: to watch.
        beats: called in every turn; whoever waits for them learns that the loop turns. They neither block nor raise.
    """
    if cell.driver.mode == "lockstep":
        return
    before = cell.driver.clock()
    well = True
    while True:
        # At rest as often as a resting world speaks
        period_s = PERIOD_S if cell.state in WITH_RUN or cell.state is CellState.STOPPING else RESTING_PERIOD_S
        await asyncio.sleep(period_s)
        now = cell.driver.clock()
        cell.lateness.note(now - before - period_s)
        before = now
        _judge_lateness(cell)
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
        for beat in beats:
            beat()


def _judge_lateness(cell: Cell) -> None:
    lateness = cell.lateness
    if lateness.in_a_row >= OVERRUNS_IN_A_ROW and cell.state in WITH_RUN:
        limit_ms = lateness.limit_s * 1e3
        text = f"the control loop was more than {limit_ms:g} ms late {lateness.in_a_row} times in a row"
        cell.halt(FaultCode.OVERRUN, text)
