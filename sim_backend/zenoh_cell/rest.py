"""Rest of a world in real time that nothing drives: its states come at a fifth of the rate, and cost a fifth."""

from wire.modes import RESTING_PERIOD_S
from wire.records import TICK_S

QUIET_TICKS = 1500
"""Ticks without a command, a reset or a program that is not idle, after which a world rests: 3 s. No measurement of a
resting arm before its run takes longer, so none sees the rate change."""
RESTING_TICKS = round(RESTING_PERIOD_S / TICK_S)
"""Ticks from one state of a resting world to the next."""


class Rest:
    """Decides from state to state how much time passes in a world.

    Attributes:
        ticks: ticks to the next state: 1, at rest `RESTING_TICKS`.
    """

    def __init__(self) -> None:
        self._quiet = 0
        self.ticks = 1

    def note(self, *, disturbed: bool) -> None:
        """Take note of a state that was published.

        Args:
            disturbed: the world was commanded or laid out, or its program is not idle.
        """
        self._quiet = 0 if disturbed else self._quiet + 1
        self.ticks = 1 if self._quiet < QUIET_TICKS else RESTING_TICKS
