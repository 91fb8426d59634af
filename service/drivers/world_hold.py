"""The claim of one cell on a simulated world, which takes commands of its holder alone (`docs/reference/wire.md`)."""

import asyncio
import contextlib
import json
import os
import socket
from collections.abc import Callable

import zenoh

from service.drivers.base import DriverError
from service.drivers.sim_wire import BRAKE_WORD
from service.faults import FaultCode
from service.program import PROGRAM
from wire import keys
from wire.session import QueryRefusedError, query

RENEW_S = 0.5
"""Period of renewal, s; the world takes a holder for gone after 2 s of silence."""
ANSWER_S = 2.0
"""Host time for the world's answer, s."""
RELEASE_S = 0.2
"""The same for a release, which need not succeed: the claim ends by itself, s."""


class WorldHold:
    """Claims a world, renews the claim and releases it.

    Args:
        world: name of the world in its keys.
        name: of the world, for people.
        cell: id of the cell that claims it; empty for a program without one.

    Attributes:
        claimant: payload of a claim.
        word: word of the claim in force, which signs commands; 0 without one.
    """

    def __init__(self, world: str, name: str, cell: str) -> None:
        self._world = world
        self._name = name
        who = {"cell": cell, "host": socket.gethostname()[:64], "pid": os.getpid(), "brake": BRAKE_WORD}
        self.claimant = json.dumps(who).encode()
        self._seq = 0
        self._refused = 0
        self.word = 0

    async def claim(self, session: zenoh.Session) -> int:
        """Claim the world, or renew the claim.

        Returns:
            How many commands of others the world has refused since the last call.

        Raises:
            DriverError: AUTHORITY: another client holds the world; the text names it. LINK: nobody answers. PROTOCOL:
                the answer cannot be read.
        """
        try:
            replies = await query(session, self.selector, self.claimant, ANSWER_S)
        except QueryRefusedError as error:
            raise DriverError(FaultCode.AUTHORITY, f"{self._name} refused: {error}") from error
        if not replies:
            raise DriverError(FaultCode.LINK, f"{self._name} does not answer: is `{PROGRAM} sim serve` running?")
        return self.granted(replies[0])

    async def keep(self, session: zenoh.Session, on_refused: Callable[[int], object]) -> None:
        """Renew the claim until cancelled.

        Args:
            session: open session.
            on_refused: told how many commands of others were refused, where some were.

        Raises:
            DriverError: AUTHORITY: another client has taken the world over.
        """
        while True:
            await asyncio.sleep(RENEW_S)
            try:
                if refused := await self.claim(session):
                    on_refused(refused)
            except DriverError as error:
                if error.code is FaultCode.AUTHORITY:
                    raise

    async def release(self, session: zenoh.Session) -> None:
        """Give the world up, if it is held and answers."""
        if self.word:
            with contextlib.suppress(QueryRefusedError):  # another client has taken it over
                await query(session, self.signed(keys.RELEASE), b"", RELEASE_S)
            self.word = 0

    @property
    def selector(self) -> str:
        """Selector of a claim, or of its renewal."""
        return f"{keys.CLAIM.format(world=self._world)}?client={self.word}"

    def granted(self, reply: bytes) -> int:
        """Take the answer to a claim in.

        Returns:
            How many commands of others the world has refused since the last answer to this claim.

        Raises:
            DriverError: PROTOCOL: it cannot be read.
        """
        try:
            answer = json.loads(reply)
            word, refused = int(answer["client"]), int(answer["refused"])
        except (ValueError, KeyError, TypeError) as error:
            text = f"{self._name}: its answer to a claim cannot be read: {error}"
            raise DriverError(FaultCode.PROTOCOL, text) from error
        since = refused - self._refused if word == self.word else 0
        self.word, self._refused = word, refused
        return since

    def signed(self, key: str, *parameters: str) -> str:
        """Return the selector of a request that is good for one use.

        Args:
            key: pattern of `wire.keys`.
            *parameters: further parameters, `name=value`.
        """
        self._seq += 1
        return f"{key.format(world=self._world)}?" + ";".join((*parameters, f"client={self.word}", f"seq={self._seq}"))
