"""What the handlers need, made at start-up and handed to them by the framework."""

import asyncio
from collections.abc import Coroutine
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from fastapi import Depends, Request

from api.cell import Cell
from api.control_process import ControlProcess
from api.models import CellStatus
from api.problems import ProblemError
from service.config import CellConfig

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Runtime:
    """One running API.

    Attributes:
        config: of the cell, as read at start-up.
        cell: the followed cell.
        control_process: the one behind this server, started by it or joined.
        closing: set when the server was told to end; streams return then.
    """

    config: CellConfig
    cell: Cell
    control_process: ControlProcess
    closing: asyncio.Event

    async def unless_closing(self, work: Coroutine[Any, Any, T]) -> T:
        """Await `work`, but not past the moment at which the server is told to end.

        Raises:
            ProblemError: the server ends; what became of `work` is not known.
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
            503, "SHUTTING_DOWN", "This server ends. Whether the request was carried out is not known: see GET /status."
        )

    def status(self) -> CellStatus:
        return CellStatus.now(self.config.cell.id, self.cell.client, self.control_process.note)


def runtime_of(request: Request) -> Runtime:
    runtime: Runtime = request.app.state.runtime
    return runtime


RuntimeDependency = Annotated[Runtime, Depends(runtime_of)]
