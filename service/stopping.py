"""A stop as a client gives it: delivered, and then reported complete only after standstill is measured."""

import asyncio

from service.client import CellClient, CellSilentError
from service.messages import CellState, Status, StopRequest

DELIVERY_S = 1.0
"""Time during which a stop is repeated to a control process that does not answer, s."""
CONFIRMATION_S = 1.0
"""Longest wait for a measured standstill, s."""
SAMPLE_AGE_S = 0.2
POLL_S = 0.02


async def deliver(stopper: CellClient, request: StopRequest, delivery_s: float = DELIVERY_S) -> Status:
    """Send a stop until the control process has it.

    Raises:
        CellSilentError: no answer in time.
    """
    # A session that is just connecting reaches nobody at once, so a silence is worth asking again.
    loop = asyncio.get_running_loop()
    deadline = loop.time() + delivery_s
    while True:
        try:
            return await stopper.stop(request, timeout_s=max(0.1, deadline - loop.time()))
        except CellSilentError:
            if loop.time() >= deadline:
                raise
            await asyncio.sleep(POLL_S)


async def confirm(stopper: CellClient, status: Status) -> Status:
    """Return the first status from `status` on that shows the arm standing, or the newest when time is up."""
    loop = asyncio.get_running_loop()
    deadline = loop.time() + CONFIRMATION_S
    while not is_standing(status) and loop.time() < deadline:
        await asyncio.sleep(POLL_S)
        newest = stopper.last_status
        if newest is not None and (newest.service_epoch != status.service_epoch or newest.seq > status.seq):
            status = newest
    return status


def is_standing(status: Status) -> bool:
    """Return whether the arm is measured standing in a state in which nothing is about to move it."""
    measured = status.measured
    return (
        status.state in {CellState.READY, CellState.LATCHED}
        and measured is not None
        and not measured.moving
        and measured.sample_age_s <= SAMPLE_AGE_S
    )
