"""Bounds the true force of an unexpected touch, and the speed at which a part bears it.

Three momenta meet a contact before the law can yield: the arm's own, the way that it goes on while the sensor is late,
and the law's virtual mass. Each adds a force in proportion to the speed v:

    blow = v (√(c m) + k T + √(k M)),     1/k = 1/c + 1/a

c: stiffness of the contact; m and a: mass and stiffness of the arm at the TCP; T: time from a force to the answer; M:
virtual mass. What pushes after the blow rises slowly enough for the ceiling: true force <= max(blow, ceiling + v k T).
`docs/explanation/force-overshoot.md` derives it and compares it with a sweep of the simulated world.
"""

from collections.abc import Sequence
from math import sqrt

from wire.law import ComplianceLaw
from wire.records import TICK_S
from wire.task import SENSOR_DELAY_TICKS

ARM_KG = 3.9
"""Mass of the simulated UR3e at the TCP vertically, where it is largest, kg."""
ARM_N_M = 17e3
"""Stiffness of the simulated UR3e at the TCP vertically, where it is largest, N/m."""
BLIND_S = (SENSOR_DELAY_TICKS[1] + 2) * TICK_S
"""Time from a force to the arm's answer, s: the longest delay of the sensor, the cell's tick and the arm's."""
CONTACT_N_M = 27e3
"""Stiffness of the simulated world's nominal contact, N/m: the arm's mass over the square of 12 ms."""
CALM_RATIO = 1.3
"""Damping ratio in free air from which a law strikes within the bound of its target's speed."""
LIVELY_SHARE = 0.45
"""Harder blow of a law below that ratio, as a share for each unit of ratio: it outruns its target and pushes on behind
its own blow. Measured: at most 1.37 times the bound at a ratio of 0.4, 1.07 times at 1.0."""
IMPACT_SHARE = 2.0
"""Momentary force that a part bears, as a multiple of its ceiling, unless its recipe says otherwise. ISO/TS 15066 has
the same ratio of transient to lasting contact."""


def blow_n(speed_m_s: float, inertia_kg: float, contact_n_m: float) -> float:
    """Return the bound of the first peak of the true force, N.

    Args:
        speed_m_s: speed at the touch.
        inertia_kg: virtual mass of the law.
        contact_n_m: stiffness of the contact.
    """
    return speed_m_s * _resistance(inertia_kg, contact_n_m)


def fastest_m_s(impact_n: float, inertia_kg: float, contact_n_m: float) -> float:
    """Return the speed at which the blow is `impact_n`, m/s; the other arguments are those of `blow_n`."""
    return impact_n / _resistance(inertia_kg, contact_n_m)


def peak_n(speed_m_s: float, inertia_kg: float, contact_n_m: float, ceiling_n: float) -> float:
    """Return the bound of the true force until the ceiling stops the arm, N; other arguments as for `blow_n`."""
    return max(blow_n(speed_m_s, inertia_kg, contact_n_m), ceiling_n + speed_m_s * _series(contact_n_m) * BLIND_S)


def free_damping_ratio(stiffness: float, damping: float, inertia: float) -> float:
    """Return the damping ratio of one axis of a law without contact: d / (2 √(k m))."""
    return damping / (2.0 * sqrt(stiffness * inertia))


def liveliness(law: ComplianceLaw, axes: Sequence[int] = (0, 1, 2)) -> float:
    """Return how much harder than the bound of its target's speed a lightly damped law may strike; 1 for a calm one."""
    ratio = min(free_damping_ratio(law.stiffness[axis], law.damping[axis], law.inertia[axis]) for axis in axes)
    return 1.0 + LIVELY_SHARE * max(0.0, CALM_RATIO - ratio)


def reached_m_s(speed_m_s: float, lead_m: float, law: ComplianceLaw, axes: Sequence[int] = (0, 1, 2)) -> float:
    """Return the speed that counts for the blow of an arm behind its target, m/s: `liveliness` is in it.

    Args:
        speed_m_s: speed of the target.
        lead_m: largest lead of the target; the law moves at most at stiffness times lead over damping.
        law: compliance law.
        axes: axes of the motion.
    """
    pulled = max(law.stiffness[axis] * lead_m / law.damping[axis] for axis in axes)
    return liveliness(law, axes) * min(speed_m_s, pulled)


def _series(contact_n_m: float) -> float:
    return 1.0 / (1.0 / contact_n_m + 1.0 / ARM_N_M)


def _resistance(inertia_kg: float, contact_n_m: float) -> float:
    series = _series(contact_n_m)
    return sqrt(contact_n_m * ARM_KG) + series * BLIND_S + sqrt(series * inertia_kg)
