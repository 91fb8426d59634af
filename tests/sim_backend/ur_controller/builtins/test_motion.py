import numpy as np
import pytest

from sim_backend.ur_controller import events
from sim_backend.ur_controller.builtins.motion import ANOTHER_THREAD, NO_SOLUTION
from wire.rtde.modes import SafetyMode

from ..contacts import pressing

DOWN = "3.141592653589793, 0, 0"
LEVEL = f"p[0.28, -0.11, 0.15, {DOWN}]"


@pytest.fixture
def bench(bench):
    """A bench whose arm stands in the free."""
    bench.plant.place((0.28, -0.11, 0.15))
    bench.run(50)
    return bench


def _pose(bench):
    bench.run(60)  # the joints follow closely, but not at once
    return bench.plant.tcp_pose()


def _failure(bench, body: str) -> str:
    bench.program(body)
    bench.until(lambda: bench.of(events.ProgramStopped))
    (failed,) = bench.of(events.RuntimeFailed)
    return failed.text


def test_moves_run_one_after_another(bench):
    bench.finish(
        f"""
movel(p[0.28, -0.05, 0.15, {DOWN}], a=1.2, v=0.25)
write_output_integer_register(0, 1)
movel(pose_add(get_target_tcp_pose(), p[0.02, 0, -0.03, 0, 0, 0]), 1.2, 0.25, 0, 0)
"""
    )
    assert np.allclose(_pose(bench)[:3], [0.30, -0.05, 0.12], atol=1e-5)


def test_targets_are_poses_or_joints(bench):
    q = (bench.plant.q + np.array([0.1, 0.0, 0.05, 0.0, 0.0, 0.1])).tolist()
    bench.finish(f"movel({q})")
    bench.run(60)
    assert np.allclose(bench.plant.q, q, atol=1e-4)
    bench.heard.clear()
    bench.finish(f"movej({LEVEL}, a=0, v=0, t=0.8)")
    assert np.allclose(_pose(bench)[:3], [0.28, -0.11, 0.15], atol=1e-5)


def test_blended_moves_pass_their_waypoints(bench):
    bench.program(
        f"""
movel(p[0.28, -0.05, 0.15, {DOWN}], v=0.1, r=0.02)
movel(p[0.32, -0.05, 0.15, {DOWN}], v=0.1)
"""
    )
    nearest, slowest = 1.0, 1.0
    for _ in range(700):
        bench.run(1)
        distance = np.linalg.norm(np.subtract(bench.plant.tcp_pose()[:3], [0.28, -0.05, 0.15]))
        nearest = min(nearest, distance)
        if distance < 0.02:
            slowest = min(slowest, np.linalg.norm(bench.plant.tcp_speed()[:3]))
    assert nearest < 0.02
    assert slowest > 0.05
    assert np.allclose(_pose(bench)[:3], [0.32, -0.05, 0.15], atol=1e-5)


def test_process_circular_and_optimised_moves_reach_their_ends(bench):
    bench.finish(
        f"""
movep(p[0.28, -0.07, 0.15, {DOWN}], a=1.2, v=0.25, r=0.01)
movec(p[0.30, -0.05, 0.15, {DOWN}], p[0.32, -0.07, 0.15, {DOWN}], 1.2, 0.25, 0, 1)
"""
    )
    assert np.allclose(_pose(bench)[:3], [0.32, -0.07, 0.15], atol=1e-5)
    bench.heard.clear()
    bench.finish(f"optimovel(p[0.30, -0.10, 0.14, {DOWN}], a=0.3, v=0.3)\noptimovej({LEVEL}, a=0.5, v=0.5, r=0)")
    assert np.allclose(_pose(bench)[:3], [0.28, -0.11, 0.15], atol=1e-5)


def test_a_law_that_calls_speedl_each_step_moves_by_exactly_what_it_says(bench):
    start = bench.controller.motion.target_tcp_pose()
    bench.program(
        """
i = 0
while i < 250:
  speedl([0.02, 0.04, -0.02, 0, 0, 0.2], 1000, get_steptime(), aRot=1000)
  i = i + 1
end
write_output_integer_register(5, i)
while True:
  sync()
end
"""
    )
    bench.run(250)
    reached = bench.controller.motion.target_tcp_pose()
    assert np.allclose(np.subtract(reached[:3], start[:3]), [0.01, 0.02, -0.01], atol=1e-12)
    bench.run(60)
    assert bench.get("output_int_register_5") == 250
    assert np.abs(bench.plant.tcp_speed()).max() < 3e-3
    assert np.allclose(bench.plant.tcp_pose()[:3], np.add(start[:3], [0.01, 0.02, -0.01]), atol=3e-4)


