"""An emulated arm in this process that presses its peg into the block, tick by tick, with the control program alone."""

import math
import random
from collections.abc import Sequence

import mujoco
import numpy as np

from service.cell.plan import Plan
from service.config import CellConfig
from service.drivers.ur import registers
from service.drivers.ur.program import render
from service.drivers.ur.registers import Command
from sim_backend.ur_controller.assembly import make_controller
from sim_backend.ur_controller.plant import Plant
from sim_backend.world.world import World
from wire.records import TICK_S
from wire.rtde.modes import RuntimeState
from wire.task import Task

BESIDE_M = 0.045
"""Distance from the hole's axis, m: over the block, clear of the hole."""
ABOVE_M = (0.006, 0.008)
"""Range of the peg's initial height over the block, m; drawn from the seed, so that contact falls on any moment of a
target's period."""
TARGET_TICKS = 50
"""Ticks between two targets, as from a policy."""
ZERO_TICKS = 150
_ECHO_TICKS = 10


class ContactForce:
    """True force on the peg as solved by the physics: no weight, no inertia, no sensor."""

    def __init__(self, plant: Plant) -> None:
        self._world = plant.world
        self._model = plant.world.model()
        self._peg = self._model.geom("peg").id

    def __call__(self) -> float:
        """Return the resultant of the contacts on the peg, N."""
        data = self._world.data()
        mujoco.mj_forward(self._model, data)  # the forces at this state, not those that led to it
        total, wrench = np.zeros(3), np.zeros(6)
        for index in range(data.ncon):
            contact = data.contact[index]
            mujoco.mj_contactForce(self._model, data, index, wrench)
            force = contact.frame.reshape(3, 3).T @ wrench[:3]
            if self._peg in contact.geom:
                total += force if contact.geom2 == self._peg else -force
        return math.hypot(*total.tolist())


class PressedArm:
    """An engaged arm over the block beside the hole, and a host that writes its registers in every tick.

    Args:
        config: configuration of the control program.
        plan: law and limits of the engagement.
        ceiling_n: ceiling of the engagement, instead of the plan's.
        task: task of the world.

    Attributes:
        plant: simulated arm.
        silent: True once the host has stopped writing.
    """

    def __init__(self, config: CellConfig, plan: Plan, ceiling_n: float, task: Task) -> None:
        self.plant = Plant(World(1, task.part))
        self.plant.lay_out(task)
        self.controller = make_controller(self.plant)
        self.silent = False
        self._contact = ContactForce(self.plant)
        self._sequence = 0
        self._order: tuple[float, ...] = registers.input_values(0, Command.NONE, ())
        self._stand_over_the_block(random.Random(task.seed).uniform(*ABOVE_M))  # noqa: S311  # not secret
        self._tick(_ECHO_TICKS)
        self.controller.run_script(render(config).text)
        self._tick(ZERO_TICKS)
        self._write(Command.ZERO_FT)
        self._tick(_ECHO_TICKS)
        law, limits = plan.law, plan.limits
        parts = law.stiffness, law.damping, law.inertia, limits.max_speed, limits.max_step
        numbers = [float(number) for part in parts for number in part]
        self._write(Command.ENGAGE, [*numbers, ceiling_n, limits.target_age_s])
        self._tick(_ECHO_TICKS)
        self._target = self.controller.motion.target_tcp_pose()
        self._ticks = 0

    def press(self, speed_m_s: float) -> None:
        """Let one tick pass; the target sinks at a speed, by one step every 100 ms."""
        if self._ticks % TARGET_TICKS == 0:
            self._target[2] -= speed_m_s * TARGET_TICKS * TICK_S
            self._write(Command.TARGET, self._target)
        self._ticks += 1
        self._tick()

    @property
    def runs(self) -> bool:
        """The controller runs the control program."""
        return self.controller.runtime_state is RuntimeState.PLAYING

    @property
    def height_m(self) -> float:
        """Height of the peg over the block, m."""
        return -float(self.plant.world.depth[0])

    @property
    def measured_n(self) -> float:
        """Resultant force measured by the controller, N."""
        return math.hypot(*self.plant.wrench[:3].tolist())

    @property
    def true_n(self) -> float:
        """Resultant force on the peg, N."""
        return self._contact()

    @property
    def target_speed_m_s(self) -> float:
        """Commanded sinking speed of the TCP, m/s."""
        return -self.controller.motion.target_tcp_speed()[2]

    @property
    def speed_m_s(self) -> float:
        """Speed of the TCP, m/s."""
        return math.hypot(*self.plant.tcp_speed()[:3])

    def _stand_over_the_block(self, above_m: float) -> None:
        truth = self.plant.truth()
        x, y, z = truth["hole_position"]
        yaw = truth["hole_yaw"]
        self.plant.place([x + BESIDE_M * math.cos(yaw), y + BESIDE_M * math.sin(yaw), z + above_m])

    def _write(self, command: Command, arguments: Sequence[float] = ()) -> None:
        self._sequence += 1
        self._order = registers.input_values(self._sequence, command, arguments)

    def _tick(self, ticks: int = 1) -> None:
        for _ in range(ticks):
            if not self.silent:
                self.controller.apply_inputs(registers.INPUT_NAMES, self._order)
            self.controller.tick()
