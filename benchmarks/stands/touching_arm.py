"""Simulated arms, each under a law of its own, that move straight into the block and stay there."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np

from service.safety.pose import rotvec_from_yaw
from sim_backend.world import quaternion
from sim_backend.world.world import World
from wire.arrays import BoolArray, FloatArray
from wire.law import ComplianceLaw, ControlLimits
from wire.limits import MAX_STEP, WORKSPACE_M
from wire.records import TICK_S, Program
from wire.task import Conditions, Task

Contact = Literal["face", "rim", "wall"]
"""Face of the peg on the block; the peg half over the hole, on its rim; sideways onto a wall of the hole."""
LEASH_M = MAX_STEP[0]
TARGET_TICKS = 5
SETTLED_TICKS = 250
TOUCH_TICKS = 100
"""Ticks from the first touch in which the peak lies."""
_WAYS: dict[Contact, tuple[tuple[float, float, float], tuple[float, float, float], float]] = {
    "face": ((0.025, 0.015, 0.02), (0.0, 0.0, -1.0), 0.02),
    "rim": ((0.012, 0.006, 0.02), (0.0, 0.0, -1.0), 0.02),
    "wall": ((0.0, 0.0, -0.012), (1.0, 0.0, 0.0), 0.002),
}
"""Start relative to the hole's mouth, m; direction; distance to the contact, m."""


@dataclass(frozen=True, slots=True)
class Touch:
    """One touch to make.

    Attributes:
        law: compliance law.
        speed_m_s: speed of the target.
        conditions: `standard` has the nominal contact, `stiff` one of four times its stiffness.
        delay_ticks: delay of the sensor.
    """

    law: ComplianceLaw
    speed_m_s: float
    conditions: Conditions
    delay_ticks: int


@dataclass(frozen=True, slots=True)
class Touched:
    """Outcomes, (n,) each.

    Attributes:
        peak_n: largest true contact force within `TOUCH_TICKS` of the first touch.
        swing_n: standard deviation of the true load on the flange, in the last half second.
        engaged: whether the arm's program still runs.
    """

    peak_n: FloatArray
    swing_n: FloatArray
    engaged: BoolArray


def touch(
    touches: Sequence[Touch], contact: Contact, press_m: float, ceiling_n: float = 1e3, settle_s: float = 1.0
) -> Touched:
    """Move every arm into its contact, and hold the target behind the surface; the target leads by `LEASH_M` at most.

    Args:
        touches: one per arm.
        contact: place of the contact.
        press_m: distance of the last target behind the surface.
        ceiling_n: measured force at which an arm stops by itself.
        settle_s: time after the slowest arrival.
    """
    n = len(touches)
    world, cells = World(n), np.arange(n)
    world.reset(cells, [Task(3, conditions=one.conditions, sensor_delay_ticks=one.delay_ticks) for one in touches])
    offset, way, distance = _WAYS[contact]
    world.place(cells, world.hole_position + np.array(offset), world.hole_yaw.copy())
    world.zero_ft(cells)
    stiffness, damping, inertia = (
        np.array([getattr(one.law, name) for one in touches]) for name in ("stiffness", "damping", "inertia")
    )
    limits = ControlLimits(WORKSPACE_M, ceiling_n, max_speed=(0.3, 3.0), max_step=(1.0, 1.0))
    world.engage(cells, stiffness, damping, inertia, limits)
    turn = quaternion.from_rotvec(rotvec_from_yaw(world.hole_yaw))
    steps = np.array([one.speed_m_s for one in touches]) * TARGET_TICKS * TICK_S
    target, gone = world.position.copy(), np.zeros(n)
    models = [world.model(cell) for cell in range(n)]
    touched, peak = np.zeros(n, np.int64), np.zeros(n)
    ticks = round(((distance + press_m) / min(one.speed_m_s for one in touches) + settle_s) / TICK_S)
    loads = np.zeros((SETTLED_TICKS, n))
    for tick in range(ticks):
        if tick % TARGET_TICKS == 0:
            free = np.linalg.norm(target - world.position, axis=1) < LEASH_M
            step = np.where(free, np.minimum(steps, distance + press_m - gone), 0.0)
            gone += step
            target += step[:, None] * np.array(way)
            world.arm.set_target(cells, target, turn)
        world.tick()
        loads[tick % SETTLED_TICKS] = world.true_force
        for cell in np.flatnonzero(touched < TOUCH_TICKS).tolist():
            force = _contact_force(models[cell], world.data(cell))
            touched[cell] += touched[cell] > 0 or force > 0.0
            peak[cell] = max(peak[cell], force)
    return Touched(peak, loads.std(axis=0), world.arm.program == Program.ENGAGED)


def _contact_force(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Return the resultant of all contacts at a cell's present state, N."""
    mujoco.mj_forward(model, data)
    total, one = np.zeros(3), np.zeros(6)
    for index in range(data.ncon):
        mujoco.mj_contactForce(model, data, index, one)
        total += data.contact[index].frame.reshape(3, 3).T @ one[:3]
    return float(np.linalg.norm(total))
