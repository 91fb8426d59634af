from service.drivers.ur.commands import Outbox
from service.drivers.ur.registers import ARGUMENTS, Command


class Registers:
    """Input registers and a program that looks at them when it is told to."""

    def __init__(self) -> None:
        self.values: tuple[float, ...] = ()
        self.writes = 0
        self.done: list[tuple[int, Command]] = []
        self.handled = 0

    def write(self, values: tuple[float, ...]) -> None:
        assert len(values) == 2 + ARGUMENTS
        self.values = values
        self.writes += 1

    def look(self) -> int:
        sequence, command = int(self.values[0]), Command(int(self.values[1]))
        if sequence > self.handled:
            self.handled = sequence
            self.done.append((sequence, command))
        return self.handled


def an_outbox() -> tuple[Outbox, Registers]:
    registers = Registers()
    outbox = Outbox(registers.write)
    outbox.begin(registers.handled)
    outbox.observe(registers.look())
    registers.done.clear()
    return outbox, registers


def test_orders_given_at_once_are_carried_out_one_after_another() -> None:
    outbox, registers = an_outbox()
    asked = [outbox.put(Command.ZERO_FT), outbox.put(Command.ENGAGE, [1.0] * 24), outbox.put(Command.TARGET, [2.0] * 6)]
    for _ in range(5):
        outbox.observe(registers.look())
    assert registers.done == [(asked[0], Command.ZERO_FT), (asked[1], Command.ENGAGE), (asked[2], Command.TARGET)]
    assert registers.values[2:9] == (2.0,) * 6 + (0.0,)


def test_a_newer_target_replaces_an_older_one_that_nobody_looked_at() -> None:
    outbox, registers = an_outbox()
    outbox.put(Command.TARGET, [1.0] * 6)
    newest = outbox.put(Command.TARGET, [2.0] * 6)
    outbox.observe(registers.look())
    assert registers.done == [(newest, Command.TARGET)]
    outbox.put(Command.ENGAGE)
    outbox.put(Command.TARGET, [3.0] * 6)
    newest = outbox.put(Command.TARGET, [4.0] * 6)
    for _ in range(3):
        outbox.observe(registers.look())
    assert registers.done[-1] == (newest, Command.TARGET)
    assert len(registers.done) == 3


def test_a_stop_replaces_everything_at_once_and_is_repeated_until_another_order_comes() -> None:
    outbox, registers = an_outbox()
    outbox.put(Command.ENGAGE)
    outbox.put(Command.TARGET, [1.0] * 6)
    outbox.stop()
    assert Command(registers.values[1]) is Command.STOP
    number = registers.values[0]
    for _ in range(4):
        outbox.observe(registers.look())
        outbox.stop()
    assert [command for _, command in registers.done] == [Command.STOP]
    assert registers.values[0] == number, "one stop has one number"
    outbox.repeat()
    assert Command(registers.values[1]) is Command.STOP


def test_a_blind_stop_replaces_a_plain_one_and_is_not_replaced_by_one() -> None:
    outbox, registers = an_outbox()
    outbox.stop()
    outbox.stop(blind=True)
    outbox.stop()
    outbox.stop(blind=True)
    assert (Command(registers.values[1]), registers.values[2]) == (Command.STOP, 1.0)
    outbox.observe(registers.look())
    outbox.put(Command.TARGET, [0.5] * 6)
    outbox.observe(registers.look())
    outbox.stop()
    assert (Command(registers.values[1]), registers.values[2]) == (Command.STOP, 0.0)


def test_an_order_after_a_stop_waits_until_the_stop_was_seen() -> None:
    outbox, registers = an_outbox()
    outbox.put(Command.ZERO_FT)
    outbox.stop()
    outbox.put(Command.ENGAGE)
    assert Command(registers.values[1]) is Command.STOP
    outbox.observe(registers.look())
    outbox.observe(registers.look())
    assert [command for _, command in registers.done] == [Command.STOP, Command.ENGAGE]


def test_numbers_go_on_from_those_of_an_earlier_client() -> None:
    registers = Registers()
    registers.handled = 700
    outbox = Outbox(registers.write)
    assert outbox.begin(700) == 701
    outbox.observe(registers.look())
    assert outbox.put(Command.ZERO_FT) == 702
    outbox.observe(registers.look())
    assert registers.done[-1] == (702, Command.ZERO_FT)


def test_a_new_beginning_leaves_no_old_order() -> None:
    outbox, registers = an_outbox()
    outbox.put(Command.ENGAGE)
    outbox.put(Command.TARGET)
    outbox.begin(registers.handled)
    for _ in range(3):
        outbox.observe(registers.look())
    assert [command for _, command in registers.done] == [Command.STOP]
