"""The controller as a whole, tick by tick; what the arm does is judged by what is measured."""

import numpy as np
import pytest

from sim_backend.ur_controller import events
from sim_backend.ur_controller.events import Refused
from sim_backend.ur_controller.interpreter import MOST_SECONDARIES
from sim_backend.ur_controller.safety import UNLOCK_TOO_EARLY
from sim_backend.world.arm import PROTECTIVE_FORCE_N
from wire.rtde.modes import RobotMode, RuntimeState, SafetyMode
from wire.task import Task

AWAY = "movej([0, -1.5, -1.5, -1.5, 1.5, 0], a=4, v=2)"
COUNT = "n = 0\nwhile True:\n  n = n + 1\n  write_output_integer_register(24, n)\n  sync()\nend"


def lowered(bench, by_m):
    """Joints that bring the TCP straight down."""
    x, y, z, *turn = bench.plant.tcp_pose()
    return bench.controller.motion.joints_at([x, y, z - by_m, *turn])


def test_time_lies_on_the_grid_of_two_milliseconds(bench):
    first = bench.controller.time_s
    assert first >= 40.0
    bench.run(1234)
    assert bench.controller.time_s == (round(first * 500) + 1234) / 500
    assert bench.get("timestamp") == bench.controller.time_s


def test_without_a_program_the_arm_holds(bench):
    bench.run(100)
    before = bench.plant.q
    bench.run(300)
    assert bench.plant.q == pytest.approx(before, abs=1e-5)
    assert bench.controller.runtime_state is RuntimeState.STOPPED


def test_a_program_moves_the_arm_and_is_reported_from_start_to_end(bench):
    bench.controller.run_script(f"def there():\n  {AWAY}\n  write_output_integer_register(24, 7)\nend\n")
    assert bench.heard == [events.ProgramStarted("there")]
    bench.run(1)
    assert bench.controller.runtime_state is RuntimeState.PLAYING
    assert bench.controller.robot_status_bits == 0b11
    bench.until(lambda: bench.controller.runtime_state is RuntimeState.STOPPED)
    assert bench.heard[-1] == events.ProgramStopped("there")
    assert bench.plant.q == pytest.approx([0, -1.5, -1.5, -1.5, 1.5, 0], abs=2e-3)
    assert bench.get("output_int_register_24") == 7
    assert bench.controller.robot_status_bits == 0b01


def test_a_text_that_does_not_compile_is_reported_and_the_running_program_goes_on(bench):
    bench.program(COUNT)
    bench.run(5)
    bench.controller.run_script("def broken():\n  nothing_of_that_name(1)\nend\n")
    (failed,) = bench.of(events.CompileFailed)
    assert failed.line == 2
    assert "nothing_of_that_name" in failed.text
    bench.run(5)
    assert bench.get("output_int_register_24") == 10


def test_a_program_that_cannot_go_on_is_reported_with_its_place_and_stops(bench):
    bench.controller.run_script('def wrong():\n  textmsg("here")\n  write_output_integer_register(99, 1)\nend\n')
    bench.run(2)
    text, failed, stopped = bench.heard[1:]
    assert text == events.Text("here")
    assert (failed.line, failed.thread) == (3, "wrong")
    assert "99" in failed.text
    assert stopped == events.ProgramStopped("wrong")
    assert bench.controller.runtime_state is RuntimeState.STOPPED


def test_a_new_program_takes_the_place_of_the_old_once_the_arm_rests(bench):
    bench.program(AWAY)
    bench.run(200)
    assert np.abs(bench.plant.qd).max() > 0.1
    bench.controller.run_script(
        "def next():\n  write_output_float_register(24, norm(get_actual_joint_speeds()))\nend\n"
    )
    assert [type(event) for event in bench.heard[1:]] == [events.ProgramStopped, events.ProgramStarted]
    bench.until(lambda: len(bench.of(events.ProgramStopped)) == 2)
    assert bench.get("output_double_register_24") < 0.1


def test_a_stop_decelerates_and_ends_at_rest_short_of_the_goal(bench):
    bench.program(AWAY)
    bench.run(200)
    bench.controller.stop_program()
    assert bench.controller.runtime_state is RuntimeState.STOPPING
    passed = bench.until(lambda: bench.controller.runtime_state is RuntimeState.STOPPED)
    assert passed > 5
    bench.run(50)
    assert np.abs(bench.plant.qd).max() < 1e-2
    assert bench.plant.q[5] < -0.2


