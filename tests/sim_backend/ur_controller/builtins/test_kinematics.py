import numpy as np
import pytest

from sim_backend.ur_controller import events
from sim_backend.ur_controller.builtins.motion import NO_SOLUTION
from sim_backend.world import kinematics


def _put(names: str) -> str:
    """Script that writes list `names` to the first output registers."""
    return f"i = 0\nwhile i < 6:\n  write_output_float_register(i, {names}[i])\n  i = i + 1\nend"


def _written(bench) -> list[float]:
    return [bench.get(f"output_double_register_{i}") for i in range(6)]


def test_inverse_kinematics_goes_near_the_joints_asked_for(bench):
    near = np.array([-0.2, -1.9, -1.7, -1.1, 1.57, 0.0])
    pose = bench.plant.tcp_pose_of((near + 0.05).tolist())
    bench.finish(f"q = get_inverse_kin(p{pose}, {near.tolist()}, 1e-10, 1e-10)\n{_put('q')}")
    assert np.allclose(_written(bench), near + 0.05, atol=1e-9)


def test_inverse_kinematics_begins_at_the_present_joints(bench):
    bench.finish(f"q = get_inverse_kin(get_actual_tcp_pose())\n{_put('q')}")
    assert np.allclose(_written(bench), bench.plant.q, atol=1e-5)


def test_inverse_kinematics_takes_a_tcp(bench):
    pose = bench.plant.flange_pose_of(bench.plant.q.tolist())
    bench.finish(f"q = get_inverse_kin(p{pose}, tcp=p[0, 0, 0, 0, 0, 0])\n{_put('q')}")
    assert np.allclose(_written(bench), bench.plant.q, atol=1e-5)


def test_a_pose_without_a_solution_is_told_or_ends_the_program(bench):
    bench.finish(
        "if not get_inverse_kin_has_solution(p[2, 0, 0, 0, 0, 0]):\n  write_output_integer_register(0, 7)\nend"
    )
    assert bench.get("output_int_register_0") == 7
    bench.heard.clear()
    bench.finish("if get_inverse_kin_has_solution(get_target_tcp_pose()):\n  write_output_integer_register(0, 8)\nend")
    assert bench.get("output_int_register_0") == 8
    bench.heard.clear()
    bench.program("q = get_inverse_kin(p[2, 0, 0, 0, 0, 0])")
    bench.until(lambda: bench.of(events.ProgramStopped))
    assert bench.of(events.RuntimeFailed)[0].text == NO_SOLUTION


def test_forward_kinematics_of_the_arm_and_of_other_joints_and_tools(bench):
    bench.finish(_put("get_forward_kin()"))
    assert np.allclose(_written(bench), bench.plant.tcp_pose(), atol=1e-6)
    bench.heard.clear()
    q = [0.3, -1.2, 1.4, -0.5, 1.3, 0.2]
    bench.finish(_put(f"get_forward_kin({q}, p[0, 0, 0.1, 0, 0, 0])"))
    position, rotation = kinematics.forward(q)
    assert np.allclose(_written(bench)[:3], position + 0.1 * rotation[:, 2], atol=1e-12)


def test_the_jacobian_is_that_of_the_configured_tcp(bench):
    q = [0.3, -1.2, 1.4, -0.5, 1.3, 0.2]
    bench.finish(
        f"set_tcp(p[0, 0, 0.1, 0, 0, 0])\nj = get_jacobian({q})\n"
        + _put("[j[0, 0], j[0, 1], j[1, 2], j[2, 3], j[3, 4], j[5, 5]]")
    )
    expected = kinematics.jacobian(q, [0.0, 0.0, 0.1])
    assert np.allclose(_written(bench), expected[[0, 0, 1, 2, 3, 5], [0, 1, 2, 3, 4, 5]], atol=1e-12)


def test_targets_of_the_motion_are_told(bench):
    bench.program(
        "while True:\n  speedl([0, 0.05, 0, 0, 0, 0], 1000, 0.002)\n" + _put("get_target_tcp_speed()") + "\nend"
    )
    bench.run(10)
    assert np.allclose(_written(bench), [0, 0.05, 0, 0, 0, 0], atol=1e-12)
    bench.program(
        "while True:\n  speedj([0, 0, 0, 0, 0, 0.2], 100, 0.002)\n" + _put("get_target_joint_speeds()") + "\nend"
    )
    bench.run(100)
    assert np.allclose(_written(bench), [0, 0, 0, 0, 0, 0.2], atol=1e-12)


def test_safety_limits_are_the_reach_and_the_range_of_the_joints(bench):
    bench.finish(
        """
write_output_boolean_register(64, is_within_safety_limits(get_target_tcp_pose()))
write_output_boolean_register(65, is_within_safety_limits(p[2, 0, 0, 0, 0, 0]))
write_output_boolean_register(66, is_within_safety_limits([0, 0, 0, 0, 0, 0]))
write_output_boolean_register(67, is_within_safety_limits([0, 7, 0, 0, 0, 0]))
"""
    )
    assert [bench.get(f"output_bit_register_{64 + i}") for i in range(4)] == [True, False, True, False]


@pytest.mark.parametrize("call", ["get_inverse_kin([0, 0, 0, 0, 0, 0])", "get_forward_kin([0, 0])"])
def test_arguments_of_the_wrong_kind_end_the_program(bench, call: str):
    bench.program(f"x = {call}")
    bench.until(lambda: bench.of(events.ProgramStopped))
    assert "must be a" in bench.of(events.RuntimeFailed)[0].text