def test_the_end_of_the_program_stops_the_arm(bench):
    bench.finish("speedl([0, 0.05, 0, 0, 0, 0], 0.5)")
    assert np.abs(bench.plant.tcp_speed()[1]) > 0.02
    bench.run(150)
    rest = bench.plant.tcp_pose()
    bench.run(50)
    assert np.allclose(bench.plant.tcp_pose(), rest, atol=1e-5)


def test_joint_speeds_and_stops(bench):
    start = bench.plant.q
    bench.finish("speedj([0, 0, 0, 0, 0, 0.4], 2, 0.5)\nstopj(2)\nsync()")
    bench.run(60)
    # ramps of 0.2 s up and down about 0.3 s at full speed
    assert np.allclose(bench.plant.q - start, [0, 0, 0, 0, 0, 0.4 * (0.3 + 0.2)], atol=2e-3)


def test_servoing_to_poses_by_inverse_kinematics(bench):
    bench.finish(
        f"""
i = 0
while i < 300:
  q = get_inverse_kin(pose_trans({LEVEL}, p[0.03 * i / 300, 0, 0.01 * i / 300, 0, 0, 0]))
  servoj(q, t=0.002, lookahead_time=0.03, gain=1200)
  i = i + 1
end
i = 0
while i < 100:
  servoj(get_inverse_kin(pose_trans({LEVEL}, p[0.03, 0, 0.01, 0, 0, 0])), 0, 0, 0.002, 0.03, 1200)
  i = i + 1
end
"""
    )
    assert np.allclose(_pose(bench)[:3], [0.31, -0.11, 0.14], atol=2e-4)


def test_servoc_goes_to_its_pose(bench):
    bench.finish(f"servoc(p[0.30, -0.08, 0.14, {DOWN}], a=1.2, v=0.1, r=0)")
    assert np.allclose(_pose(bench)[:3], [0.30, -0.08, 0.14], atol=1e-5)


MOVER_BESIDE = """
thread mover():
  while True:
    speedl([0, 0.05, 0, 0, 0, 0], 0.5, 0.1)
  end
end
moves = run mover()
sleep(0.3)
"""


def test_two_threads_cannot_move_the_arm(bench):
    assert _failure(bench, f"{MOVER_BESIDE}movel({LEVEL})") == ANOTHER_THREAD
    bench.run(200)
    assert np.abs(bench.plant.tcp_speed()).max() < 1e-4


def test_another_thread_may_move_the_arm_once_the_first_is_killed(bench):
    bench.finish(f"{MOVER_BESIDE}kill moves\nstopl(2)\nmovel({LEVEL})")
    assert np.allclose(_pose(bench)[:3], [0.28, -0.11, 0.15], atol=1e-5)


def test_the_arm_of_a_killed_thread_comes_to_rest_by_itself(bench):
    bench.program(f"{MOVER_BESIDE}kill moves\nwhile True:\n  sync()\nend")
    bench.run(150)
    assert bench.plant.tcp_speed()[1] > 0.04
    bench.run(150)
    assert np.abs(bench.plant.tcp_speed()).max() < 1e-4


def test_an_asynchronous_move_goes_on_beside_the_program(bench):
    bench.program(
        f"""
thread mover():
  movel(p[0.28, -0.03, 0.15, {DOWN}], v=0.1)
  write_output_integer_register(1, 1)
end
run mover()
while read_output_integer_register(1) == 0:
  write_output_integer_register(0, read_output_integer_register(0) + 1)
  sync()
end
"""
    )
    bench.until(lambda: bench.of(events.ProgramStopped))
    assert bench.get("output_int_register_0") > 350
    assert np.allclose(_pose(bench)[:3], [0.28, -0.03, 0.15], atol=1e-5)


