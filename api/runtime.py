"""Objects that the handlers share. They are made at start-up and injected by the framework."""

import asyncio
from collections.abc import Coroutine
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from fastapi import Depends, Request

from api.cell import FollowedCell
from api.control_process import ControlProcess
from api.models import CellStatus
from api.problems import ProblemError
from service.config import CellConfig

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Runtime:
    """One running API.

    Attributes:
        config: configuration of the cell, as read at start-up.
        cell: the followed cell.
        control_process: control process behind this server, started by the server or joined.
        closing: event that is set when the server is told to end; streams return then.
    """

    config: CellConfig
    cell: FollowedCell
    control_process: ControlProcess
    closing: asyncio.Event

    async def unless_closing(self, work: Coroutine[Any, Any, T]) -> T:
        """Await `work`, but no longer than until the server is told to end.

        Raises:
            ProblemError: the server ends; the outcome of `work` is not known.
        """
        task = asyncio.ensure_future(work)
        closing = asyncio.ensure_future(self.closing.wait())
        try:
            await asyncio.wait({task, closing}, return_when=asyncio.FIRST_COMPLETED)
            if task.done():
                return task.result()
        finally:
            task.cancel()
            closing.cancel()
        raise ProblemError(
            503,
            "SHUTTING_DOWN",
            "This server is shutting down. It is not known whether the request was carried out: see GET /status.",
        )

    def status(self) -> CellStatus:
        return CellStatus.now(self.config.cell.id, self.cell.client, self.control_process.note)


def runtime_of(request: Request) -> Runtime:
    runtime: Runtime = request.app.state.runtime
    return runtime


async def _injected(request: Request) -> Runtime:
    return runtime_of(request)  # FastAPI would run a function that is not asynchronous on a thread


RuntimeDependency = Annotated[Runtime, Depends(_injected)]
