from dataclasses import replace

import numpy as np
import pytest

from service.faults import FaultCode
from service.safety.verdict import Verdict
from service.safety.witness import Witness, WitnessParameters, check_rest
from wire.arrays import FloatArray

LIMITS = WitnessParameters(force_n=12.0, time_s=0.01, rest_force_n=6.0)
TICK_S = 0.002
OFFSET = np.array([1.0, -2.0, 0.5])


def judge(sensed: FloatArray, felt: FloatArray, ticks: int = 100, limits: WitnessParameters = LIMITS) -> list[Verdict]:
    """Judge constant forces (3,), N, for `ticks` samples, in which the joints are not quite still."""
    witness = Witness(limits, TICK_S, OFFSET)
    wrench = np.array([*sensed, 0.0, 0.0, 0.0])
    return [witness.check(wrench, np.asarray(felt) + OFFSET + 1e-6 * (tick % 2)) for tick in range(ticks)]


def test_a_sensor_and_joints_that_agree_within_the_joints_own_error_pass() -> None:
    assert all(verdict.fault is None for verdict in judge(np.array([3.0, 0.0, 25.0]), np.array([5.0, 4.0, 33.0])))


@pytest.mark.parametrize("sensed", [[0.0, 0.0, 0.0], [0.0, 0.0, -20.0], [0.0, 20.0, 0.0], [0.0, 0.0, 4.0]])
def test_66_67_a_force_that_only_the_joints_feel_or_feel_elsewhere_makes_the_sensor_invalid(
    sensed: list[float],
) -> None:
    verdict = judge(np.array(sensed), np.array([0.0, 0.0, 20.0]))[-1]
    assert verdict.fault is FaultCode.SENSOR_INVALID
    assert verdict.measured == pytest.approx(np.linalg.norm(np.array([0.0, 0.0, 20.0]) - sensed), rel=1e-3)
    assert verdict.limit == 12.0
    assert "the joints feel [0.0, 0.0, 20.0] N" in verdict.text


def test_the_limit_itself_trips_after_the_mean_has_reached_it() -> None:
    above = [verdict.fault for verdict in judge(np.zeros(3), np.array([0.0, 0.0, 12.01]))]
    assert above[10] is None, "a sensor that is a few ticks late is not a lie"
    assert above[-1] is FaultCode.SENSOR_INVALID
    assert judge(np.zeros(3), np.array([0.0, 0.0, 11.99]))[-1].fault is None


def test_the_mean_begins_at_agreement() -> None:
    share = TICK_S / (TICK_S + LIMITS.time_s)
    verdict = Witness(LIMITS, TICK_S, OFFSET).check(np.zeros(6), OFFSET + np.array([0.0, 0.0, 200.0]))
    assert verdict.measured == pytest.approx(200.0 * share, rel=1e-9)


def test_a_step_is_found_within_its_time_constant_and_a_spike_is_not() -> None:
    found = [verdict.fault for verdict in judge(np.zeros(3), np.array([40.0, 0.0, 0.0]))]
    assert found.index(FaultCode.SENSOR_INVALID) * TICK_S <= LIMITS.time_s
    witness = Witness(LIMITS, TICK_S, np.zeros(3))
    assert witness.check(np.zeros(6), np.array([60.0, 0.0, 0.0])).fault is None
    assert witness.check(np.zeros(6), np.zeros(3)).fault is None


@pytest.mark.parametrize("felt", [None, np.array([0.0, np.nan, 0.0]), np.array([np.inf, 0.0, 0.0])])
def test_joints_that_say_nothing_are_no_witness(felt: FloatArray | None) -> None:
    assert Witness(LIMITS, TICK_S, OFFSET).check(np.zeros(6), felt).fault is FaultCode.SENSOR_INVALID


def test_64_joints_that_do_not_change_by_a_bit_are_no_witness() -> None:
    witness = Witness(LIMITS, TICK_S, np.zeros(3))
    noise = np.random.default_rng(1).normal(0.0, 0.1, (100, 6))
    found = [witness.check(wrench, np.array([1.0, 0.0, 0.0])) for wrench in noise]
    assert [verdict.fault for verdict in found[:24]] == [None] * 24
    assert found[24].fault is FaultCode.SENSOR_STUCK
    assert found[24].measured == found[24].limit == 25
    assert "nothing checks the force/torque sensor" in found[24].text
    assert witness.check(noise[0], np.array([1.0, 1e-9, 0.0])).fault is None, "one bit is a sign of life"


def test_10_a_payload_that_weighs_more_than_the_configured_one_is_refused_with_the_residual_in_newtons() -> None:
    noise = np.random.default_rng(1).normal(0.0, 0.5, (100, 3))
    unzeroed = np.zeros((100, 6))
    assert check_rest(LIMITS, unzeroed, noise).fault is None
    heavy = check_rest(LIMITS, unzeroed, noise + np.array([0.0, 0.0, -9.5]))
    assert heavy.fault is FaultCode.CONTACT_AT_START
    assert heavy.measured == pytest.approx(9.5, abs=0.2)
    assert f"{heavy.measured:.1f} N in all, limit 6 N" in heavy.text
    assert check_rest(LIMITS, unzeroed, np.full((100, 3), np.nan)).fault is FaultCode.CONTACT_AT_START
    assert check_rest(LIMITS, unzeroed, np.tile([0.0, 6.0, 0.0], (100, 1))).fault is FaultCode.CONTACT_AT_START


@pytest.mark.parametrize("field", ["force_n", "time_s", "rest_force_n"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("inf"), float("nan")])
def test_limits_that_compare_nothing_are_refused_by_name(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"witness.{field}"):
        replace(LIMITS, **{field: value})
