"""Watches an arm that this cell does not drive: between runs and while latched. Decides only; the cell acts."""

from dataclasses import dataclass

import numpy as np

from service.drivers.base import Program, Sample
from service.safety.stop import STANDSTILL_RAD_S
from wire.arrays import FloatArray

MOVED_RAD = 0.01
"""Turn of a joint from where the arm rested that is a motion: some 4 mm at the tool."""
RESTED_S = 0.5
"""Uninterrupted rest after which a motion has ended."""


@dataclass(frozen=True, slots=True)
class Notice:
    """Something that happened to the arm without this cell.

    Attributes:
        text: for people.
        driven: a control program moves the arm, or may; else somebody moved it by other means, such as the pendant.
    """

    text: str
    driven: bool


class IdleArm:
    """Notices that a third party drives or moves the arm.

    A program that is engaged is one of this cell only until the arm has been seen idle: an earlier process of this cell
    may have left it engaged, and is stopped. A motion without a program is an operator's right, so it is only told.

    Args:
        patience_s: time in which an arm that was found engaged must have stopped.
    """

    def __init__(self, patience_s: float) -> None:
        self._patience_s = patience_s
        self.forget()

    def forget(self) -> None:
        """Discard earlier observations: this cell drove the arm, or the samples are another arm's."""
        self._begun_s: float | None = None
        self._idle = False
        self._told = False
        self._rest: FloatArray | None = None
        self._moving = False
        self._still_s = 0.0

    def observe(self, sample: Sample) -> Notice | None:
        """Take in a sample of an arm that this cell does not drive; return what is new, if anything is."""
        if sample.program is Program.ENGAGED:
            return self._engaged(sample)
        if sample.program is Program.STOPPING:  # as a program that was paused and goes on does, under a standing stop
            self._rest = None
            return None
        self._idle, self._told = True, False
        return self._moved(sample)

    def _engaged(self, sample: Sample) -> Notice | None:
        self._rest = None
        if self._begun_s is None:
            self._begun_s = sample.arrival_s
        if self._told or not (self._idle or sample.arrival_s - self._begun_s > self._patience_s):
            return None
        self._told = True
        text = "the arm's program is engaged, and this cell has not engaged it: who else drives the arm?"
        return Notice(text, driven=True)

    def _moved(self, sample: Sample) -> Notice | None:
        if self._rest is None:
            self._rest = sample.q
            self._moving = False
            return None
        if not self._moving:
            if not float(np.abs(sample.q - self._rest).max()) > MOVED_RAD:
                return None
            self._moving, self._still_s = True, sample.arrival_s
            text = "the arm is being moved, and not by this cell; a run needs it at its start pose"
            return Notice(text, driven=False)
        if float(np.abs(sample.qd).max()) > STANDSTILL_RAD_S:
            self._still_s = sample.arrival_s
        elif sample.arrival_s - self._still_s >= RESTED_S:
            self._moving, self._rest = False, sample.q
            where = np.round(1e3 * sample.tcp_position, 1).tolist()
            return Notice(f"the arm that was moved rests again, its TCP at {where} mm", driven=False)
        return None
