"""Work that a thread may still do in this tick."""


class Budget:
    """A count of operations, shared by compiled code, which takes its own from it, and by what works on long values.

    The emulated controller is one thread of its process, so that one budget, filled before a script's thread goes on,
    serves every program in turn.
    """

    __slots__ = ("left",)

    def __init__(self) -> None:
        self.left = 0


BUDGET = Budget()
EXHAUSTED = 1
"""What a thread yields that has used up its budget; one that waits for the next tick yields None."""
