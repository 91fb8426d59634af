from collections.abc import Sequence
from dataclasses import replace
from math import hypot
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from service.faults import FaultCode
from service.safety.monitor import Monitor, MonitorParameters
from service.safety.verdict import Verdict

LIMITS = MonitorParameters(
    force_ceiling_n=30.0,
    torque_ceiling_nm=3.0,
    stuck_samples=4,
    stuck_channel_samples=8,
    max_age_s=0.02,
    max_gap_s=0.02,
)
TICK = 0.002


class Source:
    """Feeds a monitor a stream of samples that would pass, but for what a test changes in one."""

    def __init__(self, parameters: MonitorParameters = LIMITS) -> None:
        self.monitor = Monitor(parameters)
        self.seq = 0
        self.now = 100.0

    def send(self, wrench: Any = None, **changes: Any) -> Verdict:
        self.seq += 1
        self.now += TICK
        quiet = np.array([0.1, -0.1, 0.2, 0.0, 0.0, 0.0]) + self.seq * 1e-6
        sample: dict[str, Any] = {
            "epoch": 7,
            "episode": 1,
            "seq": self.seq,
            "time_s": self.seq * TICK,
            "wrench": quiet if wrench is None else np.array(wrench, np.float64),
            "raw": quiet,
            "motion": np.zeros(12),
            "saturated": False,
            "now": self.now,
        }
        return self.monitor.check(**sample | changes)


@pytest.fixture
def source() -> Source:
    source = Source()
    assert all(source.send().fault is None for _ in range(10))
    return source


def test_one_sample_at_the_ceiling_trips_on_any_axis(source: Source) -> None:
    for axis in range(3):
        for sign in (1, -1):
            wrench = np.zeros(6)
            wrench[axis] = sign * 30.0
            verdict = source.send(wrench)
            assert (verdict.fault, verdict.measured, verdict.limit) == (FaultCode.FORCE_CEILING, 30.0, 30.0)
            assert "30" in verdict.text


def test_the_resultant_trips_where_no_axis_would(source: Source) -> None:
    assert source.send([18, 18, 18, 0, 0, 0]).fault is FaultCode.FORCE_CEILING
    assert source.send([17, 17, 17, 0, 0, 0]).fault is None


def test_torque_has_a_ceiling_of_its_own(source: Source) -> None:
    verdict = source.send([0, 0, 1, 2.2, 2.2, 0])
    assert verdict.fault is FaultCode.FORCE_CEILING
    assert verdict.limit == 3.0
    assert "N·m" in verdict.text


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("channel", range(6))
def test_a_channel_that_is_not_finite_is_invalid(source: Source, bad: float, channel: int) -> None:
    wrench = np.ones(6)
    wrench[channel] = bad
    assert source.send(wrench).fault is FaultCode.SENSOR_INVALID


def test_infinities_that_cancel_are_still_invalid(source: Source) -> None:
    assert source.send([np.inf, -np.inf, 0, 0, 0, 0]).fault is FaultCode.SENSOR_INVALID


@pytest.mark.parametrize(
    "change",
    [{"motion": np.array([[0.0, np.nan]])}, {"raw": np.full(6, np.nan)}, {"time_s": np.nan}, {"time_s": np.inf}],
)
def test_a_raw_reading_pose_or_stamp_that_is_not_finite_is_invalid(source: Source, change: dict[str, Any]) -> None:
    assert source.send(**change).fault is FaultCode.SENSOR_INVALID


def test_an_invalid_sample_does_not_refresh_the_age(source: Source) -> None:
    before = source.now
    source.send([np.nan] * 6)
    assert source.monitor.age(source.now) == pytest.approx(source.now - before)


def test_a_saturated_sensor_counts_as_above_the_ceiling_whatever_it_reads(source: Source) -> None:
    verdict = source.send([1.0, 0, 0, 0, 0, 0], saturated=True)
    assert verdict.fault is FaultCode.FORCE_CEILING
    assert "range" in verdict.text


@pytest.mark.parametrize("channel", range(6))
def test_a_component_at_the_end_of_the_range_counts_as_above_the_ceiling(channel: int) -> None:
    source = Source(replace(LIMITS, force_range_n=25.0, torque_range_nm=2.0))
    limit = 25.0 if channel < 3 else 2.0
    wrench = np.zeros(6)
    wrench[channel] = -limit
    assert source.send(wrench * 0.99).fault is None
    assert source.send(wrench).fault is FaultCode.FORCE_CEILING


NOISE = np.random.default_rng(0).normal(0.0, [0.7] * 3 + [0.05] * 3, (2000, 6))


