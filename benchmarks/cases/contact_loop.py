"""Stability of the force loop: press on the block at the shortest and the longest sensor delay, with scaled damping.

Its figures stand in `docs/explanation/decisions/0004-admittance.md`. It measures no time.
"""

import itertools

import numpy as np

from benchmarks.harness.result import Figure, Result
from service.safety.pose import rotvec_from_yaw
from sim_backend.world import quaternion
from sim_backend.world.conditions import FORCE_NOISE_N, draw
from sim_backend.world.world import World
from training.environment.design import LAW, LOCK
from wire.law import ControlLimits
from wire.limits import WORKSPACE_M
from wire.records import TICK_S
from wire.task import Task

CELLS = 16
STEPS, SETTLED_STEPS, STEP_TICKS = 60, 10, 50
BESIDE_HOLE_M = np.array([0.025, 0.015, 0.020])


def press(damping_scale: float, delay_ticks: int, count: int) -> tuple[float, float]:
    """Descend onto the block beside the hole and keep pressing, as the lock does without contact.

    Returns:
        Standard deviation of the measured vertical force after settling, and the largest measured resultant, N.
    """
    seeds = itertools.islice((s for s in itertools.count() if draw(Task(s)).sensor_delay == delay_ticks), count)
    world, cells = World(count), np.arange(count)
    world.reset(cells, [Task(seed) for seed in seeds])
    world.place(cells, world.hole_position + BESIDE_HOLE_M, world.hole_yaw.copy())
    world.zero_ft(cells)
    damping = damping_scale * np.array(LAW.damping)
    world.engage(cells, np.array(LAW.stiffness), damping, np.array(LAW.inertia), ControlLimits(WORKSPACE_M, 1e3))
    turn = quaternion.from_rotvec(rotvec_from_yaw(world.hole_yaw))
    wrenches: list[np.ndarray] = []
    for _ in range(STEPS):
        world.arm.set_target(cells, world.position - np.array([0.0, 0.0, LOCK.seek_step_m]), turn)
        for _ in range(STEP_TICKS):
            world.tick()
            wrenches.append(world.sensor.wrench.copy())
    force = np.array(wrenches)[:, :, :3]
    settled = force[-SETTLED_STEPS * STEP_TICKS :, :, 2]
    return float(settled.std(axis=0).mean()), float(np.sqrt((force**2).sum(-1)).max())


def measure(scale: float) -> Result:
    """Measure; `scale` multiplies the 16 cells of each row."""
    cells = max(2, round(CELLS * scale))
    rows: list[tuple[str, ...]] = []
    for damping, delay in itertools.product((0.35, 0.6, 1.0), (1, 4)):
        deviation, peak = press(damping, delay, cells)
        rows.append((f"{damping:g}", f"{delay * TICK_S * 1e3:g}", f"{deviation:.2f}", f"{peak:.1f}"))
    return Result(
        question="How stable is the force loop at the shortest and the longest delay of the sensor?",
        columns=("damping", "sensor delay, ms", "force, standard deviation, N", "largest force, N"),
        rows=tuple(rows),
        finding=f"At the trained damping and the longest delay the force deviates by {rows[-1][2]} N.",
        figures=(Figure("deviation at the longest delay", float(rows[-1][2]), "N", 2.0 * FORCE_NOISE_N),),
        method=f"{cells} cells press on the block beside the hole, as the lock does without contact. The noise of the "
        f"sensor is {FORCE_NOISE_N} N per sample. Damping 1.0 is {LAW.damping[2]:g} N·s/m vertically.",
    )
