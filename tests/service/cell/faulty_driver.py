"""A driver around a real one that spoils its samples and orders: what a fault looks like from the cell."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from service.cell.cell import Cell
from service.drivers.base import Driver, Load, PoseTarget, Sample, SampleSink
from service.faults import FaultCode
from wire.law import ComplianceLaw, ControlLimits
from wire.task import Task

AGAIN_TICKS = 50
Spoil = Callable[[Sample], Sequence[Sample]]
FaultyT = TypeVar("FaultyT", bound="FaultyDriver")


@dataclass(frozen=True, slots=True)
class Order:
    """An order of the cell, and when it came by the driver's clock."""

    kind: str
    time_s: float


class FaultyDriver:
    """Passes everything on, except what a test tells it to spoil.

    Attributes:
        spoil: makes of one true sample what the cell gets: none, one or several.
        deaf_to_stop: the arm stays engaged whatever the cell says; its last target is sent again and again.
        real_time: time passes for the cell whether or not samples come; it is watched once per true sample.
        orders: that the cell gave.
        truth: the newest true sample.
    """

    def __init__(self, driver: Driver) -> None:
        self._driver = driver
        self._sink: SampleSink | None = None
        self.spoil: Spoil = lambda sample: [sample]
        self.deaf_to_stop = False
        self._target: PoseTarget | None = None
        self.real_time = False
        self.orders: list[Order] = []
        self.truth: Sample | None = None
        self.name = f"faulty {driver.name}"
        self.simulated = driver.simulated
        self.tick_s = driver.tick_s
        self.samples_dropped = 0

    @property
    def mode(self):
        return "real_time" if self.real_time else "lockstep"

    @property
    def clock(self):
        return self._driver.clock

    async def connect(self, sink: SampleSink) -> None:
        self._sink = sink
        await self._driver.connect(self)

    def on_sample(self, sample: Sample) -> None:
        self.truth = sample
        if self.deaf_to_stop and self._target is not None and sample.seq % AGAIN_TICKS == 0:
            self._driver.send_target(self._target)
        if self._sink is not None:
            for spoilt in self.spoil(sample):
                self._sink.on_sample(spoilt)
            if self.real_time and isinstance(self._sink, Cell):
                self._sink.watch()

    def overloads(self, load: Load) -> bool:
        return self._sink is not None and self._sink.overloads(load)

    def on_link_fault(self, code: FaultCode, text: str) -> None:
        if self._sink is not None:
            self._sink.on_link_fault(code, text)

    def on_notice(self, text: str) -> None:
        if self._sink is not None:
            self._sink.on_notice(text)

    async def prepare(self, task: Task | None) -> None:
        await self._driver.prepare(task)

    def engage(self, law: ComplianceLaw, limits: ControlLimits) -> None:
        self._note("engage")
        self._driver.engage(law, limits)

    def send_target(self, target: PoseTarget) -> int:
        self._note("target")
        self._target = target
        return self._driver.send_target(target)

    def stop(self) -> None:
        self._note("stop")
        if not self.deaf_to_stop:
            self._driver.stop()

    def stop_blind(self) -> None:
        self._note("stop")
        self._note("stop_blind")
        if not self.deaf_to_stop:
            self._driver.stop_blind()

    def escalate(self) -> None:
        self._note("escalate")

    def zero_ft(self) -> None:
        self._note("zero_ft")
        self._driver.zero_ft()

    def unlock(self) -> None:
        self._note("unlock")
        self._driver.unlock()

    async def close(self) -> None:
        await self._driver.close()

    def said(self, kind: str) -> list[float]:
        return [order.time_s for order in self.orders if order.kind == kind]

    def _note(self, kind: str) -> None:
        self.orders.append(Order(kind, self.clock()))


class Wrapping(Generic[FaultyT]):
    """Wraps the driver that a bench makes: `lockstep_cell(config, wrap=Wrapping(FaultyDriver))`.

    Attributes:
        driver: the wrapped one, once the bench has made it.
    """

    driver: FaultyT

    def __init__(self, kind: Callable[[Driver], FaultyT]) -> None:
        self._kind = kind

    def __call__(self, driver: Driver) -> FaultyT:
        self.driver = self._kind(driver)
        return self.driver


def with_wrench(sample: Sample, **components: float) -> Sample:
    """The sample with components of its wrench replaced: `fx`, `fy`, `fz`, `tx`, `ty`, `tz`."""
    wrench = sample.wrench.copy()
    for name, value in components.items():
        wrench[["fx", "fy", "fz", "tx", "ty", "tz"].index(name)] = value
    return replace(sample, wrench=wrench)


def speed(sample: Sample) -> float:
    return float(np.linalg.norm(sample.tcp_velocity[:3]))
