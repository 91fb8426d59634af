"""The end of tasks: a cancellation is repeated until it is obeyed."""

import asyncio
from collections.abc import Iterable
from typing import Any

AGAIN_S = 0.1


async def end_tasks(tasks: Iterable[asyncio.Task[Any]], within_s: float) -> set[asyncio.Task[Any]]:
    """Cancel tasks and wait until they have ended, but no longer than `within_s`.

    A cancellation can be lost: `asyncio.wait_for` of Python 3.11, which libraries use, returns the result instead where
    both come in one turn of the loop. The task then goes on and must be cancelled again.

    Returns:
        Those that go on.
    """
    loop = asyncio.get_running_loop()
    deadline = loop.time() + within_s
    pending = {task for task in tasks if not task.done()}
    while pending and loop.time() < deadline:
        for task in pending:
            task.cancel()
        _, pending = await asyncio.wait(pending, timeout=AGAIN_S)
    return pending
