"""An arm that moves: the world's plant, driven tick by tick by what is tested."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest

from sim_backend.ur_controller.motion import Motion
from sim_backend.ur_controller.plant import Plant
from sim_backend.world.world import World
from wire.arrays import FloatArray
from wire.pose import rotation_from_rotvec
from wire.task import Task

from ..contacts import pressing

FREE = (0.28, -0.11, 0.15)
"""TCP position around which the arm can move by some centimetres and touches nothing."""


@dataclass
class Arm:
    """A plant, its motion, and what was measured while it ran."""

    plant: Plant
    motion: Motion
    fraction: float = 1.0
    joints: list[FloatArray] = field(default_factory=list)
    poses: list[list[float]] = field(default_factory=list)
    targets: list[list[float]] = field(default_factory=list)

    def run(self, ticks: int, each_tick: Callable[[], None] | None = None) -> None:
        for _ in range(ticks):
            if each_tick is not None:
                each_tick()
            self.motion.advance(self.fraction)
            self.plant.drive(self.motion.q_target, self.motion.qd_target)
            self.joints.append(self.plant.q)
            self.poses.append(self.plant.tcp_pose())
            self.targets.append(self.motion.target_tcp_pose())

    def until_ready(self, limit: int = 5000) -> int:
        """Run until the script that started the motion could go on; the ticks that took."""
        for ticks in range(1, limit):
            self.run(1)
            if self.motion.ready:
                return ticks
        raise AssertionError(f"the motion was not over after {limit} ticks")

    def settle(self) -> None:
        """Let the joints, which follow closely but not at once, come to where they are to be."""
        self.run(60)

    def positions(self) -> FloatArray:
        return np.array(self.poses)[:, :3]

    def speed(self) -> FloatArray:
        """Measured twist of the TCP."""
        return np.array(self.plant.tcp_speed())

    def pressing(self) -> float:
        """With how many N the contacts push the peg up."""
        return pressing(self.plant)

    def offset(self, *change: float) -> list[float]:
        """The present target pose, moved by `change`, m, base axes."""
        pose = self.motion.target_tcp_pose()
        return [*(a + b for a, b in zip(pose[:3], change, strict=True)), *pose[3:]]


@pytest.fixture(scope="session")
def plant() -> Plant:
    return Plant(World(1, "tr"))


@pytest.fixture
def arm(plant: Plant) -> Arm:
    """An arm at rest in the free."""
    plant.on_placed.clear()
    plant.set_tcp([0.0, 0.0, 0.19, 0.0, 0.0, 0.0])
    plant.lay_out(Task(1, "tr"))
    plant.place(FREE)
    motion = Motion(plant)
    plant.on_placed.append(motion.freeze)
    return Arm(plant, motion)


def angle_between(a: list[float], b: list[float]) -> float:
    """Angle of the rotation from pose `a` to pose `b`, rad."""
    turn = rotation_from_rotvec(a[3:]).T @ rotation_from_rotvec(b[3:])
    return float(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0)))
