"""The arm that the driver speaks to: a point mass on springs above a block with a hole.

It stands for a robot's controller with its control program and its force/torque sensor.
"""

import numpy as np

from service.drivers.base import PoseTarget, Program, StopReason
from wire.arrays import FloatArray
from wire.law import ComplianceLaw, ControlLimits
from wire.pose import rotvec_from_rotation, tool_down

TICK_S = 0.002
HOLE_RADIUS_M = 2e-3
BLOCK_N_M = 20_000.0
"""Stiffness of the block, N per m of penetration."""
NOISE = np.array([0.05, 0.05, 0.05, 0.002, 0.002, 0.002])
"""The sensor's noise, N and N·m. The cell takes ten equal readings in a row for a stuck sensor."""


class PointMassArm:
    """Runs the compliance law and stops by itself; a cell needs an arm whose controller does both.

    Args:
        start: (3,) m, where it stands.
        hole: (3,) m, centre of the hole's mouth.
        radius_m: radius of the hole; 0: the block has none.
    """

    def __init__(self, start: FloatArray, hole: FloatArray, radius_m: float) -> None:
        self.position, self.velocity = start.copy(), np.zeros(3)
        self.rotvec = rotvec_from_rotation(tool_down(0.0))
        self.hole, self.radius_m = hole, radius_m
        self.force, self.peak_force_n = np.zeros(3), 0.0
        self.program, self.stop_reason = Program.IDLE, StopReason.NONE
        self._target_s = 0.0
        self._random = np.random.default_rng(0)
        self._bias = np.array([1.0, -0.5, 2.0, 0.02, 0.01, 0.0])  # why the cell zeroes the sensor before each run
        self._zero = np.zeros(6)
        self._read()

    def engage(self, law: ComplianceLaw, limits: ControlLimits, now_s: float) -> None:
        """Start the control program; the target is the present pose."""
        self.law, self.limits, self.target, self._target_s = law, limits, self.position.copy(), now_s
        self.program, self.stop_reason, self.peak_force_n = Program.ENGAGED, StopReason.NONE, 0.0

    def go_to(self, target: PoseTarget, now_s: float) -> None:
        """Take a new target, or stop for one that the limits do not allow."""
        if self.program is not Program.ENGAGED:
            return
        (lower, upper), step_m = self.limits.workspace, float(np.linalg.norm(target.position - self.target))
        inside = bool(((target.position >= lower) & (target.position <= upper)).all())
        if inside and step_m <= self.limits.max_step[0]:
            self.target, self.rotvec, self._target_s = target.position, target.rotvec, now_s
        else:
            self.stop(StopReason.TARGET_REJECTED)

    def wrench(self) -> FloatArray:
        """Return the zeroed reading, (6,) N and N·m."""
        return self.unzeroed - self._zero

    def zero(self) -> None:
        """Take the present reading as zero."""
        self._zero = self.unzeroed

    def stop(self, reason: StopReason) -> None:
        """Hold where it is. A point mass stands at once; a real arm decelerates and reports STOPPING."""
        if self.program is Program.ENGAGED:
            self.stop_reason = reason
        self.program, self.velocity = Program.IDLE, np.zeros(3)

    def tick(self, now_s: float) -> None:
        """Let one tick pass."""
        self.force = self._touch()
        self._read()
        self.peak_force_n = max(self.peak_force_n, float(np.linalg.norm(self.force)))
        if self.program is not Program.ENGAGED:
            return
        if np.linalg.norm(self.force) >= self.limits.force_ceiling_n:
            self.stop(StopReason.FORCE_CEILING)
        elif now_s - self._target_s > self.limits.target_age_s:
            self.stop(StopReason.TARGET_AGE)
        else:
            stiffness, damping, inertia = np.array([self.law.stiffness, self.law.damping, self.law.inertia])[:, :3]
            pull = stiffness * (self.target - self.position) - damping * self.velocity + self.force
            self.velocity = self.velocity + pull / inertia * TICK_S
            speed = float(np.linalg.norm(self.velocity))
            self.velocity = self.velocity * min(1.0, self.limits.max_speed[0] / max(speed, 1e-9))
            self.position = self.position + self.velocity * TICK_S

    def _read(self) -> None:
        self.unzeroed = np.array([*self.force, 0.0, 0.0, 0.0]) + self._bias + self._random.normal(0.0, NOISE)

    def _touch(self) -> FloatArray:
        """Force of the block on the tool, (3,) N: of the surface, or of the hole's wall."""
        deep, aside = self.hole[2] - self.position[2], self.position[:2] - self.hole[:2]
        outside = float(np.linalg.norm(aside)) - self.radius_m
        if deep <= 0.0 or outside <= 0.0:
            return np.zeros(3)
        if self.radius_m > 0.0 and outside < deep:
            return np.array([*(-BLOCK_N_M * outside * aside / np.linalg.norm(aside)), 0.0])
        return np.array([0.0, 0.0, BLOCK_N_M * deep])
