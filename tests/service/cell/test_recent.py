"""The newest wrenches of a run."""

import numpy as np

from service.cell.recent import Recent


def test_the_newest_come_oldest_first_however_many_there_were() -> None:
    recent, given = Recent(4), []
    assert recent.newest(3).shape == (0, 6)
    for number in range(30):
        given.append(np.full(6, float(number)))
        recent.append(given[-1])
        for most in (1, 3, 4, 9):
            np.testing.assert_array_equal(recent.newest(most), given[-min(most, 4) :])
        assert len(recent) == min(number + 1, 4)


def test_what_was_taken_out_stays_as_it_was() -> None:
    recent = Recent(2)
    recent.append(np.zeros(6))
    taken = recent.newest(2)
    for _ in range(9):
        recent.append(np.ones(6))
    np.testing.assert_array_equal(taken, np.zeros((1, 6)))


def test_after_clearing_only_what_comes_later_is_there() -> None:
    recent = Recent(3)
    for number in range(5):
        recent.append(np.full(6, float(number)))
    recent.clear()
    assert len(recent) == 0
    recent.append(np.full(6, 7.0))
    np.testing.assert_array_equal(recent.newest(3), np.full((1, 6), 7.0))
