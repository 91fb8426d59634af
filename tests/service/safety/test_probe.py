from collections.abc import Callable
from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest

from service.safety.probe import RETURNED_M, Answer, Probe, ProbeParameters

STIFFNESS_N_M = 2500.0
PARAMETERS = ProbeParameters(
    sink_m=2e-3, proven_m=2.5e-3, clearance_m=1e-3, held_n=4.0, step_m=2e-4, lead_m=(2.4e-3, 3e-3), patience=250
)
START = np.array([0.3, -0.1, 0.07])
Surroundings = Callable[[np.ndarray], np.ndarray]
"""Where the tip comes to stand, (3,) m, for a target."""


def walls(low_mm: float, high_mm: float, top_mm: float = inf, floor_mm: float = -inf) -> Surroundings:
    """Walls on both sides of the start, up to a height above it, and a floor."""

    def stand(target: np.ndarray) -> np.ndarray:
        tip = target.copy()
        tip[2] = max(tip[2], START[2] + 1e-3 * floor_mm)
        if target[2] < START[2] + 1e-3 * top_mm:
            tip[0] = np.clip(tip[0], START[0] + 1e-3 * low_mm, START[0] + 1e-3 * high_mm)
        return tip

    return stand


def ask(stand: Surroundings, parameters: ProbeParameters = PARAMETERS, bias_n: float = 0.0) -> tuple[Answer, Probe]:
    """Probe with an arm that is a spring between tip and target."""
    probe, answer = Probe(parameters, START, 0.2), Answer.UNDER_WAY
    while answer is Answer.UNDER_WAY:
        tip = stand(probe.target)
        answer = probe.advance(tip, STIFFNESS_N_M * (tip - probe.target) + np.array([bias_n, 0.0, 0.0]))
        leads = np.abs(probe.target - stand(probe.target))
        assert (leads[[0, 2]] <= np.array(parameters.lead_m) + parameters.step_m + 1e-12).all()
    return answer, probe


@pytest.mark.parametrize("bias_n", [-1.5, 0.0, 1.5])
@pytest.mark.parametrize(("low_mm", "high_mm"), [(-0.1, 0.1), (-3.0, 0.0), (0.0, 3.0), (-1.5, 1.5)])
def test_a_tip_between_two_walls_is_held_and_put_back(low_mm: float, high_mm: float, bias_n: float) -> None:
    answer, probe = ask(walls(low_mm, high_mm), bias_n=bias_n)
    assert answer is Answer.HELD
    assert np.linalg.norm(probe.target - START) <= RETURNED_M
    assert probe.yaw == 0.2
    assert 4.0 <= probe.force_n < 6.0, "gently"


@pytest.mark.parametrize(
    ("low_mm", "high_mm"), [(-inf, inf), (-inf, 0.5), (-0.5, inf), (-7.0, 0.0), (-4.0, 4.0)], ids=str
)
def test_a_tip_with_a_free_side_or_in_too_wide_a_gap_is_free(low_mm: float, high_mm: float) -> None:
    answer, probe = ask(walls(low_mm, high_mm))
    assert answer is Answer.FREE
    assert "nothing holds it within 6.0 mm" in probe.text


def test_a_tip_that_is_not_as_deep_as_is_to_be_proven_is_free() -> None:
    assert ask(walls(-1.0, 1.0, top_mm=0.4))[0] is Answer.FREE
    assert ask(walls(-1.0, 1.0, top_mm=1.0))[0] is Answer.HELD


def test_a_floor_ends_the_way_down_gently_and_depth_counts_from_there() -> None:
    assert ask(walls(-1.0, 1.0, top_mm=1.9, floor_mm=-0.5))[0] is Answer.FREE
    answer, probe = ask(walls(-1.0, 1.0, top_mm=2.6, floor_mm=-0.5))
    assert answer is Answer.HELD
    assert np.linalg.norm(probe.target - START) <= RETURNED_M


