"""Orders on their way to the control program: one register file that holds one order at a time, written in turn."""

from collections import deque
from collections.abc import Callable, Sequence

from service.drivers.ur.registers import Command, input_values

LAST_SEQUENCE = 2**31 - 2**20
"""Numbers beyond it do not fit the register for long: what stands there is another's, and counting starts anew."""


class Outbox:
    """Writes orders into the input registers, each once the program has looked at the one before.

    Registers keep their last value, so an order is repeated by writing the same again, and one that is overwritten too
    early is lost. A newer target replaces an older one, which is not worth waiting for; a stop replaces everything at
    once and stays in the register until the next order.

    Args:
        send: writes the values of `registers.INPUT_NAMES` now, or not at all.
    """

    def __init__(self, send: Callable[[tuple[int | float, ...]], object]) -> None:
        self._send = send
        self._sequence = 0
        self._written = 0
        self._command = Command.STOP
        self._values = input_values(0, Command.STOP, ())
        self._handled = 0
        self._waiting: deque[tuple[int, Command, Sequence[float]]] = deque()

    def begin(self, handled: int) -> int:
        """Forget all orders and write a stop, under a number that the program has not seen.

        A stop and not nothing: a program that is paused meanwhile would go on with its last target when it is resumed.

        Args:
            handled: last number that the program echoed, perhaps of an earlier client.

        Returns:
            The number.
        """
        self._waiting.clear()
        latest = max(self._sequence, handled)
        self._sequence = latest + 1 if latest < LAST_SEQUENCE else 1
        self._handled = handled
        self._write(self._sequence, Command.STOP, ())
        return self._sequence

    def put(self, command: Command, arguments: Sequence[float] = ()) -> int:
        """Write an order, or have it wait for its turn; return its number, which the program echoes."""
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

    def stop(self) -> None:
        """Write a stop, or repeat the one that stands there."""
        if self._command is Command.STOP:
            self._waiting.clear()
            self.repeat()
        else:
            self.put(Command.STOP)

    def observe(self, handled: int) -> bool:
        """Take in the last number that the program looked at; return whether an order was written."""
        self._handled = handled
        if not self._waiting or not self._is_free(self._waiting[0][1]):
            return False
        self._write(*self._waiting.popleft())
        return True

    def repeat(self) -> None:
        """Write the same again: the sign of life that the controller's watchdog waits for."""
        self._send(self._values)

    def _is_free(self, command: Command) -> bool:
        replaceable = self._command is Command.NONE or self._command is command is Command.TARGET
        return replaceable or self._handled >= self._written

    def _write(self, sequence: int, command: Command, arguments: Sequence[float]) -> None:
        self._written, self._command = sequence, command
        self._values = input_values(sequence, command, arguments)
        self._send(self._values)
