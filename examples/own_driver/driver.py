"""The driver of that arm: the smallest class with everything that `service.drivers.base.Driver` asks for."""

import asyncio
import secrets
from collections.abc import Callable

import numpy as np
from world import TICK_S, PointMassArm

from service.drivers.base import DriverError, PoseTarget, RobotMode, SafetyMode, Sample, SampleSink, StopReason
from service.faults import FaultCode
from wire.law import ComplianceLaw, ControlLimits
from wire.modes import TimeMode
from wire.task import Task

CAMERA_ERROR_M = np.array([2.5e-3, 0.0, 0.0])
"""So far off does the camera see the hole: the tip lands beside it, and the policy finds the hole by touch."""


class PointMassDriver:
    """Steps the arm and hands over its samples; `make_arm` lays out the world of a seed."""

    name = "point mass in this process"
    mode: TimeMode = "lockstep"  # time passes only as far as `_let_time_pass` lets it
    simulated = True  # a start may name a seed; a real arm refuses one
    tick_s = TICK_S
    samples_dropped = 0

    def __init__(self, make_arm: Callable[[int], PointMassArm]) -> None:
        self._make_arm, self._arm = make_arm, make_arm(0)
        self._epoch, self._episode = secrets.randbits(32), 0  # the cell refuses samples of a source that was restarted
        self._ticks = self._seq = self._command_seq = 0
        self._task: asyncio.Task[None] | None = None

    @property
    def clock(self) -> Callable[[], float]:
        """The cell reads no other clock: all its deadlines count in this world's time."""
        return lambda: self._ticks * TICK_S

    async def connect(self, sink: SampleSink) -> None:
        """Let samples flow; called again after a link fault."""
        self._task = self._task or asyncio.create_task(self._let_time_pass(sink))

    async def prepare(self, task: Task | None) -> None:
        """Lay out the world of a run. On a real arm: refuse a task, and check that the arm may be used."""
        if task is None:
            raise DriverError(FaultCode.PROTOCOL, "a simulated world needs a seed to be laid out from")
        self._arm = self._make_arm(task.seed)
        self._episode, self._seq = self._episode + 1, 0

    def engage(self, law: ComplianceLaw, limits: ControlLimits) -> None:
        """Pass law and limits on: the arm itself keeps them, whatever happens to this process."""
        self._arm.engage(law, limits, self.clock())

    def send_target(self, target: PoseTarget) -> int:
        """Return a number that later samples echo."""
        self._command_seq += 1
        self._arm.go_to(target, self.clock())
        return self._command_seq

    def stop(self) -> None:
        """Never block, never raise, in any state. Where a stop has to wait for a socket, a thread does the waiting."""
        self._arm.stop(StopReason.COMMAND)

    def stop_blind(self) -> None:
        """Stop without yielding to the sensor: the cell does not believe it. This arm never yields to it in a stop."""
        self.stop()

    def escalate(self) -> None:
        """Called when no standstill was measured after `stop`; this arm has nothing stronger."""
        self.stop()

    def zero_ft(self) -> None:
        """Take the present reading as zero."""
        self._arm.zero()

    def unlock(self) -> None:
        """This arm has no protective stop of its own."""

    async def close(self) -> None:
        """Stop and release the arm."""
        self.stop()
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait({self._task})

    async def _let_time_pass(self, sink: SampleSink) -> None:
        while True:
            self._ticks, self._seq = self._ticks + 1, self._seq + 1
            self._arm.tick(self.clock())
            sink.on_sample(self._sample())  # the cell judges it and calls the methods above before this returns
            await asyncio.sleep(0)

    def _sample(self) -> Sample:
        arm, now_s = self._arm, self.clock()
        return Sample(
            epoch=self._epoch,
            episode=self._episode,
            seq=self._seq,
            time_s=now_s,  # the arm's own stamp
            arrival_s=now_s,  # by `clock`: the same here, later over a network
            q=np.zeros(6),
            qd=np.zeros(6),
            tcp_position=arm.position.copy(),
            tcp_rotvec=arm.rotvec.copy(),
            tcp_velocity=np.array([*arm.velocity, 0.0, 0.0, 0.0]),
            wrench=arm.wrench(),
            unzeroed=arm.unzeroed,
            ft_raw=arm.unzeroed,  # this sensor's axes are the base's
            joint_force=None,  # this arm has no second witness of the contact
            saturated=False,
            hole_estimate=arm.hole + CAMERA_ERROR_M,
            program=arm.program,
            stop_reason=arm.stop_reason,
            robot_mode=RobotMode.RUNNING,
            safety_mode=SafetyMode.NORMAL,
            command_seq=self._command_seq,
            peak_force_n=arm.peak_force_n,
        )