@pytest.mark.parametrize("where", ["wrench", "raw"])
@pytest.mark.parametrize(
    ("channels", "allowed"),
    [
        (range(6), 4),
        (range(3), 4),
        (range(3, 6), 4),
        *(([channel], 8) for channel in range(6)),
        ([0, 4], 8),
        ([1, 2], 8),
        ([4, 5], 8),
    ],
)
def test_64_channels_that_do_not_change_by_a_bit_are_stuck_after_their_number_of_samples(
    source: Source, where: str, channels: Sequence[int], allowed: int
) -> None:
    verdicts: list[Verdict] = []
    for noisy in NOISE[:allowed]:
        frozen = noisy.copy()
        frozen[list(channels)] = 0.25
        verdicts.append(source.send(**{where: frozen}))
    assert [verdict.fault for verdict in verdicts] == [None] * (allowed - 1) + [FaultCode.SENSOR_STUCK]
    assert (verdicts[-1].measured, verdicts[-1].limit) == (allowed, allowed)
    assert ("of the sensor" if where == "raw" else "of the wrench") in verdicts[-1].text
    if len(channels) == 1:
        assert f"channel {['Fx', 'Fy', 'Fz', 'Tx', 'Ty', 'Tz'][channels[0]]} " in verdicts[-1].text


def test_64_a_channel_that_changes_is_counted_anew_from_one_while_another_repeats(source: Source) -> None:
    noisy = [row.copy() for row in NOISE[:10]]
    noisy[1][1] = noisy[0][1]  # the other channel repeats in the sample in which this one takes its new value
    for row in noisy[1:9]:
        row[0] = 0.25
    verdicts = [source.send(row) for row in noisy[:9]]
    assert [verdict.fault for verdict in verdicts] == [None] * 8 + [FaultCode.SENSOR_STUCK]
    assert verdicts[-1].measured == 8


def test_the_force_that_is_told_is_of_the_three_forces_alone(source: Source) -> None:
    assert source.send([2.0, 3.0, 6.0, 1.5, 0.5, 0.25]).fault is None
    assert source.monitor.force_n == source.monitor.peak_force_n == 7.0


def test_one_channel_may_have_the_limit_of_all() -> None:
    assert replace(LIMITS, stuck_channel_samples=LIMITS.stuck_samples).stuck_channel_samples == LIMITS.stuck_samples


def test_64_an_honest_sensor_whose_noise_is_its_resolution_is_never_stuck() -> None:
    source = Source(replace(LIMITS, stuck_samples=10, stuck_channel_samples=25))
    resolution = np.array([0.7] * 3 + [0.05] * 3)
    for noisy in np.tile(NOISE, (5, 1)):
        quantised = np.round(noisy / resolution) * resolution
        assert source.send(quantised, raw=quantised).fault is None


def test_a_channel_that_moves_once_begins_to_count_anew(source: Source) -> None:
    for index, noisy in enumerate(NOISE[:100]):
        wrench = noisy.copy()
        wrench[2] = index // 7
        assert source.send(wrench).fault is None


def test_duplicates_and_older_samples_are_ignored_and_do_not_refresh_the_age(source: Source) -> None:
    heard = source.now
    for old in (source.seq, source.seq - 5):
        verdict = source.send([99, 0, 0, 0, 0, 0], seq=old)
        assert verdict.fault is None
        assert not verdict.accepted
    assert source.monitor.age(source.now) == pytest.approx(source.now - heard)
    source.seq -= 2
    assert source.send().accepted


def test_duplicates_do_not_count_as_a_stuck_sensor(source: Source) -> None:
    for _ in range(20):
        source.send([1, 2, 3, 4, 5, 6], seq=source.seq)
    assert source.send().fault is None


def test_silence_is_stale_at_the_age_limit(source: Source) -> None:
    assert source.monitor.overdue(source.now + 0.0199).fault is None
    verdict = source.monitor.overdue(source.now + 0.0201)
    assert verdict.fault is FaultCode.STALE
    assert verdict.limit == 0.02


def test_a_cell_that_never_heard_a_sample_is_stale() -> None:
    monitor = Monitor(LIMITS)
    assert monitor.age(5.0) == float("inf")
    assert monitor.overdue(5.0).fault is FaultCode.STALE


def test_a_leap_of_the_stamps_is_stale_because_what_happened_is_unknown(source: Source) -> None:
    verdict = source.send(time_s=source.seq * TICK + 0.1)
    assert verdict.fault is FaultCode.STALE
    assert verdict.measured == pytest.approx(0.1, abs=TICK)


def test_force_is_judged_before_a_leap_of_the_stamps(source: Source) -> None:
    assert source.send([31, 0, 0, 0, 0, 0], time_s=99.0).fault is FaultCode.FORCE_CEILING


def test_a_clock_that_steps_backward_touches_neither_age_nor_verdict(source: Source) -> None:
    assert source.send(time_s=-50.0).fault is None
    assert source.monitor.age(source.now) == 0.0
    assert source.send(time_s=-50.0 + TICK).fault is None


