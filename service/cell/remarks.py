"""Journal lines about what had no effect: a few at once, a flood thinned out, so that nobody can fill the disk."""

from collections.abc import Callable

BURST = 10
"""Lines that are written at once."""
PERIOD_S = 10.0
"""Time after which one more line is written, s."""


class Remarks:
    """Writes lines, at most `BURST` at once and one per `PERIOD_S` after that. A line says how many were left out.

    Args:
        tell: writes a line to the journal.
        clock: monotonic seconds.
    """

    def __init__(self, tell: Callable[[str], None], clock: Callable[[], float]) -> None:
        self._tell = tell
        self._clock = clock
        self._room = float(BURST)
        self._counted_at = clock()
        self._left_out = 0

    def note(self, text: str) -> None:
        """Write a line, or count it."""
        now = self._clock()
        self._room = min(float(BURST), self._room + (now - self._counted_at) / PERIOD_S)
        self._counted_at = now
        if self._room < 1.0:
            self._left_out += 1
            return
        self._room -= 1.0
        more = f"; {self._left_out} more before it" if self._left_out else ""
        self._left_out = 0
        self._tell(text + more)