def test_a_pause_comes_to_rest_and_play_goes_on_to_the_goal(bench):
    bench.program(f"{AWAY}\nwrite_output_integer_register(24, 1)")
    bench.run(300)
    bench.controller.pause()
    bench.until(lambda: bench.controller.runtime_state is RuntimeState.PAUSED)
    bench.run(30)
    held = bench.plant.q
    bench.run(200)
    assert bench.plant.q == pytest.approx(held, abs=1e-3)
    assert bench.get("output_int_register_24") == 0
    bench.controller.play()
    bench.until(lambda: bench.get("output_int_register_24") == 1)
    assert bench.plant.q == pytest.approx([0, -1.5, -1.5, -1.5, 1.5, 0], abs=2e-3)


def test_a_slower_slider_takes_longer_for_the_same_way(bench):
    def ticks():
        bench.finish(AWAY)
        bench.heard.clear()
        bench.program("movej([0, -1.5, -1.5, -1.5, 1.5, 1], a=4, v=2)")
        return bench.until(lambda: bench.of(events.ProgramStopped))

    full = ticks()
    bench.controller.set_speed_slider(0.5)
    bench.heard.clear()
    assert ticks() == pytest.approx(2 * full, rel=0.05)
    assert bench.get("target_speed_fraction") == bench.get("speed_scaling") == 0.5


@pytest.mark.parametrize(("asked", "got"), [(7.0, 1.0), (-1.0, 0.0), (float("nan"), 1.0)])
def test_no_speed_beyond_the_sliders_ends(bench, asked, got):
    bench.controller.set_speed_slider(asked)
    assert bench.controller.speed_slider == got


def test_secondary_programs_run_beside_the_main_one_and_leave_it_alone(bench):
    bench.program(COUNT)
    bench.run(3)
    bench.controller.run_script("sec mark():\n  write_output_integer_register(25, 5)\nend\n")
    bench.run(3)
    assert bench.get("output_int_register_25") == 5
    assert bench.get("output_int_register_24") == 6
    assert bench.controller.program_name == "tested"
    assert not bench.of(events.ProgramStopped)


def test_secondary_programs_are_bounded_and_run_without_power(bench):
    bench.controller.power_off()
    for _ in range(MOST_SECONDARIES):
        bench.controller.run_script("sec wait():\n  sleep(0.01)\n  set_digital_out(1, True)\nend\n")
    with pytest.raises(Refused, match="secondary"):
        bench.controller.run_script("sec wait():\n  sleep(0.01)\nend\n")
    bench.run(10)
    assert bench.get("actual_digital_output_bits") == 0b10
    bench.controller.run_script("sec wait():\n  sleep(0.01)\nend\n")


def test_a_stop_for_safety_ends_secondary_programs_too(bench):
    bench.controller.run_script("sec wait():\n  sleep(0.1)\n  set_digital_out(1, True)\nend\n")
    bench.run(5)
    bench.controller.protective_stop("test")
    bench.controller.unlock_protective_stop(at_once=True)
    bench.run(100)
    assert bench.get("actual_digital_output_bits") == 0


def test_loaded_programs_are_played_by_name(bench):
    controller = bench.controller
    with pytest.raises(Refused, match="Failed to execute: play"):
        controller.play()
    with pytest.raises(Refused, match=r"File not found: none\.urp"):
        controller.load("none.urp")
    controller.programs["count.urp"] = f"def count():\n{COUNT}\nend\n"
    controller.load("count.urp")
    controller.play()
    assert controller.program_name == "count"
    with pytest.raises(Refused):
        controller.play()
    with pytest.raises(Refused, match=r"Error while loading program: count\.urp"):
        controller.load("count.urp")
    controller.stop_program()
    with pytest.raises(Refused, match="Failed to execute: pause"):
        controller.pause()


def test_a_program_cannot_start_on_a_robot_that_may_not_move(bench):
    bench.controller.power_off()
    with pytest.raises(Refused, match="POWER_OFF"):
        bench.program(AWAY)
    assert not bench.heard


