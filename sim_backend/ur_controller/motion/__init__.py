"""Motion of the emulated arm: movers, force mode, and the joint target that they make."""

from .force import ForceTask
from .motion import Motion

__all__ = ["ForceTask", "Motion"]
