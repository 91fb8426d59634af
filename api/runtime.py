"""What the handlers need, made at start-up and handed to them by the framework."""

import asyncio
from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Request

from api.cell import Cell
from api.models import CellStatus
from api.processes import CellProcesses
from service.config import CellConfig


@dataclass(frozen=True, slots=True)
class Runtime:
    """One running API.

    Attributes:
        config: of the cell, as read at start-up.
        cell: the followed cell.
        processes: what was started beside this server.
        closing: set when the server was told to end; streams return then.
    """

    config: CellConfig
    cell: Cell
    processes: CellProcesses
    closing: asyncio.Event

    def status(self) -> CellStatus:
        return CellStatus.now(self.config.cell.id, self.cell.client, self.processes.note)


def runtime_of(request: Request) -> Runtime:
    runtime: Runtime = request.app.state.runtime
    return runtime


RuntimeDependency = Annotated[Runtime, Depends(runtime_of)]
