"""Lays out the world of a simulated arm that speaks a real arm's protocol, which has no command for this."""

import asyncio
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import structlog
import zenoh

from service.drivers.base import DriverError
from service.drivers.sim_wire import check_task
from service.drivers.world_hold import WorldHold
from service.faults import FaultCode
from wire import keys, records
from wire.session import QueryRefusedError, close_session, open_session, query
from wire.task import Task
from wire.tls import Certificates

LAY_OUT_S = 30.0
"""Host time for a simulator to lay out, and perhaps to compile, a world, s."""
CONNECT_S = 2.0
"""Time in which a simulator must be reached, s."""
POLL_S = 0.05

_log = structlog.get_logger("service.drivers")


@dataclass(frozen=True, slots=True)
class LaidOut:
    """A world that was laid out.

    Attributes:
        episode: number of layouts since the simulator's process started.
        time_s: time of the layout by the arm's clock; newer samples show the new world.
    """

    episode: int
    time_s: float


class WorldSetup(Protocol):
    """Lays out the arm's world; a real arm has none."""

    async def open(self) -> None:
        """Connect to the world; may be called again.

        Raises:
            OSError: the world cannot be reached.
            DriverError: another cell holds the world.
        """
        ...

    async def lay_out(self, task: Task | None) -> LaidOut:
        """Lay out the world that a run wants.

        Raises:
            DriverError: the world cannot be laid out.
        """
        ...

    async def close(self) -> None:
        """Release the connection."""
        ...


class ZenohWorldSetup:
    """Lays out an emulated controller's world with the query of a simulated cell (`docs/reference/wire.md`).

    Args:
        world: name of the world in its keys.
        connect: endpoints of its server.
        cell: id of the cell that claims the world; empty for a program without one.
        certificates: of this process, for a `tls/` or `quic/` endpoint.
    """

    def __init__(
        self, world: str, connect: Sequence[str], cell: str = "", certificates: Certificates | None = None
    ) -> None:
        self._certificates = certificates
        self._name = f"simulated world sim/{world} at {', '.join(connect)}"
        self._connect = tuple(connect)
        self._session: zenoh.Session | None = None
        self._hold = WorldHold(world, self._name, cell)
        self._holding: asyncio.Task[None] | None = None

    async def open(self) -> None:
        if self._session is None:
            self._session = await asyncio.to_thread(open_session, (), self._connect, self._certificates)
        await self._claim(self._session)
        if self._holding is None or self._holding.done():
            self._holding = asyncio.create_task(self._keep_hold(self._session), name="hold")

    async def lay_out(self, task: Task | None) -> LaidOut:
        payload = json.dumps(check_task(task).to_json()).encode()
        if self._session is None:
            raise DriverError(FaultCode.LINK, f"{self._name}: not connected")
        try:
            replies = await query(self._session, self._hold.signed(keys.RESET), payload, LAY_OUT_S)
        except QueryRefusedError as error:
            raise DriverError(FaultCode.PROTOCOL, f"{self._name} refused: {error}") from error
        if len(replies) != 1:
            text = f"{self._name}: {len(replies)} worlds answered, want one; is the emulated controller running?"
            raise DriverError(FaultCode.LINK if not replies else FaultCode.SOURCE, text)
        try:
            row = records.decode(replies[0], records.CAMERA)[0]
        except records.WireError as error:
            raise DriverError(FaultCode.PROTOCOL, f"{self._name}: {error}") from error
        return LaidOut(episode=int(row["episode"]), time_s=float(row["time_s"]))

    async def close(self) -> None:
        holding, self._holding = self._holding, None
        if holding is not None:
            holding.cancel()
            await asyncio.gather(holding, return_exceptions=True)
        session, self._session = self._session, None
        if session is not None:
            await self._hold.release(session)
            await asyncio.to_thread(close_session, session)

    async def _claim(self, session: zenoh.Session) -> None:
        # A session that is just connecting reaches nobody at once, so a silence is worth asking again.
        loop = asyncio.get_running_loop()
        deadline = loop.time() + CONNECT_S
        while True:
            try:
                await self._hold.claim(session)
            except DriverError as error:
                if error.code is not FaultCode.LINK or loop.time() >= deadline:
                    raise
                await asyncio.sleep(POLL_S)
            else:
                return

    async def _keep_hold(self, session: zenoh.Session) -> None:
        try:
            await self._hold.keep(session, lambda count: _log.warning("refused", world=self._name, commands=count))
        except DriverError as error:  # the next layout says so, too
            _log.error("world lost", error=str(error))