def test_what_a_client_writes_takes_effect_with_the_latency_of_the_episode(bench):
    delay = bench.plant.input_delay
    assert delay == 2
    bench.controller.apply_inputs(("input_int_register_24", "input_double_register_47"), (5, 2.5))
    bench.run(delay)
    assert bench.get("input_int_register_24") == 0
    bench.run(1)
    assert (bench.get("input_int_register_24"), bench.get("input_double_register_47")) == (5, 2.5)


def test_every_input_reaches_what_it_is_for(bench):
    names = {
        "input_bit_registers0_to_31": 1 << 31 | 1,
        "input_bit_register_64": True,
        "speed_slider_mask": 1,
        "speed_slider_fraction": 0.25,
        "standard_digital_output_mask": 0b110,
        "standard_digital_output": 0b011,
        "configurable_digital_output_mask": 1,
        "configurable_digital_output": 1,
        "tool_digital_output_mask": 2,
        "tool_digital_output": 2,
        "standard_analog_output_mask": 0b11,
        "standard_analog_output_type": 0b10,
        "standard_analog_output_0": 0.5,
        "standard_analog_output_1": float("nan"),
    }
    bench.controller.apply_inputs(tuple(names), tuple(names.values()))
    bench.run(3)
    assert bench.get("input_bit_registers0_to_31") == 1 << 31 | 1
    assert bench.get("input_bit_register_64") is True
    assert bench.get("target_speed_fraction") == 0.25
    assert bench.get("actual_digital_output_bits") == 0b10 | 1 << 8 | 1 << 17
    assert bench.get("standard_analog_output0") == pytest.approx(0.012)
    assert bench.get("standard_analog_output1") == 0.0
    assert bench.get("analog_io_types") >> 2 == 0b10
    # a value without its mask counts for nothing
    bench.controller.apply_inputs(("standard_digital_output",), (0xFF,))
    bench.run(3)
    assert bench.get("actual_digital_output_bits") == 0b10 | 1 << 8 | 1 << 17


def feed(bench, ticks, every=1):
    for tick in range(ticks):
        if tick % every == 0:
            bench.controller.apply_inputs(("input_int_register_24",), (1,))
        bench.run(1)


@pytest.mark.parametrize(
    ("action", "state"),
    [("stop", RuntimeState.STOPPED), ("pause", RuntimeState.PAUSED), ("ignore", RuntimeState.PLAYING)],
)
def test_a_watchdog_acts_when_packages_stop_coming_and_not_before(bench, action, state):
    bench.program(f'rtde_set_watchdog("input_int_register_24", 50, "{action}")\n{COUNT}')
    feed(bench, 101, every=10)
    assert bench.controller.runtime_state is RuntimeState.PLAYING
    bench.run(10)
    assert bench.controller.runtime_state is RuntimeState.PLAYING
    bench.run(80)
    assert bench.controller.runtime_state is state


def test_a_moving_arm_comes_to_rest_by_its_watchdog(bench):
    bench.program('rtde_set_watchdog("input_int_register_24", 25, "stop")\nspeedj([0,0,0,0,0,0.5], 5, 10)')
    feed(bench, 200)
    assert bench.plant.qd[5] == pytest.approx(0.5, abs=0.02)
    bench.run(100)
    assert np.abs(bench.plant.qd).max() < 1e-2
    assert bench.controller.runtime_state is RuntimeState.STOPPED


def test_a_watchdog_ends_with_its_program(bench):
    bench.program('rtde_set_watchdog("input_int_register_24", 500, "stop")\nsync()')
    bench.run(3)
    bench.heard.clear()
    bench.program(COUNT)
    bench.run(50)
    assert bench.controller.runtime_state is RuntimeState.PLAYING


@pytest.mark.parametrize(
    "call", ['rtde_set_watchdog("actual_q", 10)', 'rtde_set_watchdog("input_int_register_24", 10, "explode")']
)
def test_a_watchdog_that_cannot_be_is_an_error_of_the_program(bench, call):
    bench.program(call)
    bench.run(2)
    assert bench.of(events.RuntimeFailed)


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


