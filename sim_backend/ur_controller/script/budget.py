"""Work that a thread may still do in this tick."""

from typing import Final

from .errors import ScriptRuntimeError

LARGEST_DEBT: Final = 150_000
"""Operations beyond the budget that one statement may take, which nothing can interrupt: twice the largest product."""


class Budget:
    """A count of operations, shared by compiled code, which takes its own from it, and by what works on long values.

    The emulated controller is one thread of its process, so that one budget, filled before a script's thread goes on,
    serves every program in turn.
    """

    __slots__ = ("left",)

    def __init__(self) -> None:
        self.left = 0

    def take(self, operations: int) -> None:
        """Count work on a long value.

        Raises:
            ScriptRuntimeError: The statement has taken far more than a tick's.
        """
        self.left -= operations
        if self.left < -LARGEST_DEBT:
            raise ScriptRuntimeError("A statement does too much work at once: take it apart")


BUDGET = Budget()
EXHAUSTED = 1
"""What a thread yields that has used up its budget; one that waits for the next tick yields None."""
