"""The cell's memory and voice: the latch, the ledger of runs and events, and the observers who hear of them.

`Journal` is the only class of this folder that the rest of the cell uses.
"""

from service.cell.journal.journal import Journal, Observer

__all__ = ["Journal", "Observer"]
