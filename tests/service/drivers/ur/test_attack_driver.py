"""Attacks on the driver: what a controller, a pendant or an earlier client may do to it between and under runs."""

import asyncio
import itertools

import numpy as np
import pytest

from service.drivers.base import DriverError, Program, StopReason
from service.drivers.ur import recovery, registers
from service.drivers.ur.registers import Command
from service.drivers.world_setup import LaidOut
from service.faults import FaultCode
from sim_backend.ur_controller.controller import Controller
from tests.service.drivers.ur.cells import ur_config
from tests.service.drivers.ur.emulated import Emulated, emulated
from tests.service.drivers.ur.test_driver import FOREIGN, LAW, LIMITS, TASK, engaged, step
from wire.records import TICK_S
from wire.rtde.modes import RobotMode, RuntimeState

SWING = """
def swing():
  while True:
    speedl([0.0, 0.0, 0.03, 0.0, 0.0, 0.0], 0.5, 0.1)
    speedl([0.0, 0.0, -0.03, 0.0, 0.0, 0.0], 0.5, 0.1)
  end
end
"""
"""A program of somebody else that goes on for ever."""


async def moving(arm: Emulated) -> None:
    """Engage and go down."""
    await engaged(arm)
    for _ in range(10):
        step(arm, -0.005)
        await arm.pass_time(0.02)
    assert np.abs(arm.plant.qd).max() > 0.02


def switched_off(controller: Controller) -> None:
    controller.power_off()


async def switched_on(arm: Emulated) -> None:
    arm.controller.power_on()
    await arm.pass_time(1.0)
    arm.controller.brake_release()
    await arm.until(lambda: arm.controller.robot_mode is RobotMode.RUNNING, 10.0)
    await arm.pass_time(0.1)


# --- the gate


async def test_what_the_gate_could_not_check_of_an_arm_without_power_is_checked_before_its_first_run() -> None:
    def off_and_deaf(controller: Controller) -> None:
        controller.power_off()
        controller._watch = lambda: None  # type: ignore[method-assign]

    async with emulated(prepare=off_and_deaf) as arm:
        await arm.driver.connect(arm)
        await switched_on(arm)
        with pytest.raises(DriverError, match="watchdog"):
            await arm.driver.prepare(TASK)


async def test_an_arm_that_is_switched_on_after_the_connection_is_proven_and_works() -> None:
    async with emulated(prepare=switched_off) as arm:
        await arm.driver.connect(arm)
        await switched_on(arm)
        await arm.driver.prepare(TASK)
        watchdog = next(check for check in arm.driver.checks if check.name == "watchdog")
        assert watchdog.verdict == "passed"
        arm.driver.engage(LAW, LIMITS)
        await arm.until(lambda: arm.samples[-1].program is Program.ENGAGED, 0.3)


@pytest.mark.parametrize(
    ("setter", "text"),
    [
        ("set_payload(0.3, [0.0, 0.0, 0.05])", "payload"),
        ("set_tcp(p[0.0, 0.0, 0.1898, 0.0, 0.0, 0.0])", "TCP"),
    ],
)
async def test_a_tool_that_somebody_else_sets_keeps_a_run_from_starting_and_ends_one(setter: str, text: str) -> None:
    """A secondary program runs beside ours and leaves it alone."""
    async with emulated() as arm:
        await moving(arm)
        arm.controller.run_script(f"sec setter():\n  {setter}\nend\n")
        await arm.until(lambda: bool(arm.faults), 0.1)
        assert arm.faults[0][0] is FaultCode.AUTHORITY
        assert text in arm.faults[0][1]
        arm.driver.stop()
        await arm.until(lambda: arm.samples[-1].program is Program.IDLE)
        with pytest.raises(DriverError, match=text):
            await arm.driver.prepare(TASK)


async def test_a_speed_slider_that_is_moved_under_a_run_is_a_fault() -> None:
    """The program's watch over force and age is stretched with the steps of its motion."""
    async with emulated() as arm:
        await moving(arm)
        arm.controller.set_speed_slider(0.1)
        await arm.until(lambda: bool(arm.faults), 0.1)
        assert arm.faults[0][0] is FaultCode.AUTHORITY
        assert "slider" in arm.faults[0][1]


# --- pause and resume


