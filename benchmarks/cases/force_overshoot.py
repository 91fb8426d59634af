"""Overshoot of the true force against its bound, by speed, stiffness and place of the contact, and delay of the sensor.

Its figures stand in `docs/explanation/force-overshoot.md`. It measures no time.
"""

import itertools
from dataclasses import replace

from benchmarks.harness.result import Figure, Result
from benchmarks.stands.touching_arm import LEASH_M, Contact, Touch, touch
from training.environment.design import LAW
from wire.impact import CONTACT_N_M, peak_n, reached_m_s
from wire.limits import FORCE_CEILING_N
from wire.records import TICK_S
from wire.task import Conditions

SPEEDS_M_S = (0.02, 0.04, 0.08, 0.15)
DELAYS_TICKS = (1, 4)
CONTACTS: tuple[Contact, ...] = ("face", "rim", "wall")
STIFFNESS: dict[Conditions, float] = {"standard": CONTACT_N_M, "stiff": 4.0 * CONTACT_N_M}
HEAVY = replace(LAW, damping=(650.0, 650.0, 400.0, 1.0, 1.0, 0.5), inertia=(10.0, 10.0, 10.0, 0.06, 0.06, 0.03))
LAWS = {"shipped": LAW, "heavy": HEAVY}
"""The shipped law, and one with four times its virtual mass and less damping vertically, which is admitted too."""
PRESS_M = 0.02


def measure(scale: float) -> Result:
    """Measure; a `scale` below 1 leaves out every second speed."""
    speeds = SPEEDS_M_S if scale >= 1.0 else SPEEDS_M_S[1::2]
    rows: list[tuple[str, ...]] = []
    largest = 0.0
    for contact, name in itertools.product(CONTACTS, LAWS):
        law = LAWS[name]
        cases = list(itertools.product(speeds, STIFFNESS, DELAYS_TICKS))
        touches = [Touch(law, speed, conditions, delay) for speed, conditions, delay in cases]
        peaks = touch(touches, contact, PRESS_M, FORCE_CEILING_N, settle_s=0.3).peak_n
        for (speed, conditions, delay), peak in zip(cases, peaks.tolist(), strict=True):
            reached = reached_m_s(speed, LEASH_M, law)
            bound = peak_n(reached, law.inertia[2], STIFFNESS[conditions], FORCE_CEILING_N)
            largest = max(largest, peak / bound)
            figures = f"{speed:g}", f"{STIFFNESS[conditions] / 1e3:.0f}", f"{delay * TICK_S * 1e3:g}"
            rows.append((contact, name, *figures, f"{peak:.1f}", f"{bound:.1f}", f"{peak / bound:.2f}"))
    return Result(
        question="How far does the true force go at an unexpected touch, and does the bound hold?",
        columns=(
            *("contact", "law", "speed of the target, m/s", "contact, kN/m", "sensor delay, ms"),
            *("largest true force, N", "bound, N", "share"),
        ),
        rows=tuple(rows),
        finding=f"The largest true force is {largest:.2f} of its bound.",
        figures=(Figure("largest true force to its bound", largest, "times", 1.0),),
        method=f"An arm moves into the block, its target {PRESS_M * 1e3:g} mm behind the surface, and stops by itself "
        f"at {FORCE_CEILING_N:g} N measured. The true force is that of the contact, every 2 ms for 0.2 s.",
    )
