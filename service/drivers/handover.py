"""From the transport's thread to the event loop: the newest samples win, and none escapes the force check."""

import threading
from collections import deque

import numpy as np

from service.drivers.base import Sample
from service.faults import FaultCode

CAPACITY = 64
"""Samples that may wait, 128 ms at 500 Hz: a loop further behind than that has latched STALE."""


class Handover:
    """A bounded queue of samples with one writer and one reader.

    When it is full the oldest sample goes. Of those dropped, the one with the largest force is kept and comes out
    first: a peak that falls into an overload still meets the ceiling.
    """

    def __init__(self, capacity: int = CAPACITY) -> None:
        self._lock = threading.Lock()
        self._samples: deque[Sample] = deque()
        self._capacity = capacity
        self._worst_dropped: Sample | None = None
        self._fault: tuple[FaultCode, str] | None = None
        self._announced = False
        self.dropped = 0

    def offer(self, sample: Sample) -> bool:
        """Put a sample in; return whether the reader must be woken."""
        with self._lock:
            self._samples.append(sample)
            if len(self._samples) > self._capacity:
                self._drop(self._samples.popleft())
            return self._announce()

    def report(self, code: FaultCode, text: str) -> bool:
        """Put a link fault in, the first of several; return whether the reader must be woken."""
        with self._lock:
            self._fault = self._fault or (code, text)
            return self._announce()

    def take(self) -> tuple[list[Sample], tuple[FaultCode, str] | None]:
        """Take out everything, in order of arrival."""
        with self._lock:
            samples = list(self._samples)
            if self._worst_dropped is not None:
                samples.insert(0, self._worst_dropped)
            fault, self._fault = self._fault, None
            self._samples.clear()
            self._worst_dropped = None
            self._announced = False
            return samples, fault

    def _announce(self) -> bool:
        wake, self._announced = not self._announced, True
        return wake

    def _drop(self, sample: Sample) -> None:
        self.dropped += 1
        if self._worst_dropped is None or _severity(sample) > _severity(self._worst_dropped):
            self._worst_dropped = sample


def _severity(sample: Sample) -> float:
    """How much the monitor must see this sample: its force, infinite where it is not a number or saturated."""
    force = float(np.linalg.norm(sample.wrench[:3]))
    return force if np.isfinite(force) and not sample.saturated else float("inf")
