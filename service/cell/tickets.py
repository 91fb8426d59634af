"""Tickets of the clients of one cell: each number under a ticket is good for one use."""

import enum
import secrets
from collections.abc import Callable
from dataclasses import dataclass

from service.envelope import TICKET_IDLE_S

MAX_TICKETS = 256
WINDOW = 256
"""Numbers below a ticket's highest that are still told apart; older ones count as used."""


class Use(enum.Enum):
    """Judgement of one ticket and number."""

    FRESH = enum.auto()
    SPENT = enum.auto()
    """The number was used before, or is older than `WINDOW`."""
    UNKNOWN = enum.auto()
    """No such ticket: of an earlier process, withdrawn, or made up."""
    FORGED = enum.auto()
    """The ticket was drawn for another sender."""


@dataclass(slots=True)
class _Drawn:
    sender: str
    used_at: float
    highest: int = 0
    used: int = 0
    """Bit i is set where the number `highest - i` was used."""


class Tickets:
    """Draws tickets and judges their use. A full book draws none until one has been idle for `TICKET_IDLE_S`.

    Args:
        clock: monotonic seconds.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._drawn: dict[str, _Drawn] = {}

    def draw(self, sender: str) -> str | None:
        """Draw a ticket for a sender; None while too many are in use."""
        now = self._clock()
        self._drawn = {word: drawn for word, drawn in self._drawn.items() if now - drawn.used_at < TICKET_IDLE_S}
        if len(self._drawn) >= MAX_TICKETS:
            return None
        word = secrets.token_hex(16)
        self._drawn[word] = _Drawn(sender, now)
        return word

    def use(self, word: str, sender: str, number: int) -> Use:
        """Judge a number and count it as used; the sliding window is that of RFC 4303, section 3.4.3."""
        drawn = self._drawn.get(word)
        if drawn is None:
            return Use.UNKNOWN
        if drawn.sender != sender:
            return Use.FORGED
        ahead = number - drawn.highest
        if ahead > 0:
            drawn.used = 1 if ahead >= WINDOW else ((drawn.used << ahead) | 1) & ((1 << WINDOW) - 1)
            drawn.highest = number
        elif -ahead >= WINDOW or drawn.used >> -ahead & 1:
            return Use.SPENT
        else:
            drawn.used |= 1 << -ahead
        drawn.used_at = self._clock()
        return Use.FRESH
