"""Programs of the controller, tick by tick; what the arm does is judged by what is measured."""

import numpy as np
import pytest

from sim_backend.ur_controller import events
from sim_backend.ur_controller.events import Refused
from sim_backend.ur_controller.interpreter import MOST_SECONDARIES
from wire.rtde.modes import RuntimeState, SafetyMode
from wire.task import Task

AWAY = "movej([0, -1.5, -1.5, -1.5, 1.5, 0], a=4, v=2)"
COUNT = "n = 0\nwhile True:\n  n = n + 1\n  write_output_integer_register(24, n)\n  sync()\nend"


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


def test_closing_ends_every_program(bench):
    bench.program(COUNT)
    bench.controller.run_script("sec wait():\n  sleep(1)\n  set_digital_out(0, True)\nend\n")
    bench.run(5)
    bench.controller.close()
    count = bench.get("output_int_register_24")
    bench.run(600)
    assert bench.get("output_int_register_24") == count
    assert bench.get("actual_digital_output_bits") == 0
