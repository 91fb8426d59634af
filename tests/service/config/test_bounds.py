"""Every number of the configuration is bounded on both sides, and a number in the wrong unit is asked about."""

import copy
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from service.config import CellConfig, ConfigError, load

ROOT = Path(__file__).parents[3]
REAL = ROOT / "config" / "ur3e.toml"
SHIPPED = sorted((ROOT / "config").glob("*.toml"))
TEN = 'model = "UR10"\narm = "UR10e"'
Leaf = tuple[str | int, ...]

CENTRED = {"payload_com_m", "tcp_m", "start_position_m", "nominal_hole_m", "start_yaw_rad", "workspace_m"}
"""Coordinates and angles: zero and negative numbers are as good as others."""
ZERO = {"payload_kg": "a bare flange", "stop_retract_m": "no retract"}
"""Sizes that may be zero, and the meaning of zero."""


def whole() -> dict[str, Any]:
    """Return a configuration in which every optional section and number is given."""
    document = load(REAL).model_dump(mode="json")
    document["camera"] = {"endpoint": "tcp/127.0.0.1:7450", "key": "camera", "max_age_s": 0.2}
    recipe = document["recipes"]["triangle-2mm"]
    recipe.update({name: value for name, value in NUMBERS_OF_A_RECIPE.items() if recipe[name] is None})
    return document


NUMBERS_OF_A_RECIPE = {"force_ceiling_n": 15.0, "impact_n": 40.0, "max_steps": 100}


def leaves(node: Any, at: Leaf = ()) -> Iterator[Leaf]:
    if isinstance(node, dict):
        for name, value in node.items():
            yield from leaves(value, (*at, name))
    elif isinstance(node, list):
        for index, value in enumerate(node):
            yield from leaves(value, (*at, index))
    elif isinstance(node, int | float) and not isinstance(node, bool):
        yield at


def changed(at: Leaf, value: float) -> dict[str, Any]:
    document = copy.deepcopy(whole())
    place = document
    for part in at[:-1]:
        place = place[part]
    place[at[-1]] = value
    return document


def name_of(at: Leaf) -> str:
    return next(part for part in reversed(at) if isinstance(part, str))


def refused(at: Leaf, value: float) -> bool:
    try:
        CellConfig(**changed(at, value))
    except ValidationError as error:
        return any(problem["loc"][: len(at)] == at or name_of(at) in problem["msg"] for problem in error.errors())
    return False


LEAVES = list(leaves(whole()))


def test_the_walk_meets_every_number_that_the_schema_knows() -> None:
    """A section or number that is not given in `whole` would escape the tests below."""
    schema = CellConfig.model_json_schema()
    known: set[str] = set()

    def numeric(node: Any) -> bool:
        return isinstance(node, dict) and (
            node.get("type") in ("number", "integer")
            or any(numeric(child) for key in ("anyOf", "prefixItems") for child in node.get(key, ()))
            or numeric(node.get("items"))
        )

    for section in schema["$defs"].values():
        known |= {name for name, field in section.get("properties", {}).items() if numeric(field)}
    assert known == {name_of(at) for at in LEAVES}


@pytest.mark.parametrize("at", LEAVES, ids=lambda at: ".".join(map(str, at)))
def test_80_no_number_may_be_so_extreme_that_its_guard_is_off(at: Leaf) -> None:
    name = name_of(at)
    hostile = {1e9, -1e9, math.nan, math.inf, -math.inf}
    if name not in CENTRED:
        hostile |= {1e-9, -1.0} | ({0.0} if name not in ZERO else set())
    if name in ZERO:
        hostile -= {1e-9}
    assert [value for value in hostile if not refused(at, value)] == []


