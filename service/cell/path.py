"""Scripted straight moves: targets along a polyline at a limited speed and lead, until the arm has arrived."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from math import copysign

import numpy as np

from service.drivers.base import Sample
from service.safety.pose import wrap
from wire.arrays import FloatArray

ARRIVAL_M = 5e-3
"""Distance of the measured TCP from the end that counts as arrived; a biased sensor holds a compliant arm off."""
ARRIVAL_SPEED_M_S = 5e-3
STEP_SHARE = 0.999
"""Share of the arm's step limit that a scripted target uses, because the arm's own arithmetic rounds."""
PATIENCE_S = 3.0
"""Allowance beyond twice the path's length over its speed, because the target waits for the arm at its leash."""


class Progress(StrEnum):
    UNDER_WAY = "UNDER_WAY"
    ARRIVED = "ARRIVED"
    OVERDUE = "OVERDUE"


@dataclass(slots=True)
class StraightPath:
    """Targets along straight lines.

    Attributes:
        target: (3,) m, the target in force.
        yaw: kept all the way.
        waypoints: (3,) m each, still ahead.
        step_m: distance between two targets.
        deadline_s: latest arrival, on the samples' clock.
    """

    target: FloatArray
    yaw: float
    waypoints: list[FloatArray]
    step_m: float
    deadline_s: float

    @classmethod
    def plan(
        cls,
        start: FloatArray,
        yaw: float,
        waypoints: Sequence[FloatArray],
        speed_m_s: float,
        period_s: float,
        now_s: float,
    ) -> "StraightPath":
        """Lay out a path.

        Args:
            start: (3,) m, the target in force.
            yaw: kept all the way.
            waypoints: (3,) m each, in order.
            speed_m_s: of the target.
            period_s: time between two calls of `advance`.
            now_s: the samples' clock.
        """
        corners = [start, *waypoints]
        length = sum(float(np.linalg.norm(b - a)) for a, b in pairwise(corners))
        deadline = now_s + 2.0 * length / speed_m_s + PATIENCE_S
        return cls(start.copy(), yaw, [point.copy() for point in waypoints], speed_m_s * period_s, deadline)

    def advance(self, measured: FloatArray, leash_m: float) -> FloatArray:
        """Advance the target by one step, unless it would lead the arm by more than the leash; return it, (3,) m.

        Args:
            measured: (3,) m, TCP.
            leash_m: largest lead of the target.
        """
        before = self.target, list(self.waypoints)
        lead = float(np.linalg.norm(self.target - measured))
        self._step()
        if float(np.linalg.norm(self.target - measured)) > max(leash_m, lead):
            self.target, self.waypoints = before
        return self.target

    def _step(self) -> None:
        left = self.step_m
        while self.waypoints and left > 0.0:
            way = self.waypoints[0] - self.target
            distance = float(np.linalg.norm(way))
            if distance > left:
                self.target = self.target + way * (left / distance)
                break
            self.target = self.waypoints[0]
            # The last waypoint stays, so that an arm that has not arrived keeps its target
            if len(self.waypoints) == 1:
                break
            left -= distance
            self.waypoints.pop(0)

    def progress(self, sample: Sample) -> Progress:
        """Return how far the arm has come, by measurement."""
        at_end = len(self.waypoints) == 1 and bool((self.target == self.waypoints[0]).all())
        near = float(np.linalg.norm(sample.tcp_position - self.target)) < ARRIVAL_M
        if at_end and near and float(np.linalg.norm(sample.tcp_velocity[:3])) < ARRIVAL_SPEED_M_S:
            return Progress.ARRIVED
        return Progress.OVERDUE if sample.time_s > self.deadline_s else Progress.UNDER_WAY


def within_step(
    position: FloatArray, yaw: float, last: FloatArray, last_yaw: float, max_step: tuple[float, float]
) -> tuple[FloatArray, float]:
    """Return a target, pulled towards the last one where the arm would refuse it.

    Args:
        position: (3,) m, wanted.
        yaw: rad, wanted.
        last: (3,) m, the target in force.
        last_yaw: rad, of the target in force.
        max_step: largest change between two targets, m and rad.
    """
    step_m, step_rad = (STEP_SHARE * limit for limit in max_step)
    way, turn = position - last, float(wrap(yaw - last_yaw))
    distance = float(np.linalg.norm(way))
    if distance > step_m:
        position = last + way * (step_m / distance)
    if abs(turn) > step_rad:
        yaw = last_yaw + copysign(step_rad, turn)
    return position, yaw
