"""Stops of the controller for safety: protective stop, emergency stop and safeguard."""

import numpy as np
import pytest

from sim_backend.ur_controller import events
from sim_backend.ur_controller.events import Refused
from sim_backend.ur_controller.safety import UNLOCK_TOO_EARLY
from sim_backend.world.arm import PROTECTIVE_FORCE_N
from wire.rtde.modes import RobotMode, RuntimeState, SafetyMode

AWAY = "movej([0, -1.5, -1.5, -1.5, 1.5, 0], a=4, v=2)"


def lowered(bench, by_m):
    """Joints that bring the TCP straight down."""
    x, y, z, *turn = bench.plant.tcp_pose()
    return bench.controller.motion.joints_at([x, y, z - by_m, *turn])


def test_a_program_that_asks_for_a_protective_stop_stands_and_is_paused_there(bench):
    bench.program(
        f"thread mover():\n  {AWAY}\nend\nrun mover()\nsleep(0.4)\nprotective_stop()\nset_digital_out(0, True)"
    )
    bench.until(lambda: bench.controller.safety_mode is SafetyMode.PROTECTIVE_STOP)
    order = [type(event) for event in bench.heard]
    assert order == [events.ProgramStarted, events.SafetyChanged]
    bench.run(100)
    assert np.abs(bench.plant.qd).max() < 1e-2
    assert bench.get("actual_digital_output_bits") == 0
    assert bench.controller.runtime_state is RuntimeState.PAUSED
    with pytest.raises(Refused):
        bench.program(AWAY)
    with pytest.raises(Refused):
        bench.controller.play()
    bench.controller.unlock_protective_stop(at_once=True)
    bench.run(100)
    assert bench.get("actual_digital_output_bits") == 0, "unlocking resumes nothing"
    bench.controller.play()
    bench.until(lambda: bench.of(events.ProgramStopped))
    assert bench.get("actual_digital_output_bits") == 1


def test_a_protective_stop_is_unlocked_after_five_seconds_and_nothing_moves_by_itself(bench):
    bench.program(AWAY)
    bench.run(200)
    bench.controller.protective_stop("test")
    bench.run(100)
    with pytest.raises(Refused) as refused:
        bench.controller.unlock_protective_stop()
    assert str(refused.value) == UNLOCK_TOO_EARLY
    bench.run(2400)
    stood = bench.plant.q
    bench.controller.unlock_protective_stop()
    assert bench.controller.safety_mode is SafetyMode.NORMAL
    bench.run(200)
    assert bench.plant.q == pytest.approx(stood, abs=1e-4)
    bench.controller.stop_program()
    bench.heard.clear()
    bench.finish(AWAY)


def test_a_script_port_may_unlock_at_once(bench):
    bench.controller.protective_stop("test")
    bench.controller.unlock_protective_stop(at_once=True)
    assert bench.controller.safety_mode is SafetyMode.NORMAL


def test_too_much_force_is_a_protective_stop_and_the_arm_gives_way(bench):
    bench.plant.place((0.30, -0.35, 0.05))
    bench.run(50)
    peak = []
    bench.controller.events.append(
        lambda event: peak.append(bench.plant.true_force) if isinstance(event, events.SafetyChanged) else None
    )
    bench.program(f"movej({lowered(bench, 0.08)}, a=2, v=0.5)")
    bench.until(lambda: bench.controller.safety_mode is SafetyMode.PROTECTIVE_STOP)
    assert peak[0] > PROTECTIVE_FORCE_N or "deviates" in bench.of(events.SafetyChanged)[0].reason
    assert bench.controller.runtime_state is RuntimeState.PAUSED
    bench.run(200)
    assert bench.plant.true_force < PROTECTIVE_FORCE_N
    assert np.abs(bench.plant.qd).max() < 1e-2


def test_an_arm_off_its_path_is_a_protective_stop(bench):
    bench.run(10)
    bench.plant.world._qpos[0, 5] += 0.2
    bench.run(2)
    (changed,) = bench.of(events.SafetyChanged)
    assert changed.mode is SafetyMode.PROTECTIVE_STOP
    assert "joint 6" in changed.reason


def test_a_stop_for_safety_ends_secondary_programs_too(bench):
    bench.controller.run_script("sec wait():\n  sleep(0.1)\n  set_digital_out(1, True)\nend\n")
    bench.run(5)
    bench.controller.protective_stop("test")
    bench.controller.unlock_protective_stop(at_once=True)
    bench.run(100)
    assert bench.get("actual_digital_output_bits") == 0


def test_an_emergency_stop_takes_power_and_program_and_needs_the_whole_way_back(bench):
    controller = bench.controller
    bench.program(AWAY)
    bench.run(200)
    controller.press_emergency_stop()
    assert (controller.robot_mode, controller.safety_mode) == (RobotMode.POWER_OFF, SafetyMode.ROBOT_EMERGENCY_STOP)
    assert bench.of(events.ProgramStopped)
    bench.run(200)
    assert np.abs(bench.plant.qd).max() < 1e-2
    assert bench.get("joint_mode") == [239] * 6
    assert bench.get("actual_robot_voltage") == 0.0
    controller.release_emergency_stop()
    controller.brake_release()
    bench.until(lambda: controller.robot_mode is RobotMode.RUNNING)
    bench.heard.clear()
    bench.finish(AWAY)


def test_an_open_safeguard_pauses_and_a_closed_one_goes_on(bench):
    bench.program(f"{AWAY}\nwrite_output_integer_register(24, 1)")
    bench.run(200)
    bench.controller.open_safeguard()
    bench.until(lambda: bench.controller.runtime_state is RuntimeState.PAUSED)
    bench.run(50)
    assert np.abs(bench.plant.qd).max() < 1e-2
    with pytest.raises(Refused):
        bench.controller.play()
    bench.controller.close_safeguard()
    bench.until(lambda: bench.get("output_int_register_24") == 1)


def test_a_safeguard_does_not_resume_what_somebody_else_has_paused(bench):
    bench.program(AWAY)
    bench.run(100)
    bench.controller.pause()
    bench.controller.open_safeguard()
    bench.run(100)
    bench.controller.close_safeguard()
    bench.run(100)
    assert bench.controller.runtime_state is RuntimeState.PAUSED
