"""A cell refuses sound policy files that do not fit it, and admits those that ship with its configurations."""

import hashlib
import re
from dataclasses import replace
from pathlib import Path

import pytest

from service.cell.inference import InProcessPolicy
from service.cell.policies import Admitted, PolicyRefusedError, PolicyShelf
from service.config import CellConfig, load
from service.safety.dsl import DslParameters
from service.testing import RECIPE, cell_config
from tests.service.cell import policies
from tests.service.drivers.ur.emulated import lockstep_ur_cell, ur_cell_config
from tests.service.policy.model_files import OBSERVATION
from training.environment.design import LAW, LOCK
from wire.records import TICK_S

ROOT = Path(__file__).parents[3]
SHIPPED = sorted((ROOT / "models").glob("*.onnx"))
MODES = ("paper", "sliding", "off")


def admit(config: CellConfig, recipe: str = RECIPE) -> Admitted:
    return PolicyShelf(config, TICK_S, InProcessPolicy).admit(recipe)


def locked(**changes: object) -> DslParameters:
    return DslParameters(**({"mode": LOCK.mode, "seek_step_m": LOCK.seek_step_m} | changes))  # type: ignore[arg-type]


def law(name: str, axis: int, value: float) -> object:
    calm = replace(LAW, damping=(*LAW.damping[:5], 2.0))
    wanted = list(getattr(calm, name))
    wanted[axis] = value
    return replace(calm, **{name: tuple(wanted)})


@pytest.mark.parametrize(
    ("changes", "limits", "reason"),
    [
        ({"force_clip_n": 1e6}, {}, "force_clip_n is 500000 N, limits.max_contact_share of the cell's ceiling is 10 N"),
        ({"force_clip_n": 20.1}, {}, "dsl.force_clip_n is 10.05 N"),
        (
            {},
            {"force_ceiling_n": 14.9},
            "force_clip_n is 5 N, limits.max_contact_share of the cell's ceiling is 4.97 N",
        ),
        ({}, {"max_contact_share": 0.16}, "dsl.force_clip_n is 5 N"),
        ({"torque_clip_nm": 1e6}, {}, "dsl.torque_clip_nm is 500000 N·m"),
        ({}, {"torque_ceiling_nm": 1.4}, "dsl.torque_clip_nm is 0.5 N·m"),
        ({"seek_step_m": 5.1e-3}, {}, "dsl.seek_step_m is 0.0051, limits.max_seek_step_m of the cell is 0.005"),
        ({"lift_max_m": 0.011}, {}, "dsl.lift_max_m is 0.011, limits.max_lift_m of the cell is 0.01"),
        ({"search_depth_m": 10.0}, {}, "dsl.search_depth_m is 10, limits.max_search_depth_m of the cell is 0.1"),
        ({"search_steps": 201}, {}, "dsl.search_steps is 201, limits.max_search_steps of the cell is 200"),
    ],
)
@pytest.mark.parametrize("mode", ["paper", "sliding"])
def test_a_lock_in_name_only_is_refused(tmp_path: Path, mode: str, changes: dict, limits: dict, reason: str) -> None:
    policy = policies.still(tmp_path, dsl=locked(mode=mode, **changes))
    with pytest.raises(PolicyRefusedError, match=re.escape(reason)):
        admit(cell_config(tmp_path, policy, limits, allow_lock=MODES))


def test_the_constants_of_a_lock_that_is_off_bound_nothing_and_are_not_judged(tmp_path: Path) -> None:
    off = DslParameters("off", force_clip_n=1e6, torque_clip_nm=1e6, search_depth_m=10.0, search_steps=10**6)
    admit(cell_config(tmp_path, policies.still(tmp_path, dsl=off), allow_lock=("off",)))


@pytest.mark.parametrize(
    ("name", "axis", "most"), [("damping", 2, 2000.0), ("damping", 3, 5.0), ("inertia", 0, 10.0), ("inertia", 5, 0.2)]
)
def test_a_law_that_is_too_heavy_or_too_viscous_is_refused(tmp_path: Path, name: str, axis: int, most: float) -> None:
    admit(cell_config(tmp_path, policies.still(tmp_path, compliance=law(name, axis, most))))
    policy = policies.still(tmp_path, compliance=law(name, axis, 1.01 * most))
    with pytest.raises(PolicyRefusedError, match=rf"compliance\.{name}\[{axis}\] is .*limits\.max_{name} of the cell"):
        admit(cell_config(tmp_path, policy))


@pytest.mark.parametrize("observation", [OBSERVATION, policies.OBSERVATION[2:]], ids=["hole", "contact only"])
def test_a_policy_that_goes_by_the_hole_is_refused_without_a_camera(tmp_path: Path, observation: tuple) -> None:
    seen = ur_cell_config(tmp_path, policies.still(tmp_path, observation=observation))
    admit(seen)
    with pytest.raises(PolicyRefusedError, match=r"describe the camera under \[camera\], or take a policy of mode FTM"):
        admit(seen.model_copy(update={"camera": None}))


def test_a_policy_that_goes_by_contact_needs_no_camera(tmp_path: Path) -> None:
    admit(ur_cell_config(tmp_path, policies.still(tmp_path, mode="FTM")).model_copy(update={"camera": None}))


@pytest.mark.parametrize("name", ["cell.toml", "ur-emulated.toml"])
@pytest.mark.parametrize("policy", SHIPPED, ids=lambda path: path.stem)
def test_what_ships_is_admitted_by_the_shipped_cells(name: str, policy: Path) -> None:
    config = load(ROOT / "config" / name)
    recipe = next(iter(config.recipes.values())).model_copy(update={"policy": policy, "allow_lock": MODES})
    admit(config.model_copy(update={"recipes": {RECIPE: recipe}}))


def test_the_robot_s_cell_loads_and_wants_a_camera_or_the_policy_that_feels_for_the_hole() -> None:
    config = load(ROOT / "config" / "ur3e.toml")
    name, recipe = next(iter(config.recipes.items()))
    with pytest.raises(PolicyRefusedError, match=r"\[camera\]"):
        admit(config, name)
    camera = load(ROOT / "config" / "ur-emulated.toml").camera
    admit(config.model_copy(update={"camera": camera}), name)
    feels = recipe.model_copy(update={"policy": ROOT / "models" / "ftm-dsl.onnx"})
    admit(config.model_copy(update={"recipes": {name: feels}}), name)


def test_the_pin_that_the_shipped_configuration_offers_is_that_of_the_shipped_file() -> None:
    path = ROOT / "config" / "cell.toml"
    pins = re.findall(r'^#.*policy_sha256 = "([0-9a-f]+)"$', path.read_text(), re.MULTILINE)
    (recipe,) = load(path).recipes.values()
    assert pins == [hashlib.sha256(recipe.policy.read_bytes()).hexdigest()]


async def test_the_cell_itself_refuses_without_a_camera(tmp_path: Path) -> None:
    config = ur_cell_config(tmp_path / "state", policies.still(tmp_path)).model_copy(update={"camera": None})
    async with lockstep_ur_cell(config) as bench:
        with pytest.raises(AssertionError, match=r"POLICY_REFUSED.*describe the camera"):
            await bench.start()
