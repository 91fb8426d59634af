"""The simulated arm against the model of the contact loop: a law inside the limit is calm, one outside swings."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from benchmarks.cases.force_overshoot import HEAVY
from benchmarks.stands.touching_arm import LEASH_M, Touch, touch
from service.safety.contact_loop import SHIFT, TILT, TURN, why_not_law
from sim_backend.world import kinematics, scene
from sim_backend.world.servo import gains
from sim_backend.world.world import World
from training.environment.design import LAW
from wire.impact import CONTACT_N_M, peak_n, reached_m_s
from wire.law import ComplianceLaw
from wire.limits import FORCE_CEILING_N

CALM_N = 0.75
"""Standard deviation of the true load that the sensor's noise alone causes, N; a swing causes more."""


def vertically(damping: float, inertia: float) -> ComplianceLaw:
    return replace(LAW, damping=(380.0, 380.0, damping, 1.0, 1.0, 0.5), inertia=(2.5, 2.5, inertia, 0.06, 0.06, 0.03))


def isotropic(stiffness: float, damping: float, inertia: float) -> ComplianceLaw:
    return replace(
        LAW,
        stiffness=(stiffness,) * 3 + LAW.stiffness[3:],
        damping=(damping,) * 3 + LAW.damping[3:],
        inertia=(inertia,) * 3 + LAW.inertia[3:],
    )


@pytest.mark.timeout(300)
def test_68_laws_just_inside_the_limit_stay_calm_on_stiff_contacts_and_laws_outside_swing() -> None:
    inside = [vertically(300.0, 2.5), vertically(650.0, 0.5), vertically(200.0, 10.0), LAW]
    outside = [vertically(150.0, 2.5), vertically(200.0, 0.5), vertically(60.0, 2.5)]
    assert not [reason for law in inside for reason in why_not_law(law)]
    assert all(tuple(why_not_law(law)) for law in outside)
    touches = [Touch(law, 0.03, "stiff", 4) for law in (*inside, *outside)]
    touched = touch(touches, "face", 2e-3)
    assert touched.engaged[: len(inside)].all()
    assert (touched.swing_n[: len(inside)] < CALM_N).all(), touched.swing_n
    swings = (touched.swing_n > CALM_N) | ~touched.engaged
    assert swings[len(inside) :].all(), touched.swing_n


@pytest.mark.timeout(300)
def test_the_true_force_of_a_touch_stays_within_its_bound() -> None:
    for conditions, contact_n_m, law, speed in (
        ("stiff", 4.0 * CONTACT_N_M, LAW, 0.04),
        ("standard", CONTACT_N_M, HEAVY, 0.15),
    ):
        (peak,) = touch([Touch(law, speed, conditions, 4)], "rim", 0.02, FORCE_CEILING_N, settle_s=0.3).peak_n
        bound = peak_n(reached_m_s(speed, LEASH_M, law), law.inertia[2], contact_n_m, FORCE_CEILING_N)
        assert 0.9 * bound < peak <= bound, "the bound holds, and is no wider than it must be"
        assert peak > FORCE_CEILING_N, "a ceiling alone bounds no blow"


@pytest.mark.timeout(300)
def test_a_lightly_damped_law_strikes_within_the_bound_too() -> None:
    laws = [isotropic(*numbers) for numbers in ((1500.0, 70.2, 5.0), (1200.0, 108.0, 5.0), (2500.0, 224.0, 5.0))]
    assert not [reason for law in laws for reason in why_not_law(law)], "all are admitted"
    peaks = touch([Touch(law, 0.09, "standard", 4) for law in laws], "face", 0.02, FORCE_CEILING_N, settle_s=0.3).peak_n
    bounds = [peak_n(reached_m_s(0.09, LEASH_M, law), 5.0, CONTACT_N_M, FORCE_CEILING_N) for law in laws]
    assert (peaks <= bounds).all(), (peaks, bounds)
    assert (peaks > peak_n(0.09, 5.0, CONTACT_N_M, FORCE_CEILING_N)).any(), "the speed of the target alone is no bound"


def test_the_followers_are_those_of_the_simulated_arm() -> None:
    world = World()
    world.place(np.array([0]), np.array([scene.NOMINAL_HOLE_M]), np.zeros(1))
    model, data = world.model(), world.data()
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    jacobian = kinematics.jacobian(world.joints, np.array([0.0, 0.0, scene.TCP_OFFSET_M]))[0]
    stiffness = 1.0 / np.diag(jacobian @ np.diag(1.0 / gains(model)[0]) @ jacobian.T)
    masses = 1.0 / np.diag(jacobian @ np.linalg.inv(mass[:6, :6]) @ jacobian.T)
    for axis, follower in ((2, SHIFT), (3, TILT), (5, TURN)):
        assert follower.stiffness == pytest.approx(stiffness[axis], rel=0.05)
        assert follower.mass == pytest.approx(masses[axis], rel=0.05)
    assert SHIFT.stiffness == pytest.approx(stiffness[:3].max(), rel=0.05), "the stiffest direction"
    assert SHIFT.payload == scene.PAYLOAD_KG