def test_every_bound_has_its_reason_in_the_schema() -> None:
    schema = CellConfig.model_json_schema()

    def missing(node: Any, at: str) -> Iterator[str]:
        if not isinstance(node, dict):
            return
        if node.get("type") in ("number", "integer") and not {"minimum", "maximum", "description"} <= set(node):
            yield at
        for key in ("anyOf", "prefixItems"):
            for child in node.get(key, ()):
                # the reason of an optional number stands at the field
                inherited = {"description": node["description"]} if "description" in node else {}
                if child.get("type") != "null":
                    yield from missing({**inherited, **child}, at)
        yield from missing(node.get("items"), at)
        for name, child in node.get("properties", {}).items():
            yield from missing(child, f"{at}.{name}")

    found = [at for name, section in schema["$defs"].items() for at in missing(section, name)]
    assert found == []


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("[0.0, 0.0, 0.19, 0.0, 0.0, 0.0]", "[0.0, 0.0, 190.0, 0.0, 0.0, 0.0]", r"ur\.tcp_m\.2: .*0\.19 m\? 190 looks"),
        ("0.19, 0.0, 0.0, 0.0]", "0.19, 45, 0.0, 0.0]", r"ur\.tcp_m\.3: .*0\.7854 rad\? 45 looks like degrees"),
        ("payload_kg = 0.93", "payload_kg = 930", r"ur\.payload_kg: .*0\.93 kg\? 930 looks like grams"),
        ("payload_kg = 0.93", "payload_kg = 12.5", r"ur\.payload_kg is 12\.5 kg, a UR3e \(ur\.arm\) is rated for 3 kg"),
        ("[0.0, 0.0, 0.058]", "[0.0, 0.0, 58]", r"ur\.payload_com_m\.2: .*0\.058 m\? 58 looks like millimetres"),
        ("start_yaw_rad = 0.0", "start_yaw_rad = 90", r"start_yaw_rad: .*1\.571 rad\? 90 looks like degrees"),
        (
            "[0.300, -0.110, 0.180]",
            "[300, -110, 180]",
            r"start_position_m\.1: .*-0\.11 m\? -110 looks like millim",
        ),
        ("clearance_m = 2.0e-3", "clearance_m = 2.0", r"clearance_m: .*0\.002 m\? 2 looks like millimetres"),
        ("max_speed_m_s = 0.08", "max_speed_m_s = 80", r"max_speed_m_s: .*0\.08 m/s\? 80 looks like mm/s"),
        ("sample_age_s = 0.05", "sample_age_s = 50", r"sample_age_s: .*0\.05 s\? 50 looks like milliseconds"),
        ('"192.168.56.101"', '"http://192.168.56.101"', r"ur\.host: must be a name or an address alone, without http"),
        ('"192.168.56.101"', '"192.168.56.101:30004"', r"ur\.host: must be a name or an address alone"),
        (
            "stop_retract_m = 0.0",
            "force_range_n = 60.0",
            r"ur\.force_range_n is 60 N, a UR3e .* is rated for 30",
        ),
        ("[0.300, -0.110, 0.180]", "[0.300, 0.110, 0.180]", r"start_position_m is \[0\.3, 0\.11, 0\.18\] m, outside"),
        ("[0.300, -0.110, 0.080]", "[0.300, -0.110, 0.061]", r"nominal_hole_m, less success_depth_m, is .* outside"),
        ("[0.40, -0.01, 0.30]]", "[1.40, -0.01, 0.30]]", r"limits\.workspace_m bounds nothing: a UR3e"),
    ],
)
def test_80_a_number_in_another_unit_or_beyond_the_arm_is_refused_with_the_field_and_the_likely_unit(
    tmp_path: Path, old: str, new: str, says: str
) -> None:
    text = REAL.read_text()
    assert old in text
    path = tmp_path / "cell.toml"
    path.write_text(text.replace(old, new))
    with pytest.raises(ConfigError, match=says):
        load(path)


def test_80_a_start_pose_out_of_the_arms_reach_is_refused(tmp_path: Path) -> None:
    text = REAL.read_text().replace("[0.300, -0.110, 0.180]", "[0.68, -0.110, 0.180]")
    path = tmp_path / "cell.toml"
    path.write_text(text.replace("[0.40, -0.01, 0.30]]", "[0.69, -0.01, 0.30]]"))
    with pytest.raises(ConfigError, match=r"start_position_m is .* 0\.712 m from the base; a UR3e .* reaches 0\.69 m"):
        load(path)
    path.write_text(path.read_text().replace('model = "UR3"', TEN))
    load(path)


@pytest.mark.parametrize(
    ("recipe", "fastest"),
    [("force_ceiling_n = 10.0", 0.038), ("impact_n = 12.0", 0.023), ("force_ceiling_n = 10.0\nimpact_n = 40.0", None)],
)
def test_an_approach_into_a_blow_that_the_part_does_not_bear_is_refused(
    tmp_path: Path, recipe: str, fastest: float | None
) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(REAL.read_text().replace('part = "tr"', f'part = "tr"\n{recipe}'))
    if fastest is None:
        load(path)
        return
    with pytest.raises(ConfigError, match=rf"approach_speed_m_s is 0\.05: .* more than {fastest} m/s gives more"):
        load(path)
    path.write_text(path.read_text().replace("approach_speed_m_s = 0.05", f"approach_speed_m_s = {fastest - 0.001}"))
    load(path)


def test_a_stiffer_fixture_must_be_approached_more_slowly(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(REAL.read_text().replace("[limits]", "[limits]\ncontact_n_m = 200e3"))
    with pytest.raises(ConfigError, match=r"approach_speed_m_s is 0\.05: the part bears 40 N"):
        load(path)


def test_an_arm_that_is_rated_for_more_bears_more(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    text = REAL.read_text().replace("payload_kg = 0.93", "payload_kg = 12.5\nforce_range_n = 100.0")
    path.write_text(text.replace('model = "UR3"', TEN))
    config = load(path)
    assert config.ur is not None
    assert config.ur.payload_kg == 12.5


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_the_files_that_ship_load(path: Path) -> None:
    load(path)


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "robot-3.cell.example", "localhost"])
def test_a_name_or_an_address_is_a_host(tmp_path: Path, host: str) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(REAL.read_text().replace('"192.168.56.101"', f'"{host}"'))
    config = load(path)
    assert config.ur is not None
    assert config.ur.host == host
