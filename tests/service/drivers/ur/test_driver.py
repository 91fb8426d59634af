"""The driver against an emulated controller, over real sockets."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import numpy as np
import pytest

from service.drivers.base import DriverError, PoseTarget, Program, StopReason
from service.drivers.ur.driver import UrDriver
from service.drivers.ur.gate import Verdict
from service.faults import FaultCode
from sim_backend.ur_controller.controller import Controller
from tests.service.drivers.ur.cells import ur_config
from tests.service.drivers.ur.emulated import Emulated, emulated
from training.environment.design import LAW
from wire.law import ControlLimits
from wire.records import TICK_S
from wire.rtde.modes import RobotMode, RuntimeState, SafetyMode
from wire.task import Task

TASK = Task(3, "tr", 2e-3, "easy")
LIMITS = ControlLimits(ur_config().limits.workspace_m, 30.0, (0.1, 3.0), (0.012, 0.3), 0.3)

FOREIGN = """
def foreign():
  while True:
    speedl([0.0, 0.0, 0.03, 0.0, 0.0, 0.0], 0.5, 0.1)
  end
end
"""
"""A program that somebody else runs."""


async def engaged(arm: Emulated) -> None:
    """Connect, prepare, zero and engage, as a run does."""
    await arm.driver.connect(arm)
    await arm.driver.prepare(TASK)
    arm.driver.zero_ft()
    await arm.pass_time(0.1)
    arm.driver.engage(LAW, LIMITS)
    await arm.until(lambda: arm.samples[-1].program is Program.ENGAGED, 0.2)


def step(arm: Emulated, dz: float) -> int:
    sample = arm.samples[-1]
    x, y, z = sample.tcp_position
    return arm.driver.send_target(PoseTarget(np.array([x, y, z + dz]), sample.tcp_rotvec))


async def test_a_connection_passes_the_gate_and_brings_a_sample_for_every_tick() -> None:
    async with emulated() as arm:
        felt = {}
        arm.before_tick = lambda: felt.update({round(arm.controller.time_s / TICK_S): arm.plant.wrench})
        await arm.driver.connect(arm)
        assert {check.verdict for check in arm.driver.checks} == {Verdict.PASSED}
        await arm.until(lambda: len(arm.samples) >= 50)
        assert np.all(np.diff([sample.seq for sample in arm.samples]) == 1)
        sample = arm.samples[-1]
        assert (sample.program, sample.stop_reason) == (Program.IDLE, StopReason.NONE)
        assert (sample.robot_mode, sample.safety_mode) == (7, 1)
        assert sample.tcp_position == pytest.approx(arm.plant.world.position[0], abs=1e-6)
        for sample in arm.samples[:40]:
            assert sample.wrench == pytest.approx(felt[sample.seq], abs=1e-6), "the torque is about the TCP"
        assert arm.faults == []


async def test_a_target_is_echoed_at_once_and_the_arm_goes_there() -> None:
    async with emulated() as arm:
        await engaged(arm)
        start_z = arm.plant.world.position[0, 2]
        sent_s = arm.controller.time_s
        number = step(arm, -0.01)
        await arm.until(lambda: arm.samples[-1].command_seq == number)
        assert arm.controller.time_s - sent_s <= (3 + arm.plant.input_delay) * TICK_S
        goal = start_z - 0.01
        while arm.plant.world.position[0, 2] > goal + 1e-3:
            sample = arm.samples[-1]
            arm.driver.send_target(PoseTarget(np.array([*sample.tcp_position[:2], goal]), sample.tcp_rotvec))
            await arm.pass_time(0.05)
        arm.driver.stop()
        await arm.until(lambda: arm.samples[-1].program is Program.IDLE)
        assert arm.samples[-1].stop_reason is StopReason.COMMAND
        assert arm.plant.world.position[0, 2] == pytest.approx(goal, abs=1.5e-3)


async def test_a_zero_that_was_asked_just_before_engaging_is_not_lost() -> None:
    async with emulated() as arm:
        await arm.driver.connect(arm)
        await arm.driver.prepare(TASK)
        await arm.pass_time(0.3)
        biased = np.mean([sample.wrench for sample in arm.samples[-100:]], axis=0)
        arm.driver.zero_ft()
        arm.driver.engage(LAW, LIMITS)
        await arm.until(lambda: arm.samples[-1].program is Program.ENGAGED, 0.2)
        await arm.pass_time(0.25)
        zeroed = np.mean([sample.wrench for sample in arm.samples[-100:]], axis=0)
        assert np.linalg.norm(biased[:3]) > 1.5
        assert np.linalg.norm(zeroed[:3]) < 0.6


async def test_a_program_that_somebody_stops_is_said_to_have_ended_and_starts_again_with_the_next_run() -> None:
    async with emulated() as arm:
        await engaged(arm)
        arm.controller.stop_program()
        await arm.until(lambda: arm.samples[-1].program is Program.IDLE)
        assert arm.samples[-1].stop_reason is StopReason.PROGRAM_ENDED
        await arm.pass_time(0.3)
        assert arm.controller.runtime_state is RuntimeState.STOPPED, "nothing starts by itself"
        await arm.driver.prepare(TASK)
        await arm.pass_time(0.02)
        assert arm.controller.runtime_state is RuntimeState.PLAYING
        assert (arm.samples[-1].program, arm.samples[-1].stop_reason) == (Program.IDLE, StopReason.NONE)


async def test_another_program_on_the_controller_is_left_alone() -> None:
    async with emulated(prepare=lambda controller: controller.run_script(FOREIGN)) as arm:
        with pytest.raises(DriverError, match="another program") as refused:
            await arm.driver.connect(arm)
        assert refused.value.code is FaultCode.AUTHORITY
        assert arm.controller.program_name == "foreign"
        assert arm.controller.runtime_state is RuntimeState.PLAYING


async def test_a_program_that_replaces_ours_is_not_taken_for_it() -> None:
    async with emulated() as arm:
        await engaged(arm)
        arm.controller.run_script(FOREIGN)
        await arm.until(lambda: arm.samples[-1].program is Program.IDLE, 0.3)
        assert arm.samples[-1].stop_reason is StopReason.PROGRAM_ENDED


async def test_two_drivers_of_one_arm_are_one_too_many_and_the_register_is_named() -> None:
    async with emulated() as arm:
        await arm.driver.connect(arm)
        second = UrDriver(arm.config, mode="lockstep")
        with pytest.raises(DriverError, match="input_int_register_24") as refused:
            await second.connect(arm)
        assert refused.value.code is FaultCode.AUTHORITY
        await second.close()
        await arm.pass_time(0.1)
        assert arm.faults == []


@pytest.mark.parametrize(
    ("spoil", "text"),
    [
        (lambda controller: setattr(controller, "remote_control", False), "remote control"),
        (Controller.power_off, "robot mode"),
        (lambda controller: controller.protective_stop("test"), "safety mode"),
        (lambda controller: controller.set_speed_slider(0.4), "speed slider"),
    ],
)
async def test_an_arm_that_is_not_ready_is_connected_and_refuses_a_run_with_what_to_do(spoil, text: str) -> None:
    async with emulated(prepare=spoil) as arm:
        await arm.driver.connect(arm)
        await arm.pass_time(0.05)
        assert arm.samples, "the operator sees the arm"
        assert arm.controller.runtime_state is not RuntimeState.PLAYING
        with pytest.raises(DriverError, match=text) as refused:
            await arm.driver.prepare(TASK)
        assert refused.value.code is FaultCode.AUTHORITY


@asynccontextmanager
async def real_arm(spoil: Callable[[Controller], None] = lambda controller: None) -> AsyncIterator[Emulated]:
    """An emulated controller with a driver that takes it for a real arm, whose world nobody lays out."""
    async with emulated(prepare=spoil) as arm:
        await arm.driver.close()
        arm.driver = UrDriver(arm.config, mode="lockstep")
        yield arm
        await arm.driver.close()


def press(controller: Controller) -> None:
    """Press the tool onto the block beside the hole, with about 17 N."""
    plant = controller.plant
    x, y, z = plant.truth()["hole_position"]
    plant.place((x + 0.045, y, z - 1.25e-3), plant.truth()["hole_yaw"])
    for _ in range(500):
        controller.tick()


async def test_09_a_tool_pressed_onto_the_block_gets_no_program_that_would_zero_the_force_away() -> None:
    async with real_arm(press) as arm:
        load_n = float(np.linalg.norm(arm.plant.world.contact_force[0]))
        assert 14.0 < load_n < 20.0
        await arm.driver.connect(arm)
        assert arm.controller.runtime_state is RuntimeState.STOPPED
        with pytest.raises(DriverError, match=r"F/T load.*free the tool") as refused:
            await arm.driver.prepare(None)
        assert refused.value.code is FaultCode.CONTACT_AT_START
        assert f"{load_n:.0f}" in str(refused.value) or "N·m beside the payload" in str(refused.value)
        assert arm.controller.runtime_state is RuntimeState.STOPPED, "the sensor was not zeroed by a program's start"
        arm.plant.place((0.3, -0.11, 0.18))
        await arm.pass_time(0.5)
        await arm.driver.prepare(None)
        assert arm.controller.runtime_state is RuntimeState.PLAYING


async def test_09_a_force_that_a_program_s_start_has_zeroed_away_is_still_seen_in_the_samples() -> None:
    async with real_arm(press) as arm:
        arm.controller.run_script("def theirs():\n  sync()\nend\n")
        await arm.pass_time(0.5)
        await arm.driver.connect(arm)
        await arm.pass_time(0.3)
        window = arm.samples[-50:]
        assert np.linalg.norm(np.mean([sample.wrench[:3] for sample in window], axis=0)) < 3.0
        assert np.linalg.norm(np.mean([sample.unzeroed[:3] for sample in window], axis=0)) > 12.0
        assert np.linalg.norm(np.mean([sample.joint_force for sample in window], axis=0)) > 12.0


async def test_the_gate_names_another_robot_at_the_address() -> None:
    async with real_arm() as arm:
        assert arm.config.ur is not None
        ur = arm.config.ur.model_copy(update={"serial": "20235300099"})
        arm.driver = UrDriver(arm.config.model_copy(update={"ur": ur}), mode="lockstep")
        with pytest.raises(DriverError, match=r"serial number 20235300042, wanted .*20235300099"):
            await arm.driver.connect(arm)
        assert arm.controller.runtime_state is RuntimeState.STOPPED


async def test_a_controller_with_polyscope_x_is_refused_by_name() -> None:
    async with real_arm(lambda controller: setattr(controller, "versions", (10, 7, 0, 0))) as arm:
        with pytest.raises(DriverError, match=r"PolyScope: X, 10\.7\.0"):
            await arm.driver.connect(arm)


async def test_a_protective_stop_is_unlocked_by_an_operator_only_and_after_five_seconds() -> None:
    async with emulated() as arm:
        await engaged(arm)
        arm.controller.protective_stop("test")
        await arm.until(lambda: arm.samples[-1].program is Program.PROTECTIVE_STOP)
        arm.driver.unlock()
        await arm.pass_time(5.5)
        assert arm.controller.safety_mode is SafetyMode.PROTECTIVE_STOP, "too early, and never asked again by itself"
        arm.driver.unlock()
        await arm.until(lambda: arm.controller.safety_mode is SafetyMode.NORMAL)
        await arm.pass_time(0.2)
        assert arm.controller.runtime_state is RuntimeState.STOPPED
        await arm.driver.prepare(TASK)
        assert arm.controller.runtime_state is RuntimeState.PLAYING


async def test_a_stop_is_repeated_until_the_program_has_seen_it() -> None:
    async with emulated() as arm:
        await engaged(arm)
        for _ in range(10):
            step(arm, -0.005)
            await arm.pass_time(0.02)
        lost = arm.controller.inputs.receive
        arm.controller.inputs.receive = lambda names, values, due: None  # type: ignore[method-assign]
        arm.driver.stop()
        await arm.pass_time(0.03)
        arm.controller.inputs.receive = lost  # type: ignore[method-assign]
        await arm.until(lambda: arm.samples[-1].program is Program.STOPPING, 0.03)
        assert arm.samples[-1].stop_reason is StopReason.COMMAND


async def test_a_host_that_hears_nothing_writes_nothing_and_the_watchdog_ends_the_program() -> None:
    async with emulated() as arm:
        await engaged(arm)
        for _ in range(10):
            step(arm, -0.005)
            await arm.pass_time(0.02)
        before = arm.controller.time_s
        for _ in range(120):  # the driver's loop hangs: the world goes on, and nobody reads
            arm.server.step()
            if arm.controller.runtime_state is not RuntimeState.PLAYING:
                break
        assert arm.controller.time_s - before == pytest.approx(0.1, abs=0.015)
        for _ in range(60):
            arm.server.step()
        assert np.abs(arm.plant.qd).max() < 1e-3


async def test_the_last_resort_ends_a_program_that_does_not_obey() -> None:
    async with emulated() as arm:
        await engaged(arm)
        arm.controller.run_script(FOREIGN)
        await arm.pass_time(0.3)
        assert np.abs(arm.plant.qd).max() > 0.02, "it moves whatever the registers say"
        arm.driver.escalate()
        await arm.until(lambda: arm.controller.runtime_state is RuntimeState.STOPPED)
        await arm.pass_time(0.3)
        assert np.abs(arm.plant.qd).max() < 1e-3
        assert arm.controller.robot_mode is RobotMode.RUNNING, "the program's end was enough"


async def test_the_last_resort_cuts_the_power_where_the_program_s_end_does_not_help() -> None:
    async with emulated() as arm:
        await engaged(arm)
        arm.controller.run_script(FOREIGN)
        arm.controller.stop_program = lambda: None  # type: ignore[method-assign]
        await arm.pass_time(0.3)
        arm.driver.escalate()
        async with asyncio.timeout(20.0):
            while arm.controller.robot_mode is not RobotMode.POWER_OFF:
                await asyncio.sleep(0)
        await arm.pass_time(0.3)
        assert np.abs(arm.plant.qd).max() < 1e-3


async def test_a_world_that_somebody_else_lays_out_is_a_fault_of_the_source() -> None:
    async with emulated() as arm:
        await arm.driver.connect(arm)
        await arm.driver.prepare(TASK)
        await arm.pass_time(0.05)
        assert arm.faults == []
        assert arm.driver._world_setup is not None
        await arm.driver._world_setup.lay_out(TASK)
        await arm.pass_time(0.02)
        assert [code for code, _ in arm.faults] == [FaultCode.SOURCE]


async def test_a_lost_connection_is_told_once_and_a_controller_that_is_gone_named() -> None:
    async with emulated() as arm:
        await engaged(arm)
        arm.paused = True
        arm.server.close()
        while not arm.faults:
            await asyncio.sleep(0)
        assert [code for code, _ in arm.faults] == [FaultCode.LINK]
        with pytest.raises(DriverError) as refused:
            await arm.driver.connect(arm)
        assert refused.value.code is FaultCode.LINK


async def test_an_arm_that_is_found_engaged_is_stopped_before_anything_else() -> None:
    async with emulated(ur_config(ur={"watchdog_hz": 2.0})) as arm:
        await engaged(arm)
        for _ in range(10):
            step(arm, -0.005)
            await arm.pass_time(0.02)
        await arm.driver._link.close()
        arm.samples.clear()
        await arm.driver.connect(arm)
        await arm.until(lambda: len(arm.samples) > 1)
        sample = arm.samples[0]
        assert (sample.program, sample.stop_reason) == (Program.IDLE, StopReason.COMMAND)
        assert np.abs(sample.qd).max() < 1e-3
        assert arm.controller.runtime_state is RuntimeState.PLAYING, "it is the same program"


async def test_a_real_arm_has_no_seed() -> None:
    async with emulated() as arm:
        real = UrDriver(arm.config, mode="lockstep")
        assert not real.simulated
        with pytest.raises(DriverError, match="no seed"):
            await real.prepare(TASK)


async def test_a_watchdog_that_does_not_work_keeps_the_cell_unconnected() -> None:
    def deaf(controller: Controller) -> None:
        controller._watch = lambda: None  # type: ignore[method-assign]

    async with emulated(prepare=deaf) as arm:
        with pytest.raises(DriverError, match="watchdog"):
            await arm.driver.connect(arm)
        assert [check.name for check in arm.driver.checks if check.verdict is Verdict.FAILED] == ["watchdog"]
