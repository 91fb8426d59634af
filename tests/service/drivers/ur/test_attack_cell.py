"""Attacks on a whole cell with a UR arm: what the record says and the arm does."""

import asyncio
from pathlib import Path

import numpy as np
import pytest

from service.drivers.base import Program
from service.drivers.ur.driver import UrDriver
from service.faults import FaultCode
from service.messages import CellState, StopRequest
from service.testing import Bench
from tests.service.cell import policies
from tests.service.cell.conftest import EASY
from tests.service.drivers.ur.emulated import lockstep_ur_cell, ur_cell_config
from tests.service.drivers.ur.test_cell import acknowledged, arm_of, assert_stands, running
from tests.service.drivers.ur.test_driver import FOREIGN
from wire.rtde.modes import RuntimeState


@pytest.fixture
async def cell(tmp_path: Path):
    config = ur_cell_config(tmp_path / "state", policies.straight(tmp_path), conditions="easy")
    async with lockstep_ur_cell(config) as bench:
        yield bench


async def test_a_slider_that_is_moved_latches_and_the_next_run_is_refused_until_it_is_back(cell: Bench) -> None:
    await running(cell)
    arm_of(cell).controller.set_speed_slider(0.3)
    await cell.state(CellState.LATCHED)
    assert cell.cell.journal.latch.code is FaultCode.AUTHORITY
    assert "slider" in cell.cell.journal.latch.text
    await assert_stands(cell)
    assert await acknowledged(cell) is None
    refused = await cell.insert(EASY)
    assert refused.code is FaultCode.AUTHORITY
    arm_of(cell).controller.set_speed_slider(1.0)
    await cell.let_pass(0.05)
    await running(cell)


async def test_34_a_run_that_was_paused_does_not_go_on_after_reset_and_resumption(cell: Bench) -> None:
    await running(cell)
    controller = arm_of(cell).controller
    controller.pause()
    await cell.state(CellState.LATCHED)
    assert cell.cell.journal.latch.code is FaultCode.AUTHORITY
    await cell.let_pass(0.2)
    assert await acknowledged(cell) is None
    before = arm_of(cell).plant.tcp_pose()
    controller.play()
    await cell.let_pass(0.5)
    assert cell.cell.newest_sample.program is Program.IDLE
    assert np.linalg.norm(np.subtract(arm_of(cell).plant.tcp_pose()[:3], before[:3])) < 1e-3
    await running(cell)


IDLE_PROGRAM = """
def foreign():
  while True:
    sync()
  end
end
"""
"""A program of somebody else that does not move the arm, yet."""


async def test_83_another_program_on_the_ready_arm_authority(cell: Bench) -> None:
    await cell.state(CellState.READY)
    await cell.let_pass(1.0)
    arm_of(cell).controller.run_script(IDLE_PROGRAM)
    await cell.state(CellState.LATCHED, limit_s=2.0)
    latch = cell.cell.status().latch
    assert latch.code is FaultCode.AUTHORITY
    assert "a program plays on the controller that is not this cell's" in latch.text
    assert any(event.code is FaultCode.AUTHORITY for event in cell.events), "in the journal"
    assert arm_of(cell).controller.program_name == "foreign", "a program under which the arm stands is left alone"
    arm_of(cell).controller.stop_program()
    assert await acknowledged(cell) is None
    await running(cell)


async def test_83_another_program_that_moves_the_ready_arm_is_ended(cell: Bench) -> None:
    await cell.state(CellState.READY)
    await cell.let_pass(1.0)
    arm_of(cell).controller.run_script(FOREIGN)
    await cell.state(CellState.LATCHED, limit_s=3.0)
    await cell.until(lambda: arm_of(cell).controller.runtime_state is RuntimeState.STOPPED, 3.0)
    latch = cell.cell.status().latch
    assert latch.code is FaultCode.STOP_UNCONFIRMED, "a stop of ours does not stop it"
    assert "Stopped for AUTHORITY" in latch.text
    assert any("the arm is being moved" in event.text for event in cell.events)
    await assert_stands(cell)


@pytest.mark.parametrize("ticks", [0, 1, 3, 10, 40, 80, 120])
async def test_a_stop_while_the_run_is_prepared_wins_and_nothing_engages(cell: Bench, ticks: int) -> None:
    arm = arm_of(cell)
    arm.controller.stop_program()  # so that it is sent anew
    await cell.let_pass(0.1)
    engaged = []
    arm.before_tick = lambda: engaged.append(arm.output("output_int_register_25") == Program.ENGAGED)
    starting = asyncio.create_task(cell.start(EASY))
    while cell.cell.state is not CellState.PREFLIGHT:
        await asyncio.sleep(0)
    await cell.let_pass(0.002 * ticks)
    cell.cell.stop(StopRequest())
    await starting
    await cell.state(CellState.LATCHED)
    await cell.let_pass(1.0)
    assert not any(engaged)
    assert cell.cell.journal.latch.code in (FaultCode.OPERATOR_STOP, FaultCode.STOP_UNCONFIRMED)
    assert arm.controller.robot_mode == 7, "nothing was escalated"


async def test_packages_that_come_twice_or_out_of_order_on_a_living_link_do_not_hide_a_force(cell: Bench) -> None:
    """The wire itself keeps order; this is a controller that does not."""
    await running(cell)
    arm = arm_of(cell)
    link = arm.driver._link
    take, kept = link._on_package, []

    def shuffled(package, arrival_s: float) -> None:
        kept.append((package, arrival_s))
        if len(kept) == 4:
            for each in (kept[1], kept[0], kept[3], kept[3], kept[2]):
                take(*each)
            kept.clear()

    link._on_package = shuffled  # type: ignore[method-assign]
    await cell.let_pass(0.1)
    assert cell.cell.state is CellState.RUNNING or cell.cell.journal.latch is not None
    ceiling_n = cell.cell.config.limits.force_ceiling_n
    arm.plant.flange_wrench = lambda: [0.0, 0.0, ceiling_n + 5.0, 0.0, 0.0, 0.0]  # type: ignore[method-assign]
    await cell.state(CellState.LATCHED)
    await assert_stands(cell)


async def test_a_defect_while_connecting_does_not_end_the_attempts(tmp_path: Path, monkeypatch) -> None:
    connect, attempts = UrDriver.connect, []

    async def breaks_once(self, sink) -> None:
        attempts.append(sink)
        if len(attempts) == 1:
            raise ValueError("a defect")
        await connect(self, sink)

    monkeypatch.setattr(UrDriver, "connect", breaks_once)
    config = ur_cell_config(tmp_path / "state", policies.straight(tmp_path), conditions="easy")
    async with asyncio.timeout(20.0), lockstep_ur_cell(config) as bench:
        assert bench.cell.state is CellState.READY
    assert len(attempts) == 2
