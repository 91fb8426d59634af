import pytest

from sim_backend.ur_controller import events


def test_registers_carry_numbers_both_ways_with_their_types(bench):
    bench.controller.apply_inputs(
        ("input_int_register_3", "input_double_register_4", "input_bit_register_65"), (-7, 2.25, True)
    )
    bench.run(3)
    bench.finish(
        "write_output_integer_register(3, read_input_integer_register(3) * 2)\n"
        "write_output_float_register(4, read_input_float_register(4) * 2)\n"
        "write_output_boolean_register(65, read_input_boolean_register(65))\n"
        "write_output_integer_register(5, read_output_integer_register(3))\n"
        "write_output_float_register(6, read_output_float_register(4))\n"
        "write_output_boolean_register(66, not read_output_boolean_register(65))"
    )
    assert bench.get("output_int_register_3") == bench.get("output_int_register_5") == -14
    assert bench.get("output_double_register_4") == bench.get("output_double_register_6") == 4.5
    assert bench.get("output_bit_register_65") is True
    assert bench.get("output_bit_register_66") is False


@pytest.mark.parametrize(
    ("value", "held"), [("2147483647", 2**31 - 1), ("-2147483647 - 1", -(2**31)), ("5.0", 5), ("3 * 65536 + 1", 196609)]
)
def test_an_integer_register_holds_whole_numbers_of_32_bits(bench, value, held):
    bench.finish(f"write_output_integer_register(0, {value})")
    assert bench.get("output_int_register_0") == held


@pytest.mark.parametrize(
    "call",
    [
        "read_input_integer_register(48)",
        "read_input_float_register(-1)",
        "read_input_boolean_register(128)",
        "write_output_float_register(48, 1.0)",
        "write_output_integer_register(0, 0.5)",
        "write_output_integer_register(0, 2147483647.0 * 2)",
        'write_output_float_register(0, "one")',
        'write_output_boolean_register(0, "yes")',
    ],
)
def test_what_no_register_holds_ends_the_program(bench, call):
    bench.program(call)
    bench.run(2)
    assert bench.of(events.RuntimeFailed)
