"""Each number under a ticket is good once, in any order, and the book stays small."""

import secrets

from hypothesis import given
from hypothesis import strategies as st

from service.cell.tickets import MAX_TICKETS, WINDOW, Tickets, Use
from service.envelope import TICKET_IDLE_S


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


@given(st.lists(st.integers(1, 3 * WINDOW), max_size=200))
def test_a_number_is_good_once_within_the_window_and_never_below_it(numbers: list[int]) -> None:
    tickets = Tickets(Clock())
    word = tickets.draw("a")
    assert word is not None
    used: set[int] = set()
    for number in numbers:
        fresh = number not in used and number > max(used, default=0) - WINDOW
        assert tickets.use(word, "a", number) is (Use.FRESH if fresh else Use.SPENT)
        if fresh:
            used.add(number)


def test_a_ticket_is_its_senders_alone() -> None:
    tickets = Tickets(Clock())
    first, second = tickets.draw("a"), tickets.draw("b")
    assert first is not None
    assert first != second
    assert tickets.use(first, "b", 1) is Use.FORGED
    assert tickets.use(first, "a", 1) is Use.FRESH, "a forgery spends nothing"
    assert tickets.use(secrets.token_hex(16), "a", 2) is Use.UNKNOWN


def test_a_full_book_draws_none_and_withdraws_only_what_is_idle() -> None:
    clock = Clock()
    tickets = Tickets(clock)
    drawn = [tickets.draw("a") for _ in range(MAX_TICKETS)]
    assert all(drawn)
    assert tickets.draw("late") is None
    clock.now = TICKET_IDLE_S - 1.0
    assert tickets.use(str(drawn[0]), "a", 1) is Use.FRESH
    clock.now = TICKET_IDLE_S
    assert tickets.draw("late") is not None
    assert tickets.use(str(drawn[0]), "a", 2) is Use.FRESH
    assert tickets.use(str(drawn[1]), "a", 1) is Use.UNKNOWN
    assert len(tickets._drawn) == 2
