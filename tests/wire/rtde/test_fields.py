import struct

from wire.rtde.fields import INPUTS, OUTPUTS, SINCE, FieldType


def test_a_type_has_the_size_that_the_guide_gives_it() -> None:
    sizes = {kind.name: 8 * struct.calcsize(f">{kind.count}{kind.letter}") for kind in FieldType}
    assert sizes == {
        "BOOL": 8, "UINT8": 8, "UINT32": 32, "UINT64": 64, "INT32": 32, "DOUBLE": 64,
        "VECTOR3D": 3 * 64, "VECTOR6D": 6 * 64, "VECTOR6INT32": 6 * 32, "VECTOR6UINT32": 6 * 32,
    }  # fmt: skip


def test_every_register_is_there_and_no_other() -> None:
    for way, table in (("input", INPUTS), ("output", OUTPUTS)):
        for kind, numbers in (("int", range(48)), ("double", range(48)), ("bit", range(64, 128))):
            names = {name for name in table if name.startswith(f"{way}_{kind}_register_")}
            assert names == {f"{way}_{kind}_register_{number}" for number in numbers}
    assert OUTPUTS["output_int_register_47"] is FieldType.INT32
    assert OUTPUTS["output_bit_registers32_to_63"] is FieldType.UINT32
    assert INPUTS["input_bit_register_127"] is FieldType.BOOL


def test_inputs_that_can_be_read_back_have_one_type() -> None:
    both = INPUTS.keys() & OUTPUTS.keys()
    assert both == {name for name in INPUTS if name.startswith("input_")}
    assert all(INPUTS[name] is OUTPUTS[name] for name in both)


def test_versions_are_given_for_variables_that_exist() -> None:
    assert SINCE.keys() <= OUTPUTS.keys() | INPUTS.keys()
    assert SINCE["ft_raw_wrench"] == (5, 9, 0)
    assert SINCE["input_double_register_24"] == (5, 3, 0)
    assert "input_double_register_23" not in SINCE


def test_no_name_needs_more_than_ascii_or_holds_the_separator() -> None:
    assert all(name.isascii() and "," not in name for name in OUTPUTS.keys() | INPUTS.keys())