def test_force_mode_presses_while_another_thread_moves(bench):
    hole = bench.plant.world.hole_position[0]
    bench.plant.place([hole[0] + 0.05, hole[1], hole[2] + 0.003])
    bench.run(250)
    bench.program(
        """
thread presses():
  while True:
    force_mode(p[0, 0, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0], [0, 0, -10, 0, 0, 0], 2, [0.1, 0.1, 0.05, 0.2, 0.2, 0.2])
    sync()
  end
end
zero_ftsensor()
force_mode_set_gain_scaling(0.5)
force_mode_set_damping(0.025)
press = run presses()
sleep(1.5)
speedl([0, 0.02, 0, 0, 0, 0], 0.5, 0.8)
stopl(1)
write_output_integer_register(0, 1)
sleep(0.5)
kill press
end_force_mode()
stopl(10)
"""
    )
    bench.run(750)
    assert pressing(bench.plant) == pytest.approx(10.0, abs=1.0)
    start = bench.plant.tcp_pose()
    bench.until(lambda: bench.get("output_int_register_0") == 1)
    moved = np.subtract(bench.plant.tcp_pose(), start)
    assert moved[1] == pytest.approx(0.02 * 0.8, abs=2e-3)
    assert abs(moved[2]) < 1e-3
    bench.run(200)
    assert pressing(bench.plant) == pytest.approx(10.0, abs=1.0)
    bench.until(lambda: bench.of(events.ProgramStopped))
    assert not bench.of(events.RuntimeFailed)
    assert not bench.controller.motion.in_force_mode


def test_the_end_of_the_program_ends_force_mode(bench):
    bench.finish("force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,-10,0,0,0], 2, [0.1,0.1,0.1,1,1,1])\nsleep(0.2)")
    bench.run(100)
    rest = bench.plant.tcp_pose()
    bench.run(200)
    assert np.allclose(bench.plant.tcp_pose()[:3], rest[:3], atol=1e-5)


def test_a_tool_contact_ends_a_descent_where_it_began(bench):
    hole = bench.plant.world.hole_position[0]
    bench.plant.place([hole[0] + 0.05, hole[1], hole[2] + 0.006])
    bench.run(250)
    bench.finish(
        """
while True:
  steps = tool_contact(direction=get_target_tcp_speed())
  if steps <= 0:
    speedl([0, 0, -0.02, 0, 0, 0], 0.5, t=get_steptime())
  else:
    q = get_actual_joint_positions_history(steps)
    stopl(3)
    movel(q)
    break
  end
end
"""
    )
    assert _pose(bench)[2] == pytest.approx(hole[2], abs=1e-3)
    assert bench.controller.safety_mode is SafetyMode.NORMAL


def test_freedrive_is_entered_and_left(bench):
    bench.program(
        'freedrive_mode(freeAxes=[1,0,0,0,0,0], feature="tool")\nsleep(0.2)\nend_freedrive_mode()\nsleep(0.2)'
    )
    bench.run(50)
    assert bench.controller.motion.in_freedrive
    bench.run(100)
    assert not bench.controller.motion.in_freedrive
    bench.until(lambda: bench.of(events.ProgramStopped))
    bench.program("teach_mode()\nsleep(1)")
    bench.run(50)
    assert bench.controller.motion.in_freedrive
    bench.controller.stop_program()
    assert not bench.controller.motion.in_freedrive


def test_steadiness_is_told(bench):
    bench.finish(
        """
write_output_boolean_register(64, is_steady())
speedj([0,0,0,0,0,0.2], 2, 0.3)
write_output_boolean_register(65, is_steady())
stopj(2)
sleep(0.5)
write_output_boolean_register(66, is_steady())
"""
    )
    assert [bench.get(f"output_bit_register_{64 + i}") for i in range(3)] == [True, False, True]


