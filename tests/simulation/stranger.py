"""Somebody on the network: reads by wildcards, sends empty commands, repeats what others sent, stops the arm."""

from typing import TYPE_CHECKING, Any

import zenoh

from service import messages
from service.drivers.sim_wire import CommandWriter
from tests.simulation.clock import Process
from wire import keys

if TYPE_CHECKING:
    from tests.simulation.network import Network

COMMANDS = {"start": messages.START, "stop": messages.STOP, "reset": messages.RESET}


class Stranger:
    """A client that has no business here.

    Args:
        network: of the universe.
        cell: id of the cell.
        world: name of the world.
        endpoints: of everything that it can reach.
    """

    def __init__(self, network: "Network", cell: str, world: str, endpoints: frozenset[str]) -> None:
        process = Process(network.loop, "stranger")
        self._network, self._cell, self._world = network, cell, world
        self._session: Any = process.main.context.copy().run(network.open, endpoints)

    def read(self, key: str) -> None:
        """Send an empty query to every key that matches."""
        self._ask(key, None)

    def empty(self, command: str) -> None:
        """Send a command without content."""
        self._ask(COMMANDS[command].format(cell=self._cell), b"")

    def repeat(self, command: str) -> None:
        """Send the newest command of a kind again, byte for byte, as somebody does who has recorded it."""
        key = COMMANDS[command].format(cell=self._cell)
        heard = [payload for named, payload in self._network.heard if named == key]
        if heard:
            self._ask(key, heard[-1])

    def drive(self) -> None:
        """Stop the arm, as the cell of another arm does that is configured for this world."""
        self._session.put(keys.COMMAND.format(world=self._world), CommandWriter().stop().tobytes())

    def _ask(self, key: str, payload: bytes | None) -> None:
        handler = zenoh.handlers.Callback(lambda _reply: None, lambda: None)
        self._session.get(key, handler, payload=payload, timeout=1.0)
