"""Absolute schedule of a real-time world on a general-purpose kernel."""

import time
from collections.abc import Callable

MAX_CATCH_UP_TICKS = 3
"""Ticks that may run back to back after a delay; further lost time is not made up."""


class Metronome:
    """Waits for the beats of an absolute schedule, so lateness does not accumulate.

    Attributes:
        overruns: beats that came more than one period late.
        skipped: beats left out; catching up with them would have taken more than `MAX_CATCH_UP_TICKS` ticks in a row.
        worst_lateness_s: greatest lateness of a beat, s.
    """

    def __init__(
        self,
        period_s: float,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Start the schedule now.

        Args:
            period_s: time between beats, s.
            clock: returns monotonic time, s.
            sleep: returns after approximately the given time, s.
        """
        self.overruns = 0
        self.skipped = 0
        self.worst_lateness_s = 0.0
        self._period_s = period_s
        self._clock = clock
        self._sleep = sleep
        self._due_s = clock()

    def restart(self) -> None:
        """Restart the schedule now, after work that was not a tick."""
        self._due_s = self._clock()

    def wait(self, beats: int = 1) -> None:
        """Return `beats` beats after the last one, at once if that time has passed."""
        self._due_s += beats * self._period_s
        ahead_s = self._due_s - self._clock()
        if ahead_s > 0.0:
            self._sleep(ahead_s)
        late_s = self._clock() - self._due_s
        self.worst_lateness_s = max(self.worst_lateness_s, late_s)
        if late_s > self._period_s:
            self.overruns += 1
        behind = int(late_s / self._period_s) - MAX_CATCH_UP_TICKS
        if behind > 0:
            self.skipped += behind
            self._due_s += behind * self._period_s
