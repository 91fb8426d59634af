"""Budget of operations that a thread may still use in this tick."""

from typing import Final

from .errors import ScriptRuntimeError

LARGEST_DEBT: Final = 150_000
"""Operations beyond the budget that one uninterruptible statement may use: twice the largest product."""


class Budget:
    """A count of operations; compiled code and functions on long values subtract their operations from it.

    The emulated controller is one thread of its process, so one budget serves every program in turn; it is filled
    before a script's thread continues.
    """

    __slots__ = ("left",)

    def __init__(self) -> None:
        self.left = 0

    def take(self, operations: int) -> None:
        """Subtract the operations of work on a long value.

        Raises:
            ScriptRuntimeError: the statement has used far more operations than a tick allows.
        """
        self.left -= operations
        if self.left < -LARGEST_DEBT:
            raise ScriptRuntimeError("A statement does too much work at once: take it apart")


BUDGET = Budget()
EXHAUSTED = 1
"""Yielded by a thread that has used up its budget; a thread that waits for the next tick yields None."""
