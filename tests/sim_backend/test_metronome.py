"""The schedule of a real-time world, on virtual time."""

import itertools

import pytest

from sim_backend.metronome import MAX_CATCH_UP_TICKS, Metronome

PERIOD_S = 0.002


class VirtualTime:
    """A clock that only sleeping and `work` move; `oversleep_s` is what the kernel adds to each sleep."""

    def __init__(self, oversleep_s: float = 0.0) -> None:
        self.now_s = 100.0
        self.oversleep_s = oversleep_s

    def clock(self) -> float:
        return self.now_s

    def sleep(self, duration_s: float) -> None:
        assert duration_s > 0
        self.now_s += duration_s + self.oversleep_s

    def work(self, duration_s: float) -> None:
        self.now_s += duration_s


def metronome(time: VirtualTime) -> Metronome:
    return Metronome(PERIOD_S, clock=time.clock, sleep=time.sleep)


def test_lateness_of_each_beat_does_not_add_up() -> None:
    time = VirtualTime(oversleep_s=0.0003)
    beat = metronome(time)
    for _ in range(1000):
        beat.wait()
        time.work(0.0005)
    assert time.now_s == pytest.approx(100.0 + 1000 * PERIOD_S + 0.0003 + 0.0005)
    assert beat.overruns == 0
    assert beat.worst_lateness_s == pytest.approx(0.0003)


def test_a_short_delay_is_made_up_for_in_full() -> None:
    time = VirtualTime()
    beat = metronome(time)
    beat.wait()
    time.work(2.5 * PERIOD_S)
    for _ in range(10):
        beat.wait()
    assert time.now_s == pytest.approx(100.0 + 11 * PERIOD_S)
    assert beat.overruns == 1
    assert beat.skipped == 0


def test_a_long_delay_never_ends_in_a_burst() -> None:
    time = VirtualTime()
    beat = metronome(time)
    beat.wait()
    time.work(1.0)
    at = []
    for _ in range(20):
        beat.wait()
        at.append(time.now_s)
    back_to_back = sum(1 for a, b in itertools.pairwise(at) if b - a < PERIOD_S / 2)
    assert back_to_back <= MAX_CATCH_UP_TICKS
    assert beat.skipped == pytest.approx(1.0 / PERIOD_S - 1 - MAX_CATCH_UP_TICKS, abs=1)
    assert beat.worst_lateness_s == pytest.approx(1.0 - PERIOD_S)


def test_several_beats_may_be_waited_for_at_once() -> None:
    time = VirtualTime()
    beat = metronome(time)
    for beats in (5, 1, 5):
        beat.wait(beats)
    assert time.now_s == pytest.approx(100.0 + 11 * PERIOD_S)
    assert (beat.overruns, beat.skipped) == (0, 0)


def test_a_restart_forgives_what_went_before() -> None:
    time = VirtualTime()
    beat = metronome(time)
    beat.wait()
    time.work(1.0)
    beat.restart()
    beat.wait()
    assert beat.overruns == 0
    assert time.now_s == pytest.approx(101.0 + 2 * PERIOD_S)
