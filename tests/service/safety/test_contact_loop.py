"""A law is judged by whether it swings: in closed form without contact, by its loop's roots with one."""

from dataclasses import replace
from math import pi, sqrt

import numpy as np
import pytest

from service.safety.contact_loop import (
    CONTACT_DAMPING_RATIO,
    SHIFT,
    TILT,
    TURN,
    Follower,
    free_damping_ratio,
    swing,
    why_not_law,
)
from wire.law import ComplianceLaw
from wire.records import TICK_S

LAW = ComplianceLaw(
    stiffness=(2500.0, 2500.0, 3000.0, 5.0, 5.0, 8.0),
    damping=(380.0, 380.0, 650.0, 1.0, 1.0, 0.5),
    inertia=(2.5, 2.5, 2.5, 0.06, 0.06, 0.03),
)


@pytest.fixture(autouse=True)
def _nothing_remembered() -> None:
    """Every test computes its swings itself: a remembered one would hide a change of the code."""
    swing.cache_clear()


def vertically(*, damping: float, inertia: float) -> ComplianceLaw:
    return replace(LAW, damping=(380.0, 380.0, damping, 1.0, 1.0, 0.5), inertia=(2.5, 2.5, inertia, 0.06, 0.06, 0.03))


def test_without_contact_the_damping_ratio_is_that_of_a_mass_on_a_spring() -> None:
    assert free_damping_ratio(3000.0, 2.0 * sqrt(3000.0 * 2.5), 2.5) == pytest.approx(1.0)
    assert free_damping_ratio(3000.0, 60.0, 10.0) == pytest.approx(0.173, abs=1e-3)


def test_a_stiff_arm_without_payload_swings_as_the_law_alone_does() -> None:
    """An arm that follows at once, in air: the root of the whole loop is the law's own."""
    at_once = Follower(mass=1e-3, stiffness=1e5, payload=0.0, stiffest_contact=1e-9, unit="N/m")
    found = swing(3000.0, 60.0, 10.0, at_once)
    assert found.damping_ratio == pytest.approx(free_damping_ratio(3000.0, 60.0, 10.0), abs=0.02)
    assert 2.0 * pi * found.frequency_hz == pytest.approx(sqrt(3000.0 / 10.0), rel=0.03)


def test_a_law_in_air_is_stepped_semi_implicitly() -> None:
    """The spring counts at the end of the step: the roots are those of the law's two equations alone."""
    stiffness, damping, inertia, tick = 2e5, 100.0, 1.0, TICK_S
    at_once = Follower(mass=1e-6, stiffness=1e9, payload=0.0, stiffest_contact=1e-9, unit="N/m")
    whole = inertia + tick * (damping + tick * stiffness)
    rate = np.array([-tick * stiffness, inertia]) / whole
    roots = np.linalg.eigvals(np.array([[1.0 + tick * rate[0], tick * rate[1]], rate]))
    exponent = np.log(roots[0].astype(complex)) / tick
    assert swing(stiffness, damping, inertia, at_once).damping_ratio == pytest.approx(
        -exponent.real / abs(exponent), abs=1e-3
    )


@pytest.mark.parametrize(("damping", "inertia"), [(60.0, 0.5), (60.0, 0.6), (250.0, 2.5), (400.0, 0.5)])
def test_68_a_law_that_swings_on_a_stiff_contact_is_named_with_its_damping_ratio(
    damping: float, inertia: float
) -> None:
    (reason,) = why_not_law(vertically(damping=damping, inertia=inertia))
    found = swing(3000.0, damping, inertia, SHIFT)
    assert found.damping_ratio < CONTACT_DAMPING_RATIO
    assert reason.startswith("compliance z swings on a contact of 1e+06 N/m at ")
    assert f"damping ratio {found.damping_ratio:.2f}, at least 0.1 is required" in reason


def test_68_a_heavy_law_with_little_damping_is_named_with_its_damping_ratio_in_free_air() -> None:
    (reason,) = why_not_law(vertically(damping=60.0, inertia=10.0))
    assert reason == (
        "compliance z swings in free air: damping ratio 0.17, at least 0.4 is required; raise damping, or lower "
        "stiffness or inertia"
    )


def test_68_every_axis_is_judged() -> None:
    swings = ComplianceLaw((3000.0,) * 3 + (100.0,) * 3, (60.0,) * 3 + (0.1,) * 3, (0.5,) * 3 + (0.01, 0.01, 0.005))
    reasons = list(why_not_law(swings))
    axes = ("x", "y", "z", "about x", "about y", "about z")
    assert [reason.split(" swings")[0] for reason in reasons] == [f"compliance {axis}" for axis in axes]


def test_more_damping_damps_more_and_a_light_law_swings_at_a_higher_frequency() -> None:
    ratios = [swing(3000.0, damping, 2.5, SHIFT).damping_ratio for damping in (60.0, 200.0, 400.0, 650.0)]
    assert (np.diff(ratios) > 0.02).all()
    assert swing(3000.0, 200.0, 0.5, SHIFT).frequency_hz > swing(3000.0, 200.0, 2.5, SHIFT).frequency_hz + 5.0


def test_the_worst_case_is_the_stiffest_contact_with_the_latest_sensor() -> None:
    found = swing(3000.0, 250.0, 2.5, SHIFT)
    assert (found.contact, found.delay_s) == (1e6, 0.008)
    assert 0.05 < found.damping_ratio < CONTACT_DAMPING_RATIO


@pytest.mark.parametrize(("follower", "damping"), [(TILT, 0.05), (TURN, 0.1)])
def test_a_turn_swings_too(follower: Follower, damping: float) -> None:
    assert swing(5.0, damping, 0.01, follower).damping_ratio < 0.0
    assert swing(5.0, 1.0, 0.06, follower).damping_ratio > CONTACT_DAMPING_RATIO


def test_a_payload_heavier_than_the_virtual_mass_makes_the_law_swing_in_free_air() -> None:
    assert list(why_not_law(LAW)) == []
    reasons = list(why_not_law(LAW, payload_kg=6.0))
    assert any(" swings in free air at " in reason for reason in reasons)
