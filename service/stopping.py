"""A stop as a client gives it: delivered, and then reported complete only after standstill is measured."""

import asyncio
from dataclasses import dataclass

from service.client import CellClient, CellSilentError
from service.messages import CellState, Measured, Status, StopRequest

WITHIN_S = 0.9
"""Longest time from a stop to its answer, s: within a second at the client, the stop is confirmed or is not."""
SAMPLE_AGE_S = 0.2
SAMPLES_AFTER = 10
"""Samples from the last one before the stop to the first that confirms it: 20 ms of an arm at 500 Hz, so that a sample
which was on its way when the stop was carried out confirms nothing."""
POLL_S = 0.02


@dataclass(frozen=True, slots=True)
class Stopped:
    """Outcome of a stop that the control process has.

    Attributes:
        status: newest status of the cell.
        confirmed: the arm was measured standing by a sample that is newer than the stop.
    """

    status: Status
    confirmed: bool


async def deliver(stopper: CellClient, request: StopRequest, within_s: float = WITHIN_S) -> Status:
    """Send a stop until the control process has it; return the status with which it answered.

    Raises:
        CellSilentError: no answer within `within_s`.
    """
    # A session that is just connecting reaches nobody at once, so a silence is worth asking again.
    loop = asyncio.get_running_loop()
    deadline = loop.time() + within_s
    while True:
        try:
            return await stopper.stop(request, timeout_s=max(0.1, deadline - loop.time()))
        except CellSilentError:
            if loop.time() >= deadline:
                raise
            await asyncio.sleep(POLL_S)


async def confirm(stopper: CellClient, told: Status, within_s: float = WITHIN_S) -> Stopped:
    """Wait until standstill is measured after a stop, but no longer than `within_s`.

    Args:
        stopper: client that delivered the stop.
        told: status with which the control process answered the stop.
        within_s: longest wait, s.
    """
    loop = asyncio.get_running_loop()
    deadline = loop.time() + within_s
    newest = told
    while not (confirmed := _is_confirmed(told, newest)) and loop.time() < deadline:
        await asyncio.sleep(POLL_S)
        heard = stopper.last_status
        if heard is not None and (heard.service_epoch != newest.service_epoch or heard.seq > newest.seq):
            newest = heard
    return Stopped(newest, confirmed)


def _is_confirmed(told: Status, newest: Status) -> bool:
    """Return whether a status, `told` or a later one, shows the arm standing after the stop that `told` answered."""
    measured = newest.measured
    return measured is not None and is_standing(newest) and _is_after(told, newest, measured)


def _is_after(told: Status, newest: Status, measured: Measured) -> bool:
    # In lockstep no time passes between samples, so the last one is of this moment.
    if newest.mode == "lockstep" or told.measured is None or newest.service_epoch != told.service_epoch:
        return True
    # A link that was made anew counts its samples from the start.
    return not 0 <= measured.sample_seq - told.measured.sample_seq < SAMPLES_AFTER


def is_standing(status: Status) -> bool:
    """Return whether the arm is measured standing in a state in which nothing is about to move it."""
    measured = status.measured
    return (
        status.state in {CellState.READY, CellState.LATCHED}
        and measured is not None
        and not measured.moving
        and measured.sample_age_s <= SAMPLE_AGE_S
    )
