"""The one client that may command a simulated world. It holds the world until it leaves it or falls silent."""

import json
import secrets
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from sim_backend.requests import RequestError, read_object, read_parameters
from wire.records import Kind

LEASE_S = 2.0
"""Silence after which another client may take the world over, s."""
SIGNED = ("client", "seq")
"""Parameters of a request that only the holder may make."""
SIGNATURE = "client=… of the claim and seq=… above every earlier one"
_TEXT_LENGTH = 64


@dataclass(frozen=True, slots=True)
class Holder:
    """Client that holds a world, as it describes itself.

    Attributes:
        cell: id of its cell.
        host: its machine.
        pid: its process there.
    """

    cell: str
    host: str
    pid: int

    def __str__(self) -> str:
        return f"cell {self.cell!r}, process {self.pid} on {self.host}"


class Holding:
    """Admits the commands and requests of the holder alone, each of them once.

    A claim draws a word at random that only the claimant is told. Commands carry it as their `client`, requests as a
    parameter, both with a `seq` above every earlier one of their kind.

    Args:
        clock: monotonic seconds.

    Attributes:
        holder: who holds the world; None where nobody does.
        number: how many claims were granted; it names the holder in published states, which must not have the word.
        refused: commands and requests, since the start, that were not the holder's or were copies.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._word = self._brake = 0
        self._heard_at = 0.0
        self._command_seq = self._request_seq = self._brake_seq = 0
        self.holder: Holder | None = None
        self.number = 0
        self.refused = 0

    def claim(self, parameters: str, payload: bytes) -> bytes:
        """Grant the world to a client that asks for it, or renew the holder's claim.

        Args:
            parameters: `client=…`, the word of an earlier claim, to renew that one.
            payload: JSON object `{"cell": …, "host": …, "pid": …, "brake": …}`. Stops under the word `brake` are
                obeyed as well: the claimant's watchdog, a process of its own, has it.

        Returns:
            JSON object with the word, `client`, and with `refused`.

        Raises:
            RequestError: another client holds the world, or the claim cannot be read.
        """
        claimant, brake = _read_claim(payload)
        word = _whole(read_parameters(parameters, "client=… of an earlier claim, or none", "client"), "client")
        if not self._is_held_by(word):
            if self.is_held and self.holder is not None:
                heard_s = self._clock() - self._heard_at
                raise RequestError(
                    f"claim: this world is held by {self.holder}, heard {heard_s:.1f} s ago: "
                    "end it, or give this cell a simulator of its own (sim.endpoint)"
                )
            self._word = secrets.randbits(63) | 1
            self._command_seq = self._request_seq = self._brake_seq = 0
            self.holder, self._brake = claimant, brake
            self.number += 1
        self._heard_at = self._clock()
        return json.dumps({"client": self._word, "refused": self.refused}).encode()

    def release(self, parameters: str) -> None:
        """End the holder's claim.

        Raises:
            RequestError: as `check`.
        """
        self.check(read_parameters(parameters, SIGNATURE, *SIGNED), "release")
        self.holder, self._word, self._brake = None, 0, 0

    def check(self, parameters: Mapping[str, str], request: str) -> None:
        """Check that a request is the holder's and new.

        Args:
            parameters: `client` and `seq`.
            request: name of the request, for the error.

        Raises:
            RequestError: it is not.
        """
        seq = _whole(parameters, "seq")
        if not self._is_held_by(_whole(parameters, "client")):
            self.refused += 1
            held = "nobody holds this world" if self.holder is None else f"this world is held by {self.holder}"
            raise RequestError(f"{request}: {held}; claim it, then say {SIGNATURE}")
        if seq <= self._request_seq:
            self.refused += 1
            raise RequestError(f"{request}: seq {seq} is not above {self._request_seq}: a copy of an earlier request")
        self._request_seq = seq
        self._heard_at = self._clock()

    def admits(self, command: Any) -> bool:
        """Return whether a command is the holder's and new. A stop is anyone's while no holder is heard.

        Args:
            command: one record of `records.COMMAND`.
        """
        client, seq = int(command["client"]), int(command["seq"])
        if command["kind"] == Kind.STOP and self._brake and client == self._brake:
            if seq > self._brake_seq:
                self._brake_seq = seq
                return True
        elif self._is_held_by(client):
            if seq > self._command_seq:
                self._command_seq = seq
                self._heard_at = self._clock()
                return True
        elif command["kind"] == Kind.STOP and not self.is_held:
            return True
        self.refused += 1
        return False

    @property
    def is_held(self) -> bool:
        """True while there is a holder that was heard within `LEASE_S`."""
        return self.holder is not None and self._clock() - self._heard_at <= LEASE_S

    def described(self) -> dict[str, Any] | None:
        """Return the holder as JSON; None where nobody holds the world."""
        return None if self.holder is None else asdict(self.holder)

    def _is_held_by(self, word: int) -> bool:
        return self._word != 0 and word == self._word


def _whole(parameters: Mapping[str, str], name: str) -> int:
    value = parameters.get(name, "")
    return int(value) if value.isascii() and value.isdigit() and len(value) <= 19 else 0


def _read_claim(payload: bytes) -> tuple[Holder, int]:
    document = read_object(payload, "claim")
    cell, host, pid, brake = (document.pop(name, 0) for name in ("cell", "host", "pid", "brake"))
    if document or not (isinstance(cell, str) and isinstance(host, str) and isinstance(pid, int)):
        raise RequestError('claim: the payload must be {"cell": text, "host": text, "pid": number}')
    if not isinstance(brake, int) or not 0 <= brake < 2**63:
        raise RequestError("claim: brake is a number below 2**63, or left out")
    if max(len(cell), len(host)) > _TEXT_LENGTH or not (cell + host).isprintable():
        raise RequestError(f"claim: cell and host are printable, at most {_TEXT_LENGTH} characters each")
    return Holder(cell, host, pid), brake
