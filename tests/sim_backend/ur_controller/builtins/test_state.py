import numpy as np
import pytest

from sim_backend.ur_controller import events
from sim_backend.ur_controller.geometry import compose, invert
from sim_backend.world import scene
from wire.rtde.modes import RobotMode, RuntimeState, SafetyMode

WEIGHT_N = scene.PAYLOAD_KG * 9.81


def said(bench, expression):
    """The value of an expression as a program prints it."""
    bench.heard.clear()
    bench.finish(f"textmsg({expression})")
    return bench.of(events.Text)[0].text


def numbers(bench, expression, count):
    """The value of an expression that is a list, exactly."""
    bench.heard.clear()
    lines = "\n".join(f"write_output_float_register({i}, v[{i}])" for i in range(count))
    bench.finish(f"v = {expression}\n{lines}")
    return [bench.get(f"output_double_register_{i}") for i in range(count)]


@pytest.mark.parametrize(
    ("call", "output", "count"),
    [
        ("get_actual_tcp_pose()", "actual_TCP_pose", 6),
        ("get_actual_tcp_speed()", "actual_TCP_speed", 6),
        ("get_actual_joint_positions()", "actual_q", 6),
        ("get_joint_positions()", "actual_q", 6),
        ("get_actual_joint_speeds()", "actual_qd", 6),
        ("get_joint_torques()", "actual_current_as_torque", 6),
        ("get_tcp_force()", "actual_TCP_force", 6),
        ("get_tool_accelerometer_reading()", "actual_tool_accelerometer", 3),
        ("get_tcp_offset()", "tcp_offset", 6),
        ("get_target_payload_cog()", "payload_cog", 3),
        ("get_target_payload_inertia()", "payload_inertia", 6),
    ],
)
def test_a_program_sees_what_a_client_sees_of_the_tick_before(bench, call, output, count):
    bench.run(5)
    seen_before = bench.get(output)
    stores = "\n".join(f"write_output_float_register({i}, v[{i}])" for i in range(count))
    bench.program(f"v = {call}\n{stores}")
    bench.run(1)
    assert [bench.get(f"output_double_register_{i}") for i in range(count)] == seen_before


def test_the_flange_is_the_tcp_without_the_tool(bench):
    flange = numbers(bench, "get_actual_tool_flange_pose()", 6)
    apart = compose(compose(flange, bench.plant.tcp_offset), invert(bench.plant.tcp_pose()))
    assert apart == pytest.approx(np.zeros(6), abs=1e-6)


def test_a_tcp_that_a_program_sets_counts_at_once(bench):
    before = bench.plant.tcp_pose()
    offset = "p[0, 0, 0.29, 0, 0, 0]"
    assert numbers(bench, f"get_tcp_offset()\nset_tcp({offset})\nv = get_actual_tcp_pose()", 3)[2] == pytest.approx(
        before[2] - 0.1, abs=1e-4
    )


def test_zeroing_takes_the_bias_away_and_a_payload_that_is_set_is_zeroed_too(bench):
    bench.finish("sleep(0.5)\nzero_ftsensor()\nsleep(0.5)")
    assert float(said(bench, "force()")) < 3.0
    bench.heard.clear()
    bench.finish("set_payload(0.0, [0,0,0])")
    forces = []
    for _ in range(300):
        bench.run(1)
        forces.append(bench.get("actual_TCP_force"))
    assert np.mean(forces, axis=0)[2] == pytest.approx(0.0, abs=0.5), "in this attitude; in another it shows"


def test_the_payload_in_all_its_forms(bench):
    bench.finish("set_payload(1.0, [0, 0, 0.1])\nset_payload_mass(1.2)")
    assert (bench.plant.payload_kg, bench.plant.payload_cog) == (1.2, (0, 0, 0.1))
    bench.heard.clear()
    bench.finish("set_payload_cog([0, 0.1, 0])\nset_payload(0.5)")
    assert (bench.plant.payload_kg, bench.plant.payload_cog) == (0.5, bench.plant.tcp_offset[:3])
    assert bench.plant.payload_inertia == (0.0,) * 6
    assert said(bench, "get_target_payload()") == "0.5"


def test_a_payload_can_change_over_time(bench):
    bench.finish("set_payload(0.0, [0, 0, 0])")
    bench.heard.clear()
    bench.program("set_target_payload(1.0, [0, 0, 0.1], [0,0,0,0,0,0], 0.2)")
    bench.run(51)
    assert bench.plant.payload_kg == pytest.approx(0.5, abs=0.02)
    bench.until(lambda: bench.of(events.ProgramStopped))
    assert (bench.plant.payload_kg, bench.plant.payload_cog) == (1.0, (0.0, 0.0, 0.1))


@pytest.mark.parametrize(
    "call",
    ["set_payload(-1)", "set_tcp([0,0,0,0,0,0])", "set_payload(1, [0,0])", "get_joint_temp(6)", "set_gravity([0,0])"],
)
def test_what_cannot_be_ends_the_program(bench, call):
    before = bench.plant.payload_kg, bench.plant.tcp_offset
    bench.program(call)
    bench.run(2)
    assert bench.of(events.RuntimeFailed)
    assert (bench.plant.payload_kg, bench.plant.tcp_offset) == before


