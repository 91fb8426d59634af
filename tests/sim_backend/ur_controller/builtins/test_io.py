import pytest

from sim_backend.ur_controller import events


@pytest.mark.parametrize(
    ("setter", "getter", "n", "bit"),
    [
        ("set_digital_out", "get_digital_out", 17, 17),
        ("set_standard_digital_out", "get_standard_digital_out", 7, 7),
        ("set_configurable_digital_out", "get_configurable_digital_out", 7, 15),
        ("set_tool_digital_out", "get_tool_digital_out", 1, 17),
    ],
)
def test_digital_outputs_switch_and_are_read_back(bench, setter, getter, n, bit):
    bench.finish(f"{setter}({n}, True)\nset_digital_out(0, {getter}({n}))")
    assert bench.get("actual_digital_output_bits") == 1 << bit | 1
    bench.heard.clear()
    bench.finish(f"{setter}({n}, False)")
    assert bench.get("actual_digital_output_bits") == 1


@pytest.mark.parametrize(
    ("getter", "n", "bit"),
    [
        ("get_digital_in", 9, 9),
        ("get_standard_digital_in", 3, 3),
        ("get_configurable_digital_in", 3, 11),
        ("get_tool_digital_in", 1, 17),
    ],
)
def test_digital_inputs_are_what_is_connected(bench, getter, n, bit):
    bench.finish(f"set_digital_out(0, {getter}({n}))")
    assert bench.get("actual_digital_output_bits") == 0
    bench.controller.terminals.digital_inputs = 1 << bit
    bench.heard.clear()
    bench.finish(f"set_digital_out(0, {getter}({n}))")
    assert bench.get("actual_digital_output_bits") == 1


def test_analog_terminals_scale_with_their_domain(bench):
    bench.controller.terminals.analog_inputs[:] = [5.0, 0.008, 2.5, 10.0]
    bench.finish(
        "set_standard_analog_input_domain(1, 0)\n"
        "write_output_float_register(0, get_standard_analog_in(0))\n"
        "write_output_float_register(1, get_standard_analog_in(1))\n"
        "write_output_float_register(2, get_tool_analog_in(0))\n"
        "set_analog_outputdomain(0, 1)\n"
        "set_standard_analog_out(0, 0.5)\n"
        "set_standard_analog_out(1, 2)\n"
        "write_output_float_register(3, get_standard_analog_out(0))\n"
    )
    assert [bench.get(f"output_double_register_{i}") for i in range(4)] == pytest.approx([0.5, 0.25, 0.25, 0.5])
    assert bench.get("standard_analog_output0") == 5.0
    assert bench.get("standard_analog_output1") == 0.02


@pytest.mark.parametrize(
    "call",
    [
        "set_standard_digital_out(8, True)",
        "set_digital_out(18, True)",
        'set_digital_out(0, "on")',
        "get_standard_analog_in(2)",
        "set_tool_voltage(5)",
        "set_analog_outputdomain(0, 2)",
    ],
)
def test_terminals_that_are_not_there_end_the_program(bench, call):
    bench.program(call)
    bench.run(2)
    assert bench.of(events.RuntimeFailed)
