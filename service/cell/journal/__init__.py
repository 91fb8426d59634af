"""Latch, runs and events of one cell: kept on disk, and told to observers.

`Journal` is the only class of this folder that the rest of the cell uses.
"""

from service.cell.journal.journal import Journal, Observer

__all__ = ["Journal", "Observer"]
