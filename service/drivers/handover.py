"""Hands samples from the transport's thread to the event loop. The newest win; no force peak escapes the check."""

import threading
from collections import deque

import numpy as np

from service.drivers.base import Sample
from service.faults import FaultCode

CAPACITY = 64
"""Samples that may wait: 128 ms at 500 Hz. A loop that is further behind has latched STALE."""


class Handover:
    """A bounded queue of samples with one writer and one reader.

    A full queue drops its oldest sample. Among the dropped samples, the ones with the largest force and the largest
    torque are kept and come out first, so a peak during an overload is still checked against its ceiling.
    """

    def __init__(self, capacity: int = CAPACITY) -> None:
        self._lock = threading.Lock()
        self._samples: deque[Sample] = deque()
        self._capacity = capacity
        self._worst_force: Sample | None = None
        self._worst_torque: Sample | None = None
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
        """Put a link fault in; the first of several is kept. Return whether the reader must be woken."""
        with self._lock:
            self._fault = self._fault or (code, text)
            return self._announce()

    def take(self) -> tuple[list[Sample], tuple[FaultCode, str] | None]:
        """Take out everything, in order of arrival."""
        with self._lock:
            dropped = {one.seq: one for one in (self._worst_force, self._worst_torque) if one is not None}
            samples = [dropped[seq] for seq in sorted(dropped)] + list(self._samples)
            fault, self._fault = self._fault, None
            self._samples.clear()
            self._worst_force = self._worst_torque = None
            self._announced = False
            return samples, fault

    def _announce(self) -> bool:
        wake, self._announced = not self._announced, True
        return wake

    def _drop(self, sample: Sample) -> None:
        self.dropped += 1
        if self._worst_force is None or _severity(sample, 0) > _severity(self._worst_force, 0):
            self._worst_force = sample
        if self._worst_torque is None or _severity(sample, 3) > _severity(self._worst_torque, 3):
            self._worst_torque = sample


def _severity(sample: Sample, first: int) -> float:
    """Return the force (`first` 0) or torque (3) of a sample, N or N·m.

    It is infinite if the wrench is not finite or the sensor is saturated.
    """
    usable = not sample.saturated and bool(np.isfinite(sample.wrench).all())
    return float(np.linalg.norm(sample.wrench[first : first + 3])) if usable else float("inf")
