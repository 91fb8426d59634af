"""Stability of the force loop: press on the block at the shortest and the longest sensor delay, with scaled damping.

`python -m benchmarks.cases.contact_loop` prints the figures of `docs/explanation/decisions/0004-admittance.md`. It
measures no time.
"""

import itertools

import numpy as np

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


def press(damping_scale: float, delay_ticks: int) -> tuple[float, float]:
    """Descend onto the block beside the hole and keep pressing, as the lock does without contact.

    Returns:
        Standard deviation of the measured vertical force after settling, and the largest measured resultant, N.
    """
    seeds = itertools.islice((s for s in itertools.count() if draw(Task(s)).sensor_delay == delay_ticks), CELLS)
    world, cells = World(CELLS), np.arange(CELLS)
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


def main() -> None:
    """Print the table."""
    print(f"Sensor noise {FORCE_NOISE_N} N per sample; vertical damping at 1.0: {LAW.damping[2]:g} N·s/m.\n")
    print("| damping | sensor delay, ms | force, standard deviation, N | largest force, N |")
    print("|---|---|---|---|")
    for scale, delay in itertools.product((0.35, 0.6, 1.0), (1, 4)):
        deviation, peak = press(scale, delay)
        print(f"| {scale:g} | {delay * TICK_S * 1e3:g} | {deviation:.2f} | {peak:.1f} |")


if __name__ == "__main__":
    main()
