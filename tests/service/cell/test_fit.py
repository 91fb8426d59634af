"""What a cell cannot offer a policy is named."""

from dataclasses import replace
from typing import Any

import pytest

from service.cell.fit import CellCapabilities, mismatches
from service.policy.contract import ObservationEntry
from tests.service.policy.model_files import contract

CELL = CellCapabilities(
    tick_s=0.002,
    part="tr",
    clearance_m=1.0e-3,
    camera=True,
    force_torque=True,
    last_joint=True,
    stiffness_max=(5000.0,) * 3 + (200.0,) * 3,
)


def test_a_cell_that_offers_everything_can_run_it() -> None:
    assert mismatches(contract(), CELL) == ()
    assert mismatches(contract(), replace(CELL, clearance_m=None)) == ()


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"tick_s": 0.008}, "tick of 2 ms, the cell has 8 ms"),
        ({"part": "cir"}, "the policy is for tr, the cell assembles cir"),
        ({"clearance_m": 0.1e-3}, "0.3 to 2 mm per face, the cell has 0.1 mm"),
        ({"camera": False}, "'hole_offset_xy' needs a camera's estimate of the hole"),
        ({"force_torque": False}, "'force_mean' needs a force/torque sensor"),
        ({"force_torque": False}, "the safety lock in mode 'paper' needs"),
        ({"stiffness_max": (5000.0,) * 3 + (5.0,) * 3}, "compliance.stiffness[3] is 10, the cell runs at most 5"),
    ],
)
def test_what_a_cell_cannot_offer_is_named(changes: dict[str, Any], says: str) -> None:
    assert says in "; ".join(mismatches(contract(), replace(CELL, **changes)))


def test_ftm_needs_no_camera() -> None:
    assert mismatches(contract(mode="FTM"), replace(CELL, camera=False)) == ()


def test_joint_angles_are_a_need_like_others() -> None:
    document = contract(observation=(ObservationEntry.of("last_joint_angle"),))
    assert "joint angles" in mismatches(document, replace(CELL, last_joint=False))[0]
