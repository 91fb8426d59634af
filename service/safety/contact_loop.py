"""Judges a compliance law by its behaviour: does it swing, in free air or against the stiffest contact?

An axis of the arm is one mass on its position loop's spring and damper. It follows the law's reference, touches a
spring and a damper that stay in contact, and carries a payload whose inertia the sensor feels too. The sensor is late
by whole ticks. The loop is linear and discrete, so the eigenvalues z of its transition over one tick give frequency and
damping ratio exactly: s = ln z / tick, damping ratio -Re s / |s|. The law's own step is that of
`sim_backend/world/compliance.py`; mass, stiffness and damping are those of the simulated UR3e vertically, its stiffest
direction, and about the TCP. `docs/explanation/force-overshoot.md` compares the model with the simulated world.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from math import sqrt

import numpy as np

from wire.arrays import FloatArray
from wire.impact import ARM_KG, ARM_N_M, free_damping_ratio
from wire.law import ComplianceLaw
from wire.records import TICK_S
from wire.task import SENSOR_DELAY_TICKS

CONTACT_DAMPING_RATIO = 0.1
"""Smallest damping ratio of the loop through a contact; in the simulated world, the border between swing and rest."""
FREE_DAMPING_RATIO = 0.4
"""Smallest damping ratio of the law without contact: a step of its target overshoots by a quarter at most."""
PAYLOAD_KG = 0.93
"""Mass beyond the sensor: the simulated gripper and peg."""
AXES = ("x", "y", "z", "about x", "about y", "about z")


@dataclass(frozen=True, slots=True)
class Follower:
    """One axis of an arm that follows its reference; its position loop is critically damped.

    Attributes:
        mass: mass or inertia at the TCP, kg or kg·m².
        stiffness: stiffness of the position loop at the TCP, N/m or N·m/rad.
        payload: mass or inertia beyond the sensor, kg or kg·m².
        stiffest_contact: stiffness of the stiffest contact, N/m or N·m/rad.
        unit: unit of the stiffness.
    """

    mass: float
    stiffness: float
    payload: float
    stiffest_contact: float
    unit: str

    @property
    def damping(self) -> float:
        """Damping of the position loop, N·s/m or N·m·s/rad."""
        return 2.0 * sqrt(self.stiffness * self.mass)


SHIFT = Follower(ARM_KG, ARM_N_M, PAYLOAD_KG, 1e6, "N/m")
TILT = Follower(0.041, 800.0, 0.0175, 50.0, "N·m/rad")
TURN = Follower(0.020, 650.0, 0.0007, 50.0, "N·m/rad")
FOLLOWERS = (SHIFT, SHIFT, SHIFT, TILT, TILT, TURN)
"""Followers of the law's six axes. A contact turns the tool with its stiffness times the square of its lever: 150 kN/m
at 18 mm from the tip."""


@dataclass(frozen=True, slots=True)
class Swing:
    """The least damped oscillation of one axis in contact.

    Attributes:
        damping_ratio: damping ratio; below zero it grows.
        frequency_hz: frequency, Hz.
        contact: stiffness of the contact, N/m or N·m/rad.
        delay_s: delay of the sensor, s.
    """

    damping_ratio: float
    frequency_hz: float
    contact: float
    delay_s: float


@lru_cache(maxsize=64)
def swing(
    stiffness: float, damping: float, inertia: float, follower: Follower, payload_kg: float = PAYLOAD_KG
) -> Swing:
    """Return the least damped oscillation of one axis over all contacts and all delays of the sensor.

    Args:
        stiffness: of the law, N/m or N·m/rad.
        damping: of the law, N·s/m or N·m·s/rad.
        inertia: of the law, kg or kg·m².
        follower: the axis of the arm.
        payload_kg: mass beyond the sensor; a payload's inertia grows with it.
    """
    contacts = np.concatenate(([0.0], follower.stiffest_contact * np.geomspace(1e-4, 1.0, 33)))
    payload = follower.payload * payload_kg / PAYLOAD_KG
    found: list[Swing] = []
    for delay in range(SENSOR_DELAY_TICKS[0], SENSOR_DELAY_TICKS[1] + 1):
        steps = _transitions(stiffness, damping, inertia, follower, payload, contacts, delay)
        roots = np.linalg.eigvals(steps).astype(np.complex128)
        # A root on the negative real axis alternates from tick to tick: it belongs to the sampling, not to a swing
        real = (np.abs(roots) < 1e-3) | (np.abs(np.angle(roots)) > 0.9 * np.pi)
        rates = np.log(np.where(real, 1e-3, roots)) / TICK_S
        ratios = -rates.real / np.abs(rates)
        at = np.unravel_index(int(np.argmin(ratios)), ratios.shape)
        found.append(
            Swing(
                damping_ratio=float(ratios[at]),
                frequency_hz=float(np.abs(rates[at].imag)) / (2.0 * np.pi),
                contact=float(contacts[at[0]]),
                delay_s=delay * TICK_S,
            )
        )
    return min(found, key=lambda one: one.damping_ratio)


def why_not_law(law: ComplianceLaw, payload_kg: float = PAYLOAD_KG) -> Iterator[str]:
    """Yield a sentence for every axis on which a law would swing; the sentence has the damping ratio.

    Args:
        law: the law.
        payload_kg: mass beyond the sensor.
    """
    axes = zip(AXES, law.stiffness, law.damping, law.inertia, FOLLOWERS, strict=True)
    for axis, stiffness, damping, inertia, follower in axes:
        free = free_damping_ratio(stiffness, damping, inertia)
        if free < FREE_DAMPING_RATIO:
            yield (
                f"compliance {axis} swings in free air: damping ratio {free:.2f}, at least {FREE_DAMPING_RATIO:g} is "
                "required; raise damping, or lower stiffness or inertia"
            )
            continue
        found = swing(stiffness, damping, inertia, follower, payload_kg)
        if found.damping_ratio < CONTACT_DAMPING_RATIO:
            where = f"on a contact of {found.contact:.3g} {follower.unit}" if found.contact else "in free air"
            yield (
                f"compliance {axis} swings {where} at {found.frequency_hz:.0f} Hz with a sensor delay of "
                f"{found.delay_s * 1e3:g} ms: damping ratio {found.damping_ratio:.2f}, at least "
                f"{CONTACT_DAMPING_RATIO:g} is required; raise damping or inertia"
            )


def _transitions(
    stiffness: float,
    damping: float,
    inertia: float,
    follower: Follower,
    payload: float,
    contacts: FloatArray,
    delay: int,
) -> FloatArray:
    """Return the transition over one tick, (k, n, n), for each contact of `contacts` (k,).

    The state is the reference and its rate, the arm and its rate, and the readings on their way, newest first.
    """
    size = 4 + delay
    reference, rate, arm, speed = np.eye(size)[:4]
    reading = np.eye(size)[-1]
    # The law's step, semi-implicit
    rate = (inertia * rate + TICK_S * (reading - stiffness * reference)) / (
        inertia + TICK_S * (damping + TICK_S * stiffness)
    )
    reference = reference + TICK_S * rate
    # The arm's step, implicit in its dampers, for all contacts at once
    contact = contacts[:, None]
    contact_damping = 2.0 * np.sqrt(contact * follower.mass)
    pull = follower.stiffness * (reference - arm) + follower.damping * (rate - speed)
    push = -contact * arm - contact_damping * speed
    acceleration = (pull + push) / (follower.mass + TICK_S * (follower.damping + contact_damping))
    after = speed + TICK_S * acceleration
    felt = -contact * arm - contact_damping * after - payload * acceleration
    steps = np.zeros((len(contacts), size, size))
    steps[:, 0], steps[:, 1] = reference, rate
    steps[:, 2], steps[:, 3], steps[:, 4] = arm + TICK_S * after, after, felt
    for place in range(5, size):
        steps[:, place, place - 1] = 1.0
    return steps