def test_another_epoch_beside_a_living_one_is_a_second_source(source: Source) -> None:
    assert source.send(epoch=8).fault is FaultCode.SOURCE


def test_another_epoch_after_silence_is_a_restart_and_not_resumed(source: Source) -> None:
    source.now += 1.0
    assert source.send(epoch=8).fault is FaultCode.LINK
    assert source.send(epoch=8).fault is FaultCode.LINK


def test_a_world_laid_out_anew_while_in_use_is_a_fault(source: Source) -> None:
    assert source.send(episode=2, seq=1).fault is FaultCode.SOURCE


def test_reset_accepts_a_new_source_and_clears_the_peak(source: Source) -> None:
    source.send([10, 0, 0, 0, 0, 0])
    source.monitor.reset()
    assert source.monitor.peak_force_n == 0.0
    source.seq = 0
    assert source.send(epoch=8, episode=0).fault is None


def test_the_peak_holds_the_largest_force_of_any_sample_that_trips_or_not(source: Source) -> None:
    source.send([3, 4, 0, 0, 0, 0])
    source.send([40, 0, 0, 0, 0, 0])
    source.send()
    assert source.monitor.peak_force_n == 40.0
    assert source.monitor.force_n < 1.0
    source.monitor.clear_peak()
    assert source.monitor.peak_force_n == 0.0


@settings(max_examples=200, deadline=None)
@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=6, max_size=6))
def test_nothing_above_a_ceiling_passes(wrench: list[float]) -> None:
    verdict = Source().send(wrench)
    fine = hypot(*wrench[:3]) < 30.0 and hypot(*wrench[3:]) < 3.0
    assert (verdict.fault is None) == fine


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("force_ceiling_n", 50.1),
        ("force_ceiling_n", -1.0),
        ("force_ceiling_n", float("nan")),
        ("force_ceiling_n", float("inf")),
        ("torque_ceiling_nm", 10.5),
        ("torque_ceiling_nm", 0.0),
        ("force_range_n", 0.0),
        ("stuck_samples", 1),
        ("stuck_channel_samples", 3),
        ("max_age_s", float("inf")),
        ("max_gap_s", 0.0),
    ],
)
def test_limits_that_guard_nothing_are_refused_by_name(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=field):
        replace(LIMITS, **{field: value})


def test_every_limit_is_reached_at_its_value(source: Source) -> None:
    assert source.send([0, 0, 0, 3.0, 0, 0]).fault is FaultCode.FORCE_CEILING
    last = source.now
    assert source.monitor.overdue(last + 0.02 - 1e-9).fault is None
    source = Source(replace(LIMITS, max_age_s=0.25, max_gap_s=0.25))
    source.send(time_s=1.0)
    assert source.send(time_s=1.25).fault is None
    assert source.send(time_s=1.75).fault is FaultCode.STALE
    source.now = 2.0
    source.send(now=2.0, time_s=1.75)
    assert source.monitor.overdue(2.25).fault is FaultCode.STALE
    assert source.send(epoch=8, now=2.25).fault is FaultCode.LINK


def test_what_tripped_is_told_in_milliseconds(source: Source) -> None:
    assert source.monitor.overdue(source.now + 0.05).text == "no sample for 50.0 ms, limit 20 ms"
    assert source.send(epoch=8).text == "two sources publish samples: epoch 0x8, and 0x7 2.0 ms ago"
    assert "102.0 ms between two samples, limit 20 ms" in source.send(time_s=(source.seq - 1) * TICK + 0.102).text
    source.now += 0.5
    assert source.send(epoch=8).text.endswith("silent for 502.0 ms")


def test_the_hard_maxima_themselves_and_two_samples_are_allowed() -> None:
    source = Source(replace(LIMITS, force_ceiling_n=50.0, torque_ceiling_nm=10.0, stuck_samples=2))
    assert source.monitor.force_n == 0.0
    assert source.send([1, 0, 0, 0, 0, 0], seq=0).fault is None
    assert source.send([1, 0, 0, 0, 0, 0]).fault is FaultCode.SENSOR_STUCK


@pytest.mark.parametrize("number", [1.1e6, -1e200])
def test_numbers_that_no_cell_measures_are_invalid(source: Source, number: float) -> None:
    assert source.send([0.0, 0.0, 0.0, 0.0, number, 0.0]).fault is FaultCode.SENSOR_INVALID
    motion = np.zeros(12)
    motion[7] = number
    assert source.send(motion=motion).fault is FaultCode.SENSOR_INVALID


def test_a_clock_that_stands_is_stale(source: Source) -> None:
    stamp = source.seq * TICK
    assert [source.send(time_s=stamp).fault for _ in range(3)] == [None, None, FaultCode.STALE]


def test_a_clock_that_was_set_back_once_is_no_fault(source: Source) -> None:
    assert [source.send(time_s=(source.seq + 1) * TICK - 5.0).fault for _ in range(20)] == [None] * 20
