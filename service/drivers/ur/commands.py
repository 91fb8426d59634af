"""Orders to the control program: one register file holds one order at a time, and orders wait for their turn."""

from collections import deque
from collections.abc import Callable, Sequence

from service.drivers.ur.registers import Command, input_values

LAST_SEQUENCE = 2**31 - 2**20
"""Largest sequence number in use. A larger one found in the register is another client's, and counting restarts."""


class Outbox:
    """Writes orders into the input registers, each after the program has handled the previous one.

    Registers keep their last value, so writing the same again repeats an order, and an order overwritten too early is
    lost. A newer target replaces a waiting older one. A stop replaces everything at once and stays in the register
    until the next order.

    Args:
        send: writes the values of `registers.INPUT_NAMES` now, or not at all.
    """

    def __init__(self, send: Callable[[tuple[int | float, ...]], object]) -> None:
        self._send = send
        self._sequence = 0
        self._written = 0
        self._command = Command.STOP
        self._values = input_values(0, Command.STOP, ())
        self._is_blind = False
        self._handled = 0
        self._waiting: deque[tuple[int, Command, Sequence[float]]] = deque()

    def begin(self, handled: int) -> int:
        """Discard all orders and write a stop under a number that the program has not seen.

        A stop is written because a paused program would otherwise continue to its last target when resumed.

        Args:
            handled: last number that the program echoed, perhaps from an earlier client.

        Returns:
            The number of the stop.
        """
        self._waiting.clear()
        latest = max(self._sequence, handled)
        self._sequence = latest + 1 if latest < LAST_SEQUENCE else 1
        self._handled = handled
        self._write(self._sequence, Command.STOP, ())
        return self._sequence

    def put(self, command: Command, arguments: Sequence[float] = ()) -> int:
        """Write an order, or queue it; return its number, which the program echoes."""
        self._sequence += 1
        order = (self._sequence, command, arguments)
        if command is Command.STOP:
            self._waiting.clear()
            self._write(*order)
        elif self._waiting and self._waiting[-1][1] is command is Command.TARGET:
            self._waiting[-1] = order
        elif self._waiting or not self._is_free(command):
            self._waiting.append(order)
        else:
            self._write(*order)
        return self._sequence

    def stop(self, *, blind: bool = False) -> None:
        """Write a stop, or repeat the one in the register.

        Args:
            blind: do not yield to the sensor meanwhile; a blind stop stays blind.
        """
        if self._command is Command.STOP and (self._is_blind or not blind):
            self._waiting.clear()
            self.repeat()
        else:
            self.put(Command.STOP, (1.0,) if blind else ())

    def observe(self, handled: int) -> bool:
        """Record the last number that the program handled; return True if an order was written."""
        self._handled = handled
        if not self._waiting or not self._is_free(self._waiting[0][1]):
            return False
        self._write(*self._waiting.popleft())
        return True

    def repeat(self) -> None:
        """Write the same values again, the sign of life that the controller's watchdog expects."""
        self._send(self._values)

    def _is_free(self, command: Command) -> bool:
        replaceable = self._command is Command.NONE or self._command is command is Command.TARGET
        return replaceable or self._handled >= self._written

    def _write(self, sequence: int, command: Command, arguments: Sequence[float]) -> None:
        self._written, self._command, self._is_blind = sequence, command, command is Command.STOP and bool(arguments)
        self._values = input_values(sequence, command, arguments)
        self._send(self._values)
