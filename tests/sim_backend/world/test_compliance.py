"""The law against its closed forms."""

import numpy as np
import pytest

from sim_backend.world import quaternion
from sim_backend.world.compliance import Law, Reference, advance
from wire.records import TICK_S

STIFFNESS = np.array([2500.0, 2500.0, 3000.0, 5.0, 5.0, 8.0])
DAMPING = np.array([320.0, 320.0, 400.0, 1.0, 1.0, 0.5])
INERTIA = np.array([2.5, 2.5, 2.5, 0.06, 0.06, 0.03])
DOWN = quaternion.from_rotvec(np.array([[np.pi, 0.0, 0.0]]))


def at_rest(n=1):
    return Reference(np.zeros((n, 3)), np.tile(DOWN, (n, 1)), np.zeros((n, 6)))


def law(stiffness=STIFFNESS, damping=DAMPING, inertia=INERTIA, max_speed=(10.0, 100.0), n=1):
    return Law(*(np.tile(np.asarray(v, float), (n, 1)) for v in (stiffness, damping, inertia, max_speed)))


def run(the_law, reference, ticks, wrench, position=None, orientation=None):
    """Deflection (ticks, 6) of the first arm from rest at the origin, tool down."""
    n = len(reference.position)
    position = np.zeros((n, 3)) if position is None else position
    orientation = np.tile(DOWN, (n, 1)) if orientation is None else orientation
    seen = np.zeros((ticks, 6))
    for tick in range(ticks):
        advance(the_law, reference, position, orientation, np.broadcast_to(wrench, (n, 6)))
        seen[tick] = np.concatenate([reference.position, quaternion.between(DOWN, reference.quaternion[:1])], 1)[0]
    return seen


def closed_form(time, stiffness, damping, inertia):
    """Unit step response of an overdamped or underdamped second-order system."""
    decay = damping / (2 * inertia)
    root = np.sqrt(complex(decay**2 - stiffness / inertia))
    a, b = -decay + root, -decay - root
    return np.real(1 - (b * np.exp(a * time) - a * np.exp(b * time)) / (b - a))


@pytest.mark.parametrize("axis", range(6))
def test_a_step_of_force_answers_as_the_differential_equation_does(axis):
    wrench = np.zeros(6)
    wrench[axis] = 0.02 * STIFFNESS[axis]
    seen = run(law(), at_rest(), 1000, wrench)[:, axis]
    time = TICK_S * np.arange(1, 1001)
    expected = 0.02 * closed_form(time, STIFFNESS[axis], DAMPING[axis], INERTIA[axis])
    # first order in the tick: a step lags by a part of a tick and is damped a little more
    assert seen == pytest.approx(expected, abs=0.02 * 0.05)


def test_the_error_of_a_step_shrinks_with_the_tick(monkeypatch):
    worst = []
    for tick in (TICK_S, TICK_S / 4):
        monkeypatch.setattr("sim_backend.world.compliance.TICK_S", tick)
        ticks = round(0.4 / tick)
        seen = run(law(), at_rest(), ticks, [25.0, 0, 0, 0, 0, 0])[:, 0]
        worst.append(np.abs(seen - 0.01 * closed_form(tick * np.arange(1, ticks + 1), 2500.0, 320.0, 2.5)).max())
    assert worst[1] < 0.3 * worst[0]


def test_a_constant_wrench_ends_in_force_over_stiffness():
    wrench = np.array([10.0, -5.0, 12.0, 0.2, -0.1, 0.3])
    seen = run(law(), at_rest(), 5000, wrench)[-1]
    # the spring turns about the base axes by the rotation vector of the whole turn
    assert seen[:3] == pytest.approx(wrench[:3] / STIFFNESS[:3], rel=1e-9)
    assert seen[3:] == pytest.approx(wrench[3:] / STIFFNESS[3:], rel=1e-9)


def test_a_moment_about_the_tip_turns_the_tool_and_leaves_the_tip_where_it_is():
    reference = at_rest()
    seen = run(law(), reference, 2000, [0, 0, 0, 0.5, -0.3, 0.4])
    assert np.abs(seen[-1, 3:]).min() > 0.04
    assert (seen[:, :3] == 0.0).all()


def test_a_force_at_the_tip_moves_it_and_does_not_turn_the_tool():
    seen = run(law(), at_rest(), 2000, [8.0, -6.0, 10.0, 0.0, 0.0, 0.0])
    assert seen[:, 3:] == pytest.approx(np.zeros((2000, 3)), abs=1e-12)


def test_without_a_wrench_the_reference_comes_to_the_target_and_stays():
    target = np.array([[0.01, -0.02, 0.03]])
    turned = quaternion.from_rotvec(np.array([[2.9, 0.4, -0.2]]))
    reference = at_rest()
    run(law(), reference, 5000, np.zeros(6), target, turned)
    assert reference.position == pytest.approx(target, abs=1e-9)
    assert quaternion.between(reference.quaternion, turned) == pytest.approx(np.zeros((1, 3)), abs=1e-9)
    assert reference.twist == pytest.approx(np.zeros((1, 6)), abs=1e-8)


def test_the_speed_limit_holds_for_the_resultant_and_keeps_the_direction():
    reference = at_rest()
    the_law = law(stiffness=[1e5] * 6, damping=[10.0] * 6, max_speed=(0.05, 0.5))
    turned = quaternion.from_rotvec(np.array([[np.pi - 0.5, 0.0, 0.0]]))
    for _ in range(20):
        before = reference.position.copy()
        advance(the_law, reference, np.array([[0.3, 0.4, 0.0]]), turned, np.zeros((1, 6)))
        moved = reference.position - before
        assert np.linalg.norm(moved) <= 0.05 * TICK_S * (1 + 1e-12)
        assert np.linalg.norm(reference.twist[:, 3:]) <= 0.5 * (1 + 1e-12)
        assert moved[0, 1] == pytest.approx(moved[0, 0] * 4 / 3)
    assert np.linalg.norm(reference.twist[:, :3]) == pytest.approx(0.05)


@pytest.mark.parametrize("stiffness", [0.0, 1.0, 1e3, 1e6])
@pytest.mark.parametrize("damping", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("inertia", [1e-6, 1.0, 1e3])
def test_no_parameters_make_the_law_unstable_by_itself(stiffness, damping, inertia):
    reference = at_rest()
    everything = law([stiffness] * 6, [damping] * 6, [inertia] * 6, (1e9, 1e9))
    target = np.array([[0.01, 0.0, 0.0]])
    seen = run(everything, reference, 3000, np.zeros(6), target)
    assert np.abs(seen[:, 0]).max() <= 0.02 + 1e-9


def test_arms_do_not_see_each_other():
    rng = np.random.default_rng(1)
    wrench = rng.normal(0, 5, (4, 6))
    together = at_rest(4)
    everything = law(n=4)
    for _ in range(50):
        advance(everything, together, np.zeros((4, 3)), np.tile(DOWN, (4, 1)), wrench)
    for i in range(4):
        alone = at_rest()
        for _ in range(50):
            advance(law(), alone, np.zeros((1, 3)), DOWN, wrench[i : i + 1])
        assert (alone.position[0] == together.position[i]).all()
        assert (alone.quaternion[0] == together.quaternion[i]).all()
