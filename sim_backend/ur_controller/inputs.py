"""Values that clients write: general-purpose registers, the other RTDE inputs, and the watchdogs over their
packages.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from sim_backend.ur_controller.terminals import TerminalInputs, Terminals
from wire.records import TICK_S
from wire.rtde.fields import BIT_REGISTERS, DOUBLE_REGISTERS, INPUTS, INT_REGISTERS

LATE_PACKAGES = 1024
"""Limit of input packages that wait for their latency. Only a flood exceeds it; the oldest then apply early."""

Action: TypeAlias = Literal["ignore", "pause", "stop"]


class Registers:
    """General-purpose registers in one direction.

    Attributes:
        ints: 48 integers of 32 bits.
        doubles: 48 numbers.
        bits: 128 bits.
    """

    def __init__(self) -> None:
        self.ints = [0] * INT_REGISTERS
        self.doubles = [0.0] * DOUBLE_REGISTERS
        self.bits = [False] * (BIT_REGISTERS.stop)

    def word(self, first: int) -> int:
        """Return bits `first` … `first` + 31 as one number."""
        return sum(bit << i for i, bit in enumerate(self.bits[first : first + 32]))

    def set_word(self, first: int, word: int) -> None:
        """Set bits `first` … `first` + 31."""
        self.bits[first : first + 32] = [bool(word >> i & 1) for i in range(32)]


@dataclass(slots=True)
class Watchdog:
    """Packages with one input must arrive at least every `period_ticks`."""

    period_ticks: float
    action: Action
    waited: int = 0


class Inputs:
    """The inputs of all RTDE clients and their latency.

    Args:
        terminals: terminals whose outputs clients may write.
        set_speed: sets the speed slider.

    Attributes:
        registers: the input registers.
        external_wrench: (6,) reading of a client's own force sensor, as the client reports it.
        watchdogs: watchdogs by the variable that they watch.
    """

    def __init__(self, terminals: Terminals, set_speed: Callable[[float], None]) -> None:
        self.registers = Registers()
        self.external_wrench: tuple[float, ...] = (0.0,) * 6
        self.watchdogs: dict[str, Watchdog] = {}
        self._masked = TerminalInputs(terminals, set_speed)
        self._waiting: deque[tuple[int, tuple[str, ...], Sequence[Any]]] = deque()
        self._writers: dict[str, Callable[[Any], None]] = {name: self._writer(name) for name in INPUTS}

    def receive(self, names: Sequence[str], values: Sequence[Any], due: int) -> None:
        """Store one package of RTDE inputs; it takes effect in the first tick from number `due` on."""
        self._waiting.append((due, tuple(names), values))
        if len(self._waiting) > LATE_PACKAGES:
            self._apply(*self._waiting.popleft()[1:])

    def apply_due(self, tick: int) -> None:
        """Apply the packages that are due by tick number `tick`, in the order of arrival."""
        waiting = self._waiting
        while waiting and waiting[0][0] <= tick:
            _, names, values = waiting.popleft()
            self._apply(names, values)

    def forget_latency(self) -> None:
        """Apply all waiting packages now; the episode that delayed them is over."""
        self.apply_due(self._waiting[-1][0] if self._waiting else 0)

    def watch(self, variable: str, least_hz: float, action: Action) -> None:
        """Expect packages with `variable` at a frequency, Hz, from now on; 0 expects none."""
        if least_hz > 0.0:
            self.watchdogs[variable] = Watchdog(1.0 / (least_hz * TICK_S), action)
        else:
            self.watchdogs.pop(variable, None)

    def starved(self) -> tuple[str, Action] | None:
        """Advance the watchdogs by 2 ms; return a variable that is overdue and the action to take.

        A watchdog reports once, and again only after the next package.
        """
        tripped = None
        for variable, watchdog in self.watchdogs.items():
            watchdog.waited += 1
            if watchdog.period_ticks < watchdog.waited <= watchdog.period_ticks + 1.0 and watchdog.action != "ignore":
                tripped = variable, watchdog.action
        return tripped

    def _apply(self, names: tuple[str, ...], values: Sequence[Any]) -> None:
        writers = self._writers
        masked = False
        for name, value in zip(names, values, strict=True):
            writers[name](value)
            masked = masked or name.endswith("_mask")
        if masked:
            self._masked.apply(names)
        for variable, watchdog in self.watchdogs.items():
            if variable in names:
                watchdog.waited = 0

    def _writer(self, name: str) -> Callable[[Any], None]:
        registers = self.registers
        match name.rsplit("_", 1):
            case ["input_int_register", number]:
                return lambda value, i=int(number): registers.ints.__setitem__(i, int(value))
            case ["input_double_register", number]:
                return lambda value, i=int(number): registers.doubles.__setitem__(i, float(value))
            case ["input_bit_register", number]:
                return lambda value, i=int(number): registers.bits.__setitem__(i, bool(value))
            case _ if name.startswith("input_bit_registers"):
                first = 0 if "0_to" in name else 32
                return lambda value: registers.set_word(first, int(value))
            case _ if name == "external_force_torque":
                return self._set_external_wrench
            case _:
                return lambda value: self._masked.values.__setitem__(name, value)

    def _set_external_wrench(self, value: Sequence[float]) -> None:
        self.external_wrench = tuple(value)
