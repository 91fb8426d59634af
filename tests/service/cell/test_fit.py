"""Every mismatch of a policy and a cell is named."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from service.cell.fit import CellCapabilities, mismatches
from service.config import LimitsSection
from service.policy.contract import ObservationEntry
from service.policy.model import Policy
from service.policy.observation import Need
from service.safety.contact_loop import why_not_law
from service.safety.dsl import DslParameters
from tests.service.policy.model_files import contract
from wire.law import ComplianceLaw
from wire.limits import FORCE_CEILING_N, WORKSPACE_M

ROOT = Path(__file__).parents[3]
LIMITS = LimitsSection(
    force_ceiling_n=FORCE_CEILING_N,
    workspace_m=WORKSPACE_M,
    max_stiffness=(5000.0, 5000.0, 5000.0, 200.0, 200.0, 200.0),
)
CELL = CellCapabilities(
    tick_s=0.002,
    part="tr",
    clearance_m=1.0e-3,
    locks=("paper",),
    offers=frozenset(Need),
    limits=LIMITS,
)


def without(need: Need) -> dict[str, Any]:
    return {"offers": CELL.offers - {need}}


def test_a_cell_that_offers_everything_can_run_it() -> None:
    assert mismatches(contract(), CELL) == ()
    assert mismatches(contract(), replace(CELL, clearance_m=None)) == ()


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"tick_s": 0.008}, "tick of 2 ms, the cell has 8 ms"),
        ({"limits": LIMITS.model_copy(update={"target_age_s": 0.08})}, "acts every 80 ms (ticks_per_step), the arm"),
        ({"part": "cir"}, "the policy is for tr, the cell assembles cir"),
        ({"clearance_m": 0.1e-3}, "0.3 to 2 mm per face, the cell has 0.1 mm"),
        (without(Need.HOLE), "'hole_offset_xy' needs a camera's estimate of the hole"),
        (without(Need.FORCE_TORQUE), "'force_mean' needs a force/torque sensor"),
        (without(Need.FORCE_TORQUE), "the safety lock in mode 'paper' needs"),
        (
            {"limits": LIMITS.model_copy(update={"max_stiffness": (5000.0,) * 3 + (5.0,) * 3})},
            "compliance.stiffness[3] is 10, the cell runs at most 5",
        ),
    ],
)
def test_what_a_cell_cannot_offer_is_named(changes: dict[str, Any], says: str) -> None:
    assert says in "; ".join(mismatches(contract(), replace(CELL, **changes)))


def test_a_touch_that_the_part_does_not_bear_is_named_for_approach_and_search() -> None:
    assert mismatches(contract(), replace(CELL, bears_n=10.0)) == ()
    (search,) = mismatches(contract(), replace(CELL, bears_n=1.0))
    assert "the search (dsl.seek_step_m and the action's dz) reaches 0.004 m/s" in search
    assert "the part bears 1 N" in search
    (approach,) = mismatches(contract(), replace(CELL, bears_n=10.0, approach_speed_m_s=0.1))
    assert approach.startswith("approach_speed_m_s of the recipe reaches 0.024 m/s: a touch gives up to 14 N")


def test_a_search_is_as_fast_as_its_law_pulls_within_a_step_however_long_the_step_lasts() -> None:
    """The world measured 0.047 m/s and 36 N, where a step over its period is 0.023 m/s."""
    quick = ComplianceLaw((2500.0,) * 2 + (3000.0,) + (5.0,) * 3, (380.0,) * 2 + (200.0,) + (1.0,) * 3, (10.0,) * 6)
    slow = contract(ticks_per_step=140, compliance=quick, dsl=DslParameters(seek_step_m=5e-3))
    found = "; ".join(mismatches(slow, replace(CELL, bears_n=20.0)))
    assert "the search (dsl.seek_step_m and the action's dz) reaches 0.1" in found


def test_62_a_lock_that_takes_noise_or_inertia_for_a_contact_is_refused() -> None:
    """With 1 N over three samples the noise in free air made a contact, and with a wrong camera a success."""
    hair = contract(dsl=DslParameters(contact_threshold=0.1))
    assert "dsl.contact_threshold of dsl.force_clip_n is 1 N: without a contact" in "; ".join(mismatches(hair, CELL))
    brief = contract(wrench_window_ticks=3)
    assert "over wrench_window_ticks (3)" in "; ".join(mismatches(brief, CELL))
    assert "own inertia reach" in "; ".join(mismatches(contract(), replace(CELL, payload_kg=10.0)))


def test_a_heavy_payload_makes_a_light_law_swing() -> None:
    assert "swings" in "; ".join(mismatches(contract(), replace(CELL, payload_kg=6.0)))


@pytest.mark.parametrize("path", sorted((ROOT / "models").glob("*.onnx")), ids=lambda path: path.stem)
def test_the_law_of_every_policy_that_ships_is_admitted(path: Path) -> None:
    assert not list(why_not_law(Policy.load(path).contract.compliance))


def test_ftm_needs_no_camera() -> None:
    assert mismatches(contract(mode="FTM"), replace(CELL, **without(Need.HOLE))) == ()


def test_joint_angles_are_a_need_like_others() -> None:
    document = contract(observation=(ObservationEntry.of("last_joint_angle"),))
    assert "joint angles" in mismatches(document, replace(CELL, **without(Need.LAST_JOINT)))[0]
