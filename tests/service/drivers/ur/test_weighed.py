from pathlib import Path

import pytest

from service.config import CellConfig
from service.drivers.ur.weighed import FILE_NAME, forget, remarks, remember
from service.testing import cell_config
from tests.service.drivers.ur.cells import ur_config


def real(state_dir: Path, **ur: object) -> CellConfig:
    return ur_config(state_dir / "state", ur={"simulated": False, "serial": "7", **ur})


def test_a_real_arm_is_remarked_on_until_it_was_weighed_with_its_payload(tmp_path: Path) -> None:
    cell = real(tmp_path)
    assert "ur weigh" in remarks(cell)[0]
    remember(cell)
    assert remarks(cell) == ()
    forget(cell)
    forget(cell)
    assert len(remarks(cell)) == 1


def test_a_robot_whose_serial_number_is_not_set_may_be_another_than_the_weighed_one(tmp_path: Path) -> None:
    cell = real(tmp_path, serial=None)
    remember(cell)
    (line,) = remarks(cell)
    assert line.startswith("ur.serial is not set")


@pytest.mark.parametrize(
    "ur",
    [
        {"payload_kg": 1.0},
        {"payload_com_m": (0.0, 0.0, 0.06)},
        {"serial": "1"},
        {"host": "127.0.0.2"},
        {"force_range_n": 29.0},
        {"torque_range_nm": 9.0},
    ],
)
def test_another_payload_another_robot_or_another_sensor_is_another_weighing(
    tmp_path: Path, ur: dict[str, object]
) -> None:
    remember(real(tmp_path))
    assert len(remarks(real(tmp_path, **ur))) == 1


def test_the_weighing_of_an_emulated_arm_is_none_of_a_real_one(tmp_path: Path) -> None:
    remember(real(tmp_path, simulated=True))
    assert len(remarks(real(tmp_path))) == 1


@pytest.mark.parametrize("text", [b"", b"[]", b"{}", b"\xff", b"[" * 100_000], ids=range(5))
def test_a_note_that_cannot_be_read_is_none(tmp_path: Path, text: bytes) -> None:
    remember(real(tmp_path))
    (tmp_path / "state" / FILE_NAME).write_bytes(text)
    assert len(remarks(real(tmp_path))) == 1


def test_a_simulated_arm_needs_no_weighing(tmp_path: Path) -> None:
    assert remarks(ur_config(tmp_path)) == ()
    assert remarks(cell_config(tmp_path, tmp_path / "policy.onnx")) == ()
