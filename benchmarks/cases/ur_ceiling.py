"""Effect of the force ceiling on a UR controller: a peg pressed into the block, in simulated time."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.harness.result import Figure, Result, UnavailableError
from benchmarks.stands.pressed_arm import PressedArm
from benchmarks.stands.ur_cell import plan_first, shipped_ur_cell
from service.cell.plan import Plan
from service.config import CellConfig
from service.safety.stop import STANDSTILL_M_S
from wire.records import TICK_S
from wire.task import SENSOR_DELAY_TICKS, Task

GENTLE_M_S = 0.02
"""Speed of the sinking target: 60 N/s by the law's stiffness once the peg stands on the block."""
LONGEST_PRESS_TICKS = 2000
STOP_TICKS = 250
"""Ticks observed after the ceiling; a stop takes 50, and standstill must last."""
NO_CEILING_N = 1e3


class Press(NamedTuple):
    """One press up to the ceiling.

    Attributes:
        reaction: ticks from the first measurement at the ceiling to the first tick whose target velocity is below that
            of an arm without a ceiling.
        standstill: ticks from there to the first tick from which the TCP stands.
        peak_n: largest true force on the peg.
    """

    reaction: int
    standstill: int
    peak_n: float


def measure(scale: float) -> Result:
    """Measure; `scale` multiplies the 20 presses per row."""
    count = max(2, int(20 * scale))
    with shipped_ur_cell() as shipped:
        config, plan = shipped.config, plan_first(shipped.config)
    ceiling_n = plan.limits.force_ceiling_n
    least, most = SENSOR_DELAY_TICKS
    rows: list[tuple[str, ...]] = []
    worst: dict[float, float] = {}
    slowest = 0
    for speed_m_s in (GENTLE_M_S, config.limits.max_speed_m_s):
        for delay in range(least, most + 1):
            presses = [_press(config, plan, speed_m_s, Task(seed, sensor_delay_ticks=delay)) for seed in range(count)]
            peaks = [press.peak_n for press in presses]
            standstills = np.array([press.standstill for press in presses]) * TICK_S * 1e3
            reactions = [press.reaction for press in presses]
            worst[speed_m_s] = max(worst.get(speed_m_s, 0.0), *peaks)
            slowest = max(slowest, *reactions)
            rows.append(
                (
                    *(f"{speed_m_s * 1e3:.0f}", str(delay), str(count), _span(reactions)),
                    *(f"{np.median(standstills):.0f}", f"{standstills.max():.0f}"),
                    *(f"{np.median(peaks):.1f}", f"{max(peaks):.1f}", f"{max(peaks) - ceiling_n:+.1f}"),
                )
            )
    overshoots = " and ".join(
        f"{peak - ceiling_n:+.1f} N with targets at {speed * 1e3:.0f} mm/s" for speed, peak in worst.items()
    )
    return Result(
        question=f"What does the ceiling of {ceiling_n:g} N on the controller do to an arm that presses on?",
        columns=(
            *("targets mm/s", "sensor delay, ticks", "presses", "reaction, ticks", "standstill p50 ms"),
            *("standstill max ms", "peak true N p50", "peak true N max", "to the ceiling N"),
        ),
        rows=tuple(rows),
        finding=f"The target velocity falls at most {slowest} tick{'s' * (slowest > 1)} after a measurement at the "
        f"ceiling; the largest true force relative to it is {overshoots}.",
        figures=(
            Figure("reaction of the control program", float(slowest), "ticks", 1.0),
            Figure("true force over the ceiling, gentle", worst[GENTLE_M_S] - ceiling_n, "N", 3.0),
        ),
        method="Emulated controller in this process, tick by tick, and a host that lowers the target into the block "
        "beside the hole, one step every 100 ms. Reaction: from the first tick that measures the ceiling to the first "
        "whose target velocity is below that of the same arm without a ceiling. Standstill: from the same tick until "
        f"the TCP stays below {STANDSTILL_M_S * 1e3:g} mm/s. True force: contact force on the peg, without sensor.",
    )


def _press(config: CellConfig, plan: Plan, speed_m_s: float, task: Task) -> Press:
    """Press until the ceiling stops the arm, in parallel with an arm without a ceiling."""
    ceiling_n = plan.limits.force_ceiling_n
    unlimited = config.model_copy(update={"limits": config.limits.model_copy(update={"force_ceiling_n": NO_CEILING_N})})
    arm, other = PressedArm(config, plan, ceiling_n, task), PressedArm(unlimited, plan, NO_CEILING_N, task)
    peak_n = 0.0
    for _ in range(LONGEST_PRESS_TICKS):
        arm.press(speed_m_s)
        other.press(speed_m_s)
        peak_n = max(peak_n, arm.true_n)
        if arm.measured_n >= ceiling_n:
            break
    else:
        raise UnavailableError(f"the force never reached the ceiling of {ceiling_n:g} N: {task}")
    reaction = 0
    speeds: list[float] = []
    for tick in range(1, STOP_TICKS + 1):
        arm.press(speed_m_s)
        if reaction == 0:
            other.press(speed_m_s)
            if arm.target_speed_m_s < other.target_speed_m_s:
                reaction = tick
        peak_n = max(peak_n, arm.true_n)
        speeds.append(arm.speed_m_s)
    moving = np.flatnonzero(np.array(speeds) >= STANDSTILL_M_S)
    if reaction == 0 or (len(moving) and moving[-1] == STOP_TICKS - 1):
        raise UnavailableError(f"the arm did not come to rest after the ceiling: {task}")
    return Press(reaction, int(moving[-1]) + 2 if len(moving) else 1, peak_n)


def _span(counts: Sequence[int]) -> str:
    return f"{min(counts)}" if min(counts) == max(counts) else f"{min(counts)}-{max(counts)}"