def test_texts_join_two_values_of_any_kind(bench):
    bench.finish('textmsg("q=", [1, 2.5])\ntextmsg(True)')
    assert [event.text for event in bench.of(events.Text)] == ["q=[1, 2.5]", "True"]


def test_a_popup_is_reported_and_a_blocking_one_waits_for_somebody(bench):
    bench.program('popup("careful", title="Note", warning=True, error=False, blocking=True)\nset_digital_out(0, True)')
    bench.run(50)
    (popup,) = bench.of(events.Popup)
    assert (popup.text, popup.title, popup.warning, popup.error, popup.blocking) == (
        "careful", "Note", True, False, True,
    )  # fmt: skip
    assert bench.get("actual_digital_output_bits") == 0
    bench.controller.close_popup()
    bench.until(lambda: bench.of(events.ProgramStopped))
    assert bench.get("actual_digital_output_bits") == 1


def test_a_plain_popup_lets_the_program_go_on(bench):
    bench.finish('popup("hello")')
    assert bench.of(events.Popup)[0].title == "Popup"


def test_steptime_and_time_are_those_of_the_controller(bench):
    assert said(bench, "get_steptime()") == "0.002"
    bench.run(17)
    now = bench.controller.time_s
    bench.heard.clear()
    bench.program("t = time()\nwrite_output_integer_register(0, t.sec)\nwrite_output_integer_register(1, t.nanosec)")
    bench.run(1)
    assert bench.get("output_int_register_0") + 1e-9 * bench.get("output_int_register_1") == pytest.approx(now)


def test_a_program_may_take_the_power(bench):
    bench.program("powerdown()\nset_digital_out(0, True)")
    bench.run(5)
    assert bench.controller.robot_mode is RobotMode.POWER_OFF
    assert bench.get("actual_digital_output_bits") == 0
    assert bench.of(events.ProgramStopped)


def test_an_external_sensor_takes_the_place_of_the_built_in_one(bench):
    bench.controller.apply_inputs(("external_force_torque",), ((1.0, 2.0, 30.0, 0.1, 0.2, 0.3),))
    bench.finish("ft_rtde_input_enable(True, 0.5, [0.1, 0, 0.05], [0, 0, 0.02])\nsleep(0.02)")
    # flange axes: the tool points down, its x axis along the base's
    assert bench.get("actual_TCP_force")[:3] == pytest.approx([1.0, -2.0, -30.0], abs=0.01)
    turned = np.array([0.1, 0.2, 0.3]) + np.cross([0.1, 0, 0.05], [1.0, 2.0, 30.0])
    assert np.linalg.norm(bench.get("actual_TCP_force")[3:]) == pytest.approx(np.linalg.norm(turned))
    bench.heard.clear()
    bench.finish("enable_external_ft_sensor(False, 0, [0,0,0], [0,0,0])\nsleep(0.02)")
    assert np.linalg.norm(bench.get("actual_TCP_force")[:3]) < 15.0


@pytest.mark.parametrize(
    "call",
    [
        "set_tcp(p[0, 0, 0, 1e200, 0, 0])",
        "set_tcp(p[1e308, 0, 1e308, 0, 0, 0])",
        "set_payload(1e308)",
        "set_payload(-1)",
        "set_payload_mass(1e308 * 10)",
        "set_payload_cog([1e308, 0, 1e308])",
        "set_gravity([0, 0, 1e308])",
        "ft_rtde_input_enable(True, 0, [0, 0, 1e308])",
    ],
)
def test_no_program_can_make_the_arm_s_numbers_overflow(bench, call):
    before = bench.get("tcp_offset"), bench.get("payload"), bench.get("payload_cog"), bench.get("target_gravity")
    bench.program(call)
    bench.run(5)
    assert bench.of(events.RuntimeFailed)
    assert before == (
        bench.get("tcp_offset"),
        bench.get("payload"),
        bench.get("payload_cog"),
        bench.get("target_gravity"),
    )
    assert np.isfinite(bench.get("target_TCP_pose")).all()


@pytest.mark.parametrize("reading", [float("nan"), float("inf")])
def test_an_external_sensor_that_gives_no_number_stops_the_arm_before_it_moves(bench, reading):
    compliant = "p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,0,0,0,0], 2, [1,1,1,1,1,1]"
    bench.program(f"ft_rtde_input_enable(True)\nforce_mode({compliant})\nsleep(9)")
    bench.run(5)
    standing = bench.get("target_q")
    bench.controller.apply_inputs(("external_force_torque",), ((0.0, 0.0, reading, 0.0, 0.0, 0.0),))
    bench.run(20)
    assert bench.controller.safety_mode is SafetyMode.PROTECTIVE_STOP
    assert bench.get("target_q") == pytest.approx(standing, abs=1e-4)


def test_an_external_sensor_that_falls_silent_pauses_the_program(bench):
    bench.program("ft_rtde_input_enable(True)\nwhile True:\n  sync()\nend")
    for _ in range(5):
        bench.controller.apply_inputs(("external_force_torque",), ((0.0,) * 6,))
        bench.run(40)
        assert bench.controller.runtime_state is RuntimeState.PLAYING
    bench.run(150)
    assert bench.controller.runtime_state is RuntimeState.PAUSED