@pytest.mark.parametrize("sink", [False, True])
def test_a_tip_that_does_not_move_is_stuck_and_pulled_no_harder_than_the_lead(sink: bool) -> None:
    leads: list[float] = []

    def wedged(target: np.ndarray) -> np.ndarray:
        stays = START.copy()
        if sink:
            stays[2] = min(START[2], target[2])
        leads.append(float(target[2] - stays[2]))
        return stays

    lowest = START[2]

    def sunk(target: np.ndarray) -> np.ndarray:
        nonlocal lowest
        lowest = min(lowest, float(target[2]))
        leads.append(float(target[2] - lowest))
        return np.array([*START[:2], lowest])

    answer, probe = ask(sunk if sink else wedged)
    assert answer is Answer.STUCK
    assert np.abs(leads).max() <= PARAMETERS.lead_m[1] + 1e-12
    assert probe.text == "drawn up, it does not come"


def test_a_sensor_that_feels_nothing_ends_the_probe_at_the_largest_lead() -> None:
    probe, answer, leads = Probe(PARAMETERS, START, 0.0), Answer.UNDER_WAY, []
    stand = walls(-0.5, 0.5)
    while answer is Answer.UNDER_WAY:
        tip = stand(probe.target)
        answer = probe.advance(tip, np.zeros(3))
        leads.append(abs(float(probe.target[0] - stand(probe.target)[0])))
    assert answer is Answer.STUCK
    assert max(leads) <= PARAMETERS.lead_m[0] + 1e-12


def test_a_tip_that_was_held_and_does_not_come_back_is_held_nevertheless_and_pulled_gently() -> None:
    felt: list[float] = []
    floor_m = -inf

    def rising_floor(target: np.ndarray) -> np.ndarray:
        nonlocal floor_m
        tip = walls(-0.5, 0.5)(target)
        floor_m = max(floor_m, tip[2]) if len(felt) > 60 else floor_m
        tip[2] = max(tip[2], floor_m)
        felt.append(float(np.linalg.norm(target - tip)))
        return tip

    assert ask(rising_floor, replace(PARAMETERS, sink_m=1e-4, proven_m=4e-3))[0] is Answer.HELD
    assert max(felt) <= max(PARAMETERS.lead_m) + PARAMETERS.step_m + 1e-12


def test_a_leg_has_as_many_calls_as_its_patience() -> None:
    probe = Probe(PARAMETERS, START, 0.0)
    answers = [probe.advance(START, np.zeros(3)) for _ in range(PARAMETERS.patience + 1)]
    assert answers == [Answer.UNDER_WAY] * PARAMETERS.patience + [Answer.STUCK]


def test_every_leg_has_its_own_patience() -> None:
    probe = Probe(PARAMETERS, START, 0.0)
    assert probe.advance(START, np.array([0.0, 0.0, PARAMETERS.held_n])) is Answer.UNDER_WAY, "on a floor: now up"
    answers = [probe.advance(START, np.zeros(3)) for _ in range(PARAMETERS.patience + 1)]
    assert answers == [Answer.UNDER_WAY] * PARAMETERS.patience + [Answer.STUCK]
    assert probe.target[2] == pytest.approx(START[2] + PARAMETERS.lead_m[1])


@pytest.mark.parametrize(("stand", "bias_n"), [(walls(-0.5, inf), -5.0), (walls(-inf, 0.5), 5.0)])
def test_a_force_that_rests_on_the_tip_is_no_wall(stand: Surroundings, bias_n: float) -> None:
    assert ask(stand, bias_n=bias_n)[0] is Answer.FREE


def test_a_tip_that_is_back_ends_the_probe_before_its_patience_ends() -> None:
    answer, probe = ask(walls(-0.5, 0.5), replace(PARAMETERS, patience=1_000_000))
    assert answer is Answer.HELD
    assert np.linalg.norm(probe.target - START) <= RETURNED_M


def test_a_tip_that_meets_nothing_has_felt_nothing() -> None:
    answer, probe = ask(walls(-inf, inf))
    assert answer is Answer.FREE
    assert probe.force_n == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("field", ["sink_m", "proven_m", "clearance_m", "held_n", "step_m", "patience"])
@pytest.mark.parametrize("bad", [0.0, -1.0, nan, inf])
def test_a_probe_that_proves_nothing_is_refused(field: str, bad: float) -> None:
    with pytest.raises(ValueError, match=rf"probe\.{field}"):
        replace(PARAMETERS, **{field: bad})


@pytest.mark.parametrize("bad", [(0.0, 1e-3), (1e-3, nan)])
def test_a_probe_leads_by_something(bad: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match=r"probe\.lead_m"):
        replace(PARAMETERS, lead_m=bad)