async def test_a_program_that_was_paused_moves_nothing_when_it_is_resumed_after_the_host_has_connected_again() -> None:
    async with emulated() as arm:
        await moving(arm)
        step(arm, -0.01)
        arm.controller.pause()
        await arm.until(lambda: arm.samples[-1].program is Program.IDLE, 0.1)
        assert arm.samples[-1].stop_reason is StopReason.PROGRAM_ENDED
        arm.driver.stop()
        await arm.pass_time(0.05)
        with pytest.raises(DriverError, match="paused"):
            await arm.driver.connect(arm)
        await arm.pass_time(0.2)
        assert arm.controller.runtime_state is RuntimeState.PAUSED
        before = arm.plant.tcp_pose()
        arm.controller.play()
        await arm.pass_time(0.25)
        assert arm.output(f"output_int_register_{registers.OUTPUT_PROGRAM}") == Program.IDLE
        assert np.linalg.norm(np.subtract(arm.plant.tcp_pose()[:3], before[:3])) < 1e-3


async def test_a_safeguard_that_closes_again_resumes_a_program_that_only_stops() -> None:
    async with emulated() as arm:
        await moving(arm)
        step(arm, -0.01)
        arm.controller.open_safeguard()
        await arm.until(lambda: arm.samples[-1].safety_mode != 1, 0.1)
        arm.driver.stop()
        await arm.pass_time(0.2)
        before = arm.plant.tcp_pose()
        arm.controller.close_safeguard()
        await arm.pass_time(0.3)
        assert np.linalg.norm(np.subtract(arm.plant.tcp_pose()[:3], before[:3])) < 1e-3


# --- numbers of orders


@pytest.mark.parametrize("left", [2**31 - 1, 2**31 - 2, -(2**31)])
async def test_a_number_that_an_earlier_client_left_in_the_registers_does_no_harm(left: int) -> None:
    def leave(controller: Controller) -> None:
        controller.output_registers.ints[registers.OUTPUT_HANDLED] = left
        controller.inputs.registers.ints[registers.INPUT_SEQUENCE] = left
        controller.inputs.registers.ints[registers.INPUT_COMMAND] = Command.ENGAGE

    async with emulated(prepare=leave) as arm:
        await moving(arm)
        arm.driver.stop()
        await arm.until(lambda: arm.samples[-1].program is Program.IDLE)
        assert arm.samples[-1].stop_reason is StopReason.COMMAND


# --- the last resort


async def test_the_last_resort_does_not_take_one_slow_sample_for_rest() -> None:
    """An arm that swings is slow for a moment at every turn."""
    async with emulated() as arm:
        await engaged(arm)
        arm.controller.run_script(SWING)
        arm.controller.stop_program = lambda: None  # type: ignore[method-assign]
        await arm.pass_time(0.5)
        arm.driver.escalate()
        async with asyncio.timeout(20.0):
            while arm.controller.robot_mode is not RobotMode.POWER_OFF:
                await asyncio.sleep(0)


async def test_the_last_resort_cuts_the_power_of_an_arm_that_stands_while_its_program_goes_on() -> None:
    async with emulated() as arm:
        await engaged(arm)
        arm.controller.stop_program = lambda: None  # type: ignore[method-assign]
        arm.driver.escalate()
        async with asyncio.timeout(20.0):
            while arm.controller.robot_mode is not RobotMode.POWER_OFF:
                await asyncio.sleep(0)


async def test_the_last_resort_ends_a_paused_program_too() -> None:
    async with emulated() as arm:
        await engaged(arm)
        arm.controller.run_script(FOREIGN)
        await arm.pass_time(0.2)
        arm.controller.pause()
        await arm.pass_time(0.2)
        arm.driver.escalate()
        await arm.until(lambda: arm.controller.runtime_state is RuntimeState.STOPPED, 2.0)
        assert arm.controller.robot_mode is RobotMode.RUNNING


async def test_the_last_resort_cuts_the_power_although_the_first_errand_breaks(monkeypatch) -> None:
    async def breaks(ur) -> None:
        raise RuntimeError("a defect")

    monkeypatch.setattr(recovery, "stop_program", breaks)
    async with emulated() as arm:
        await engaged(arm)
        arm.controller.run_script(SWING)
        await arm.pass_time(0.3)
        arm.driver.escalate()
        async with asyncio.timeout(20.0):
            while arm.controller.robot_mode is not RobotMode.POWER_OFF:
                await asyncio.sleep(0)


