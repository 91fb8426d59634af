"""Motion of the emulated arm: movers, force mode, and the resulting joint target."""

from .force import ForceTask
from .motion import Motion

__all__ = ["ForceTask", "Motion"]
