"""Lateness of the control loop: how much later than asked its turns come."""

from collections import deque

import numpy as np

WINDOW = 2000
"""Newest turns that the percentile is taken over: 10 s in a run, 20 s at rest."""
RENEWAL = 100
"""Turns after which the percentile is taken anew; it costs a third of a millisecond."""


class Lateness:
    """Keeps the lateness of the loop's turns.

    Args:
        limit_s: lateness that counts as an overrun.

    Attributes:
        overruns: number of overruns so far.
        in_a_row: overruns without an ordinary turn between them, up to the newest turn.
        max_s: largest lateness so far, s.
    """

    def __init__(self, limit_s: float) -> None:
        self.limit_s = limit_s
        self.overruns = self.in_a_row = 0
        self.max_s = 0.0
        self._newest: deque[float] = deque(maxlen=WINDOW)
        self._unread = 0
        self._p99_s = 0.0

    def note(self, late_s: float) -> None:
        """Take in one turn."""
        late_s = max(0.0, late_s)
        late = late_s > self.limit_s
        self.in_a_row = self.in_a_row + 1 if late else 0
        self.overruns += late
        self.max_s = max(self.max_s, late_s)
        self._newest.append(late_s)
        self._unread += 1

    @property
    def p99_s(self) -> float:
        """99th percentile of the newest `WINDOW` turns, up to the last renewal, s."""
        if self._unread >= RENEWAL:
            self._p99_s, self._unread = float(np.percentile(self._newest, 99)), 0
        return self._p99_s
