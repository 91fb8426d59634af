from importlib import resources
from string import Template

import pytest

from service.drivers.ur import registers
from service.drivers.ur.program import ProgramError, render
from service.testing import cell_config
from tests.service.drivers.ur.cells import ur_config


def test_every_name_of_the_template_is_filled_in_and_none_is_left_over() -> None:
    text = render(ur_config()).text
    assert "$" not in text.partition("def dsl_control")[2]
    template = Template(resources.files("service.drivers.ur").joinpath("control_program.urscript").read_text())
    assert {"CRC", "WORKSPACE_LOWER", "IN_SEQUENCE"} <= set(template.get_identifiers())


@pytest.mark.parametrize(
    ("section", "field", "value", "line"),
    [
        ("limits", "force_ceiling_n", 12.5, "MAX_FORCE = 12.5"),
        ("limits", "torque_ceiling_nm", 1.25, "MAX_TORQUE = 1.25"),
        ("limits", "target_age_s", 0.25, "MAX_TARGET_AGE = 0.25"),
        ("limits", "max_step_m", 0.004, "MAX_STEP = 0.004"),
        ("limits", "max_turn_rad", 0.11, "MAX_TURN = 0.11"),
        ("limits", "max_speed_m_s", 0.09, "MAX_SPEED = 0.09"),
        ("limits", "max_turn_speed_rad_s", 1.5, "MAX_TURN_SPEED = 1.5"),
        (
            "limits",
            "max_stiffness",
            (11.0, 12.0, 13.0, 4.0, 5.0, 6.0),
            "MAX_STIFFNESS = [11.0, 12.0, 13.0, 4.0, 5.0, 6.0]",
        ),
        ("limits", "min_damping", (1.0, 2.0, 3.0, 0.4, 0.5, 0.6), "MIN_DAMPING = [1.0, 2.0, 3.0, 0.4, 0.5, 0.6]"),
        ("limits", "max_damping", (700.0,) * 3 + (1.0,) * 3, "MAX_DAMPING = [700.0, 700.0, 700.0, 1.0, 1.0, 1.0]"),
        ("limits", "max_inertia", (3.0,) * 3 + (0.1,) * 3, "MAX_INERTIA = [3.0, 3.0, 3.0, 0.1, 0.1, 0.1]"),
        ("limits", "min_inertia", (1.0, 2.0, 3.0, 0.04, 0.05, 0.06), "MIN_INERTIA = [1.0, 2.0, 3.0, 0.04, 0.05, 0.06]"),
        ("limits", "workspace_m", ((0.2, -0.2, 0.02), (0.4, 0.0, 0.3)), "WORKSPACE_UPPER = [0.4, 0.0, 0.3]"),
        ("ur", "payload_kg", 1.75, "set_target_payload(1.75, "),
        ("ur", "tcp_m", (0.0, 0.0, 0.2, 0.0, 0.1, 0.0), "set_tcp(p[0.0, 0.0, 0.2, 0.0, 0.1, 0.0])"),
        ("ur", "torque_about", "tcp", "TORQUE_ABOUT_FLANGE = False"),
        ("ur", "watchdog_hz", 12.0, 'rtde_set_watchdog("input_int_register_24", 12.0, "stop")'),
        ("ur", "stop_retract_m", 0.004, "RETRACT = 0.004"),
    ],
)
def test_a_limit_of_the_configuration_is_the_program_s_and_changes_its_checksum(
    section: str, field: str, value: object, line: str
) -> None:
    program = render(ur_config(**{section: {field: value}}))
    assert line in program.text
    assert program.crc != render(ur_config()).crc


def test_the_checksum_stands_in_the_text_fits_its_register_and_is_the_same_every_time() -> None:
    program = render(ur_config())
    assert f"write_output_integer_register({registers.OUTPUT_CRC}, {program.crc})" in program.text
    assert 0 < program.crc < 2**31
    assert render(ur_config()) == program


def test_a_cell_without_a_ur_arm_has_no_control_program(tmp_path) -> None:
    with pytest.raises(ProgramError, match=r"\[ur\]"):
        render(cell_config(tmp_path, tmp_path / "policy.onnx"))


def test_a_retract_that_outlasts_the_time_of_a_stop_is_refused_with_the_one_that_fits() -> None:
    with pytest.raises(ProgramError, match=r"ur\.stop_retract_m is 0\.015.*at most 0\.0060 m"):
        render(ur_config(ur={"stop_retract_m": 0.015}))
    render(ur_config(ur={"stop_retract_m": 0.0059}))


def test_only_registers_of_external_clients_are_used() -> None:
    names = (*registers.INPUT_NAMES, *registers.OUTPUT_NAMES)
    assert len(set(names)) == len(names)
    assert all(24 <= int(name.rpartition("_")[2]) <= 47 for name in names)
    assert len(", ".join(registers.INPUT_NAMES)) < 2048, "the limit of a list of names"
