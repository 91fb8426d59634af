"""The bound of an unexpected touch is a sum of three momenta, each in proportion to the speed."""

from dataclasses import replace
from math import sqrt

import pytest

from wire.impact import ARM_KG, ARM_N_M, BLIND_S, blow_n, fastest_m_s, liveliness, peak_n, reached_m_s
from wire.law import ComplianceLaw

LAW = ComplianceLaw((2500.0,) * 2 + (3000.0,) + (5.0,) * 3, (380.0,) * 2 + (650.0,) + (1.0,) * 3, (2.5,) * 6)


def test_a_blow_is_the_sum_of_the_arms_momentum_the_late_answer_and_the_virtual_mass() -> None:
    series = 27e3 * ARM_N_M / (27e3 + ARM_N_M)
    expected = 0.05 * (sqrt(27e3 * ARM_KG) + series * BLIND_S + sqrt(series * 2.5))
    assert blow_n(0.05, 2.5, 27e3) == pytest.approx(expected)
    assert blow_n(0.1, 2.5, 27e3) == pytest.approx(2 * expected)


def test_the_fastest_speed_gives_the_blow_that_was_asked_for() -> None:
    assert blow_n(fastest_m_s(40.0, 2.5, 27e3), 2.5, 27e3) == pytest.approx(40.0)


def test_a_stiffer_contact_and_a_heavier_law_hit_harder() -> None:
    assert blow_n(0.05, 2.5, 108e3) > blow_n(0.05, 2.5, 27e3) < blow_n(0.05, 10.0, 27e3)


def test_a_slow_push_goes_beyond_the_ceiling_only_by_what_the_sensor_is_late() -> None:
    assert peak_n(0.01, 2.5, 27e3, 30.0) == pytest.approx(30.0 + 0.01 * 27e3 * ARM_N_M / (27e3 + ARM_N_M) * BLIND_S)
    assert peak_n(0.2, 2.5, 27e3, 30.0) == pytest.approx(blow_n(0.2, 2.5, 27e3))


def test_an_arm_on_a_leash_is_no_faster_than_its_law_pulls() -> None:
    assert reached_m_s(0.02, 0.012, LAW) == 0.02
    assert reached_m_s(0.25, 0.012, LAW) == pytest.approx(2500.0 * 0.012 / 380.0)


def test_a_law_that_is_damped_less_than_critically_counts_as_faster_than_its_target() -> None:
    assert liveliness(LAW) == 1.0
    lively = replace(LAW, damping=(2.0 * 0.5 * sqrt(2500.0 * 2.5), *LAW.damping[1:]))
    assert liveliness(lively) == pytest.approx(1.36)
    assert liveliness(lively, (2,)) == 1.0
    assert reached_m_s(0.02, 0.012, lively) == pytest.approx(1.36 * 0.02)
