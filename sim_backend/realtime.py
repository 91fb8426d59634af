"""Keeping 500 Hz on a general-purpose kernel: scheduling asked of it, and an absolute schedule."""

import ctypes
import gc
import os
import sys
import time
from collections.abc import Callable

MAX_CATCH_UP_TICKS = 3
"""Ticks that may run back to back after a delay; time lost beyond them stays lost."""

_SPIN_S = 100e-6
_MCL_CURRENT_AND_FUTURE = 3
_PRIORITY = 50


def request_scheduling() -> list[str]:
    """Ask for real-time scheduling of this thread and for locked memory.

    Threads started before keep their scheduling; threads started by this one afterwards inherit it.

    Returns:
        What was refused, one line each with its remedy; empty when everything was granted.
    """
    refused: list[str] = []
    sys.setswitchinterval(5e-4)  # a waiting tick must not stand 5 ms behind another Python thread
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    except OSError as error:
        refused.append(f"no SCHED_FIFO ({error.strerror}), ticks may come late; grant CAP_SYS_NICE or an rtprio limit")
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT_AND_FUTURE):
        reason = os.strerror(ctypes.get_errno())
        refused.append(f"no mlockall ({reason}), page faults may delay a tick; grant CAP_IPC_LOCK or a memlock limit")
    return refused


def freeze_garbage() -> None:
    """Take what exists now out of the collector's sight: its passes over a loaded program last longer than a tick."""
    gc.collect()
    gc.freeze()


def has_realtime_scheduling() -> bool:
    """Whether the calling thread runs under SCHED_FIFO."""
    return os.sched_getscheduler(0) == os.SCHED_FIFO


class Metronome:
    """Waits for the beats of an absolute schedule, so that lateness does not add up.

    Attributes:
        overruns: beats that came more than one period late.
        skipped: beats left out because catching up with them would have been a burst.
        worst_lateness_s: greatest lateness of a beat, s.
    """

    def __init__(
        self,
        period_s: float,
        *,
        spin: bool = False,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Start the schedule now.

        Args:
            period_s: time between beats, s.
            spin: busy-wait the last 100 µs; only worth it with real-time scheduling.
            clock: monotonic time, s.
            sleep: returns after about the given time, s.
        """
        self.overruns = 0
        self.skipped = 0
        self.worst_lateness_s = 0.0
        self._period_s = period_s
        self._spin_s = _SPIN_S if spin else 0.0
        self._clock = clock
        self._sleep = sleep
        self._due_s = clock()

    def restart(self) -> None:
        """Count the schedule from now: after work that was not a tick."""
        self._due_s = self._clock()

    def wait(self) -> None:
        """Return at the next beat, or at once if it has passed."""
        self._due_s += self._period_s
        ahead_s = self._due_s - self._clock()
        if ahead_s > self._spin_s:
            self._sleep(ahead_s - self._spin_s)
        while self._spin_s and self._clock() < self._due_s:
            pass
        late_s = self._clock() - self._due_s
        self.worst_lateness_s = max(self.worst_lateness_s, late_s)
        if late_s > self._period_s:
            self.overruns += 1
        behind = int(late_s / self._period_s) - MAX_CATCH_UP_TICKS
        if behind > 0:
            self.skipped += behind
            self._due_s += behind * self._period_s
