"""A driver of a simulated cell inside this process, in lockstep: no transport, but the same commands and states.

Only this folder of the service imports the world.
"""

import asyncio
from collections.abc import Callable
from typing import Any

import numpy.typing as npt

from service.drivers.base import DriverError, PoseTarget, Sample, SampleSink
from service.drivers.sim_wire import CommandWriter, check_task, read_sample
from service.faults import FaultCode
from sim_backend.zenoh_cell.cell import SimulatedCell
from wire import records
from wire.law import ComplianceLaw, ControlLimits
from wire.modes import TimeMode
from wire.task import Task

IDLE_TICKS = 500
"""Ticks without a command or an engaged arm after which time passes no faster than in reality, to spare the core."""


def _stops_blindly(command: npt.NDArray[Any]) -> bool:
    return bool(command[0]["kind"] == records.Kind.STOP_BLIND)


class InProcessDriver:
    """Steps a `SimulatedCell`, one tick per turn of the event loop; every sample is judged before the next tick.

    Args:
        cell: the world.
    """

    mode: TimeMode = "lockstep"
    name = "simulated cell in this process"
    simulated = True
    tick_s = records.TICK_S
    samples_dropped = 0

    def __init__(self, cell: SimulatedCell) -> None:
        self._cell = cell
        self._commands = CommandWriter()
        self._pending: list[npt.NDArray[Any]] = []
        self._sink: SampleSink | None = None
        self._ticks = 0
        self._quiet_ticks = 0
        self._task: asyncio.Task[None] | None = None

    @property
    def clock(self) -> Callable[[], float]:
        return lambda: self._ticks * records.TICK_S

    async def connect(self, sink: SampleSink) -> None:
        self._sink = sink
        self._commands.epoch = self._cell.epoch
        if self._task is None:
            self._task = asyncio.create_task(self._let_time_pass(), name="lockstep")

    async def prepare(self, task: Task | None) -> None:
        try:
            self._cell.reset(check_task(task))
        except ValueError as error:
            raise DriverError(FaultCode.PROTOCOL, str(error)) from error
        self._quiet_ticks = 0

    def engage(self, law: ComplianceLaw, limits: ControlLimits) -> None:
        self._pending.append(self._commands.engage(law, limits))

    def send_target(self, target: PoseTarget) -> int:
        self._pending.append(self._commands.target(target))
        return self._commands.seq

    def stop(self) -> None:
        # an earlier order to stop blindly is not lost
        self._pending = [*filter(_stops_blindly, self._pending), self._commands.stop()]

    def stop_blind(self) -> None:
        self._pending = [self._commands.stop(blind=True)]

    def escalate(self) -> None:
        self.stop()

    def zero_ft(self) -> None:
        self._pending.append(self._commands.zero_ft())

    def unlock(self) -> None:
        self._pending.append(self._commands.unlock())

    async def close(self) -> None:
        self.stop()
        task, self._task = self._task, None
        if task is not None:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
        for command in self._pending:
            self._cell.apply(command[0])

    async def _let_time_pass(self) -> None:
        while True:
            sample = self._tick()
            if self._sink is not None:
                self._sink.on_sample(sample)
            quiet = sample.program is records.Program.IDLE and not self._pending
            self._quiet_ticks = self._quiet_ticks + 1 if quiet else 0
            await asyncio.sleep(records.TICK_S if self._quiet_ticks > IDLE_TICKS else 0)

    def _tick(self) -> Sample:
        commands, self._pending = self._pending, []
        for command in commands:
            self._cell.apply(command[0])
        record = self._cell.tick()
        self._ticks += 1
        return read_sample(record.tobytes(), self._ticks * records.TICK_S)
