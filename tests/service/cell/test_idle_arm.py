"""An arm that this cell does not drive: a third party that drives it is latched, one that moves it is told."""

from collections.abc import Sequence

import numpy as np
import pytest

from service.drivers.base import PoseTarget, Program, Sample
from service.drivers.sim_wire import CommandWriter
from service.faults import FaultCode
from service.messages import CellState, EventKind, RefusalReason, Refused, ResetRequest, StartRequest, StatusResult
from service.testing import RECIPE, Bench
from service.testing.in_process import InProcessDriver
from tests.service.cell.conftest import EASY, FaultyBench, FaultyCell
from tests.service.cell.faulty_driver import speed
from training.environment.design import LAW
from wire.law import ControlLimits
from wire.limits import WORKSPACE_M
from wire.task import Task


class Intruder:
    """Another client of the simulated arm, which engages it and pulls it along x with every sample."""

    def __init__(self, faulty: FaultyBench) -> None:
        self._world = faulty.bench.world
        self._commands = CommandWriter()
        self._commands.epoch = self._world.epoch
        faulty.driver.spoil = self._drive

    def _drive(self, sample: Sample) -> Sequence[Sample]:
        if sample.program is Program.IDLE:
            self._world.apply(self._commands.engage(LAW, ControlLimits(WORKSPACE_M, 40.0))[0])
        pulled = PoseTarget(sample.tcp_position + np.array([5e-3, 0.0, 0.0]), sample.tcp_rotvec)
        self._world.apply(self._commands.target(pulled)[0])
        return [sample]


def told(bench: Bench, kind: EventKind) -> list[str]:
    return [event.text for event in bench.events if event.kind is kind]


@pytest.mark.parametrize("arm", ["simulated"], indirect=True)
async def test_83_a_third_party_drives_the_ready_arm_authority(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        bench, driver = faulty.bench, faulty.driver
        await bench.state(CellState.READY)
        await bench.let_pass(0.1)
        before = driver.truth.tcp_position
        Intruder(faulty)
        await bench.state(CellState.LATCHED, limit_s=2.0)
        driver.spoil = lambda sample: [sample]
        await bench.let_pass(0.3)
        assert bench.cell.journal.latch.code in (FaultCode.AUTHORITY, FaultCode.STOP_UNCONFIRMED)
        assert "this cell has not engaged it" in bench.cell.status().latch.text, "seen in status"
        assert any("this cell has not engaged it" in text for text in told(bench, EventKind.FAULT)), (
            "and in the journal"
        )
        assert speed(driver.truth) < 2e-3
        assert np.linalg.norm(driver.truth.tcp_position - before) < 0.02, "it was stopped again and again"
        assert isinstance(await bench.cell.start(StartRequest(recipe=RECIPE, seed=EASY)), Refused)
        assert isinstance(await bench.cell.reset(ResetRequest()), StatusResult)


@pytest.mark.parametrize("arm", ["simulated"], indirect=True)
async def test_83_a_third_party_that_engages_once_is_latched_and_stopped_authority(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        bench = faulty.bench
        await bench.state(CellState.READY)
        await bench.let_pass(0.1)
        commands = CommandWriter()
        commands.epoch = bench.world.epoch
        bench.world.apply(commands.engage(LAW, ControlLimits(WORKSPACE_M, 40.0))[0])
        await bench.state(CellState.LATCHED, limit_s=1.0)
        assert bench.cell.journal.latch.code is FaultCode.AUTHORITY
        assert bench.cell.journal.latch.run_id is None
        assert faulty.driver.truth.program is Program.IDLE
        await bench.let_pass(0.1)
        bench.world.apply(commands.engage(LAW, ControlLimits(WORKSPACE_M, 40.0))[0])
        await bench.let_pass(0.5)
        assert faulty.driver.truth.program is Program.IDLE
        assert sum("has not engaged it" in text for text in told(bench, EventKind.WARNING)) == 1, "told while latched"


@pytest.mark.parametrize("arm", ["simulated"], indirect=True)
async def test_an_arm_that_an_earlier_process_left_engaged_is_stopped_and_nothing_latches(
    faulty_cell: FaultyCell,
) -> None:
    async with faulty_cell() as faulty:
        bench = faulty.bench
        commands = CommandWriter()
        commands.epoch = bench.world.epoch
        bench.world.apply(commands.engage(LAW, ControlLimits(WORKSPACE_M, 40.0))[0])
        bench.cell.lose_link("restarted")
        await bench.state(CellState.READY, limit_s=5.0)
        await bench.let_pass(1.0)
        assert bench.cell.state is CellState.READY
        assert bench.cell.journal.latch is None
        assert faulty.driver.truth.program is Program.IDLE


async def jog(faulty: FaultyBench, metres: float) -> None:
    """Move the arm by the robot's own means, without a program: along x, at 50 mm/s."""
    reference, ticks = faulty.bench.world._world.arm.reference.position, round(abs(metres) / 1e-4)
    way = metres / ticks

    def move(sample: Sample) -> Sequence[Sample]:
        nonlocal ticks
        if ticks > 0:
            reference[0, 0] += way
        ticks -= 1
        return [sample]

    faulty.driver.spoil = move
    await faulty.bench.let_pass(2.0)
    faulty.driver.spoil = lambda sample: [sample]


@pytest.mark.parametrize("arm", ["simulated"], indirect=True)
async def test_a_ready_arm_that_is_jogged_is_told_and_nothing_latches(faulty_cell: FaultyCell) -> None:
    async with faulty_cell() as faulty:
        bench = faulty.bench
        await bench.state(CellState.READY)
        await bench.let_pass(1.0)
        assert told(bench, EventKind.WARNING) == []
        await jog(faulty, 0.03)
        begun, ended = told(bench, EventKind.WARNING)
        assert "the arm is being moved, and not by this cell" in begun
        assert "rests again, its TCP at [330." in ended
        assert bench.cell.state is CellState.READY
        assert (await bench.insert(EASY)).code is None, "a simulated world is laid out anew"
        assert len(told(bench, EventKind.WARNING)) == 2, "what a run moves is not told"


class Standing(InProcessDriver):
    """An arm that stands where it stands, as a real one: a run lays nothing out and takes no seed."""

    simulated = False

    async def prepare(self, task: Task | None) -> None:
        assert task is None


@pytest.mark.parametrize("arm", ["simulated"], indirect=True)
async def test_34_pendant_jog_start_refused_until_the_arm_is_back(
    faulty_cell: FaultyCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.testing.bench.InProcessDriver", Standing)
    async with faulty_cell() as faulty:
        bench, driver = faulty.bench, faulty.driver
        await bench.state(CellState.READY)
        await jog(faulty, 0.03)
        answer = await bench.cell.start(StartRequest(recipe=RECIPE))
        assert isinstance(answer, Refused)
        assert answer.problem.reason is RefusalReason.WRONG_STATE
        assert "m from the start pose, limit 0.005 m: move the arm there" in answer.problem.detail
        assert bench.cell.journal.newest(10) == ()
        assert driver.said("engage") == driver.said("zero_ft") == []
        await jog(faulty, -0.03)
        assert not isinstance(await bench.cell.start(StartRequest(recipe=RECIPE)), Refused)