def mean_force(bench, name: str, ticks: int) -> np.ndarray:
    """The mean force (3,) of an RTDE output over the next ticks."""
    forces = []
    for _ in range(ticks):
        bench.run(1)
        forces.append(bench.get(name)[:3])
    return np.mean(forces, axis=0)


def test_a_controller_zeroes_its_sensor_when_a_program_starts_in_contact_too(bench):
    bench.run(200)
    bench.plant.place((0.30, -0.35, -0.001))
    bench.run(500)
    pressed = np.linalg.norm(mean_force(bench, "actual_TCP_force", 200))
    assert pressed > 8.0
    bench.program("sync()")
    assert np.linalg.norm(mean_force(bench, "actual_TCP_force", 200)) < 1.0
    raw = mean_force(bench, "ft_raw_wrench", 200)
    assert np.linalg.norm(np.abs(raw) - [0, 0, 9.1]) > 8.0, "the raw reading keeps it"


@pytest.mark.parametrize(
    "call",
    [
        "set_payload(0.93, [0, 0, 0.0585])",
        "set_payload_mass(0.93)",
        "set_payload_cog([0, 0, 0.0585])",
        "set_target_payload(0.93, [0, 0, 0.0585])",
    ],
)
def test_a_controller_zeroes_its_sensor_when_the_payload_is_set(bench, call):
    bench.program(f"sleep(2)\n{call}\nsleep(2)")
    bench.run(200)
    bench.plant.place((0.30, -0.35, -0.001))
    bench.run(700)
    assert np.linalg.norm(mean_force(bench, "actual_TCP_force", 5)) > 5.0
    bench.run(200)
    assert np.linalg.norm(mean_force(bench, "actual_TCP_force", 100)) < 2.0


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


@pytest.mark.parametrize(
    "call",
    [
        "movej([x,0,0,0,0,0])",
        "movel(p[x,0,0,0,0,0])",
        "servoj([0,0,0,0,0,x])",
        "speedj([0,0,0,0,0,x], 1, 0.1)",
        "speedl([x,0,0,0,0,0], 1, 0.1)",
        "speedl([0.01,0,0,0,0,0], x, 0.1)",
        "force_mode(p[x,0,0,0,0,0], [0,0,1,0,0,0], [0,0,x,0,0,0], 2, [1,1,1,1,1,1])\nsleep(0.1)",
        "set_tcp(p[0,0,x,0,0,0])",
        "set_payload(1.0, [0,0,x])",
    ],
)
def test_what_is_no_number_never_reaches_the_arm(bench, call):
    bench.run(10)
    stood = bench.plant.q
    bench.controller.apply_inputs(("input_double_register_24",), (float("nan"),))
    bench.run(3)
    bench.program(f"x = read_input_float_register(24)\n{call}")
    bench.run(100)
    assert bench.plant.q == pytest.approx(stood, abs=2e-3)
    assert np.isfinite(bench.plant.wrench).all()
    assert bench.of(events.RuntimeFailed) or not bench.controller.safety.may_move


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


def test_another_episode_takes_the_arm_to_its_start_while_the_program_runs_on(bench):
    start = bench.plant.q
    bench.finish(AWAY)
    bench.program(COUNT)
    bench.run(10)
    bench.controller.apply_inputs(("input_int_register_24",), (9,))
    bench.plant.lay_out(Task(5))
    assert bench.get("target_q") == bench.plant.q.tolist()
    assert bench.get("input_int_register_24") == 9
    bench.run(200)
    assert bench.plant.q == pytest.approx(start, abs=1e-3)
    assert bench.controller.safety_mode is SafetyMode.NORMAL
    assert bench.get("output_int_register_24") == 210


def test_a_flood_of_packages_keeps_memory_bounded_and_the_newest_wins(bench):
    for value in range(5000):
        bench.controller.apply_inputs(("input_int_register_0",), (value,))
    bench.run(4)
    assert bench.get("input_int_register_0") == 4999


def test_closing_ends_every_program(bench):
    bench.program(COUNT)
    bench.controller.run_script("sec wait():\n  sleep(1)\n  set_digital_out(0, True)\nend\n")
    bench.run(5)
    bench.controller.close()
    count = bench.get("output_int_register_24")
    bench.run(600)
    assert bench.get("output_int_register_24") == count
    assert bench.get("actual_digital_output_bits") == 0