async def test_a_dashboard_that_never_answers_holds_the_last_resort_up_for_a_moment_only(monkeypatch) -> None:
    async def hangs(ur) -> None:
        await asyncio.sleep(3600)

    cut = asyncio.Event()

    async def power_off(ur) -> None:
        cut.set()
        raise OSError("gone")

    monkeypatch.setattr(recovery, "stop_program", hangs)
    monkeypatch.setattr(recovery, "power_off", power_off)
    async with emulated() as arm:
        await engaged(arm)
        arm.controller.run_script(SWING)
        arm.driver.escalate()
        async with asyncio.timeout(10.0):
            await cut.wait()


async def test_the_last_resort_ends_our_program_without_a_dashboard(monkeypatch) -> None:
    async def refused(ur) -> None:
        raise OSError("gone")

    monkeypatch.setattr(recovery, "stop_program", refused)
    monkeypatch.setattr(recovery, "power_off", refused)
    async with emulated() as arm:
        await engaged(arm)
        arm.driver.escalate()
        await arm.until(lambda: arm.controller.runtime_state is RuntimeState.STOPPED, 0.2)
        await arm.pass_time(1.0)
        await arm.driver.prepare(TASK)
        assert arm.controller.runtime_state is RuntimeState.PLAYING, "the next run is heard again"


async def test_an_unlocked_arm_has_no_program_that_could_go_on() -> None:
    """A controller pauses a program at a protective stop; it does not end it."""
    async with emulated() as arm:
        await moving(arm)
        controller = arm.controller
        controller.protective_stop("test")
        await arm.until(lambda: arm.samples[-1].program is Program.PROTECTIVE_STOP)
        await arm.pass_time(5.5)
        assert controller.runtime_state is RuntimeState.PAUSED
        arm.driver.unlock()
        await arm.until(lambda: arm.samples[-1].safety_mode == 1)
        await arm.pass_time(0.1)
        assert controller.runtime_state is RuntimeState.STOPPED


# --- the world of a simulated arm


async def test_a_world_of_another_controller_is_not_this_arm_s() -> None:
    """`simulated` with the address of a real arm: the world setup lays out a world that the arm is not in."""
    async with emulated() as arm:
        await arm.driver.connect(arm)
        await arm.pass_time(0.5)
        world_setup = arm.driver._world_setup
        assert world_setup is not None
        lay_out = world_setup.lay_out

        async def of_another(task) -> LaidOut:
            laid_out = await lay_out(task)
            return LaidOut(laid_out.episode, laid_out.time_s - 30.0)

        world_setup.lay_out = of_another  # type: ignore[method-assign]
        with pytest.raises(DriverError, match="another"):
            await arm.driver.prepare(TASK)


# --- a link that grows slow


async def test_a_link_whose_delay_creeps_up_is_stale() -> None:
    """No sample comes much later than the one before, so that only an order's way there and back shows it."""
    async with emulated() as arm:
        await moving(arm)
        receive = arm.controller.inputs.receive
        delay = 0

        def late(names, values, due: int) -> None:
            receive(names, values, due + delay)

        arm.controller.inputs.receive = late  # type: ignore[method-assign]
        for _ in range(100):
            delay += 2
            step(arm, 0.0)
            await arm.pass_time(10 * TICK_S)
            if arm.faults:
                break
        assert [code for code, _ in arm.faults] == [FaultCode.STALE]


async def test_an_arm_that_is_found_engaged_and_takes_no_stop_is_not_connected() -> None:
    async with emulated(ur_config(ur={"watchdog_hz": 2.0})) as arm:
        await moving(arm)
        await arm.driver._link.close()
        receive = arm.controller.inputs.receive
        numbers = itertools.count(1_000_000)

        def deaf(names, values, due: int) -> None:
            pose = arm.controller.motion.target_tcp_pose()
            receive(names, (next(numbers), Command.TARGET, *pose, *([0.0] * 18)), due)

        arm.controller.inputs.receive = deaf  # type: ignore[method-assign]
        with pytest.raises(DriverError, match="does not take a stop") as refused:
            await arm.driver.connect(arm)
        assert refused.value.code is FaultCode.AUTHORITY