@pytest.mark.parametrize(
    ("body", "text"),
    [
        (f"movel({LEVEL}, v=0)", "v must be larger than 0"),
        (f"movel({LEVEL}, r=-0.1)", "r must lie in 0 …"),
        ("movej([0, 1, 2])", "q must be a list of 6 numbers"),
        ("speedl([0, 0, 0.1, 0, 0, 0], -1, 0.1)", "a must be larger than 0"),
        ("servoj([0, 0, 0, 0, 0, 0], gain=5)", "gain must be from 100.0 to 2000.0"),
        ("force_mode(p[0,0,0,0,0,0], [0,0,2,0,0,0], [0,0,0,0,0,0], 2, [1,1,1,1,1,1])", "0 and 1 only"),
        ("force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,0,0,0,0], 4, [1,1,1,1,1,1])", "type must be 1, 2 or 3"),
        ("force_mode_set_damping(1.5)", "damping must be from 0.0 to 1.0"),
        (f"movec({LEVEL}, {LEVEL})", "one line"),
        ("movej(p[10, 0, 0, 0, 0, 0])", NO_SOLUTION),
        ("get_actual_joint_positions_history(100000)", "beyond its buffer"),
        ("movej([0, -1, 1, 0, 1, 0], t=1e200)", "t must lie in 0 …"),
        ("force_mode(p[0,0,0,0,0,0], [0,0,0,0,0,1], [0,0,0,0,0,1e308], 2, [1,1,1,1,1,1])", "numbers up to 1000"),
        ("force_mode(p[0,0,0,0,0,0], [0,0,0,0,0,1], [0,0,0,0,0,1], 2, [1,1,1,1,1,1e308])", "numbers up to 1000"),
    ],
)
def test_bad_arguments_end_the_program_and_nothing_moves(bench, body: str, text: str):
    start = bench.plant.q
    assert text in _failure(bench, body)
    bench.run(20)
    assert np.abs(bench.plant.q - start).max() < 1e-5
    assert bench.controller.safety_mode is SafetyMode.NORMAL


@pytest.mark.parametrize("acceleration", [5e-324, 1e-11])
def test_an_acceleration_that_rounding_has_left_of_none_is_taken(bench, acceleration: float):
    """UR's client library computes such ones for the steps of a spline that stands still."""
    start = bench.plant.q
    bench.finish(f"speedj([0, 0, 0, 0, 0, 1e-11], {acceleration}, 0.002)\nwrite_output_integer_register(0, 5)")
    assert bench.get("output_int_register_0") == 5
    bench.program(f"movej([0, -1, 1, 0, 1, 0], a={acceleration})")
    bench.run(20)
    assert bench.controller.interpreter.is_busy
    assert np.abs(bench.plant.q - start).max() < 1e-5


def test_an_arc_that_does_not_exist_from_where_the_arm_comes_to_rest_is_a_protective_stop(bench):
    bench.program("speedl([0.05, 0, 0, 0, 0, 0], 1, 0.2)\np = get_target_tcp_pose()\nmovec(p, p)")
    bench.until(lambda: bench.of(events.SafetyChanged))
    assert bench.controller.safety_mode is SafetyMode.PROTECTIVE_STOP
    assert "one line" in bench.of(events.SafetyChanged)[0].reason


def test_what_is_not_a_number_does_not_reach_the_arm(bench):
    bench.controller.apply_inputs(["input_double_register_24"], [float("nan")])
    text = _failure(bench, "sleep(0.1)\nspeedl([0, 0, read_input_float_register(24), 0, 0, 0], 0.5, 0.1)")
    assert "finite" in text
    assert np.isfinite(bench.plant.q).all()


def test_a_linear_move_out_of_reach_is_a_protective_stop(bench):
    bench.program("movel(p[10, 0, 0, 0, 0, 0])")
    bench.run(10)
    assert bench.controller.safety_mode is SafetyMode.PROTECTIVE_STOP


def test_the_speed_slider_slows_moves_down(bench):
    bench.controller.set_speed_slider(0.25)
    bench.run(100)
    bench.program(f"movel(p[0.28, -0.05, 0.15, {DOWN}], v=0.1)")
    bench.run(300)
    assert bench.plant.tcp_speed()[1] == pytest.approx(0.025, abs=2e-3)


def test_a_paused_move_goes_on_where_it_was(bench):
    bench.program(f"movel(p[0.28, -0.05, 0.15, {DOWN}], v=0.1)")
    bench.run(150)
    bench.controller.pause()
    bench.run(150)
    paused = bench.plant.tcp_pose()
    bench.run(100)
    assert np.allclose(bench.plant.tcp_pose(), paused, atol=1e-5)
    assert paused[1] < -0.06
    bench.controller.play()
    bench.until(lambda: bench.of(events.ProgramStopped))
    assert np.allclose(_pose(bench)[:3], [0.28, -0.05, 0.15], atol=1e-5)
