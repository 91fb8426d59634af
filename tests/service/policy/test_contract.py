import json
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from service.policy.contract import (
    METADATA_KEY,
    ActionEntry,
    ContractError,
    EvaluationFigure,
    ObservationEntry,
    PolicyContract,
    json_schema,
)
from service.policy.model import PolicyFault
from service.policy.observation import ENTRIES
from service.safety.dsl import DslParameters
from tests.service.policy.model_files import ACTION, contract


def changed(path: str, value: Any) -> str:
    """JSON of a good contract with one field set; a dotted path."""
    document = json.loads(contract().to_json())
    *parents, last = path.split(".")
    target: Any = document
    for parent in parents:
        target = target[int(parent)] if parent.isdigit() else target[parent]
    target[int(last) if last.isdigit() else last] = value
    return json.dumps(document)


def test_a_contract_survives_the_metadata_it_travels_in() -> None:
    figure = EvaluationFigure(
        clearance_m=2e-3, conditions="standard", episodes=500, successes=480, low=0.94, high=0.98, peak_force_max_n=14.0
    )
    document = contract(
        dsl=DslParameters(release_threshold=0.3),
        hidden_size=128,
        provenance={"seed": 1, "steps": 2e6, "commit": None, "notes": ["a", {"b": True}]},
        evaluation=(figure,),
    )
    assert PolicyContract.from_json(document.to_metadata()[METADATA_KEY]) == document


def test_sizes_and_period_follow_from_the_entries() -> None:
    document = contract()
    assert document.observation_size == 2 + 1 + 3 * 3
    assert document.observation_builder().size == document.observation_size
    assert document.action_map().size == 4
    assert document.period_s == pytest.approx(0.08)


@pytest.mark.parametrize("name", list(ENTRIES))
def test_every_entry_of_the_registry_can_stand_in_a_contract(name: str) -> None:
    document = contract(observation=(ObservationEntry.of(name),))
    assert document.observation_size == ENTRIES[name].size


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        ("schema_version", 2, "schema_version"),
        ("name", "", "name"),
        ("parts", [], "parts"),
        ("clearance_m", [2e-3, 1e-3], "clearance_m"),
        ("clearance_m", [0.0, 1e-3], "clearance_m"),
        ("mode", "VFT", "mode"),
        ("tick_s", -0.002, "tick_s"),
        ("ticks_per_step", 0, "ticks_per_step"),
        ("ticks_per_step", 40.5, "ticks_per_step"),
        ("ticks_per_step", 20, "wrench_window_ticks is 40, a step has 20"),
        ("max_steps", 0, "max_steps"),
        ("observation", [], "observation"),
        ("observation.0.name", "colour", "unknown observation entry 'colour'"),
        ("observation.0.size", 3, "'hole_offset_xy' has size 2, the contract says 3"),
        ("observation.0.unit", "mm", "'hole_offset_xy' has unit 'm', the contract says 'mm'"),
        ("observation.0.frame", "base", "'hole_offset_xy' has frame 'tool', the contract says 'base'"),
        ("observation.0.scale", [1.0, 1.0, 1.0], "2 components and 3 scales"),
        ("observation.0.scale", 0.0, "observation.0.scale"),
        ("observation.0.history", 0, "observation.0.history"),
        ("observation.0.colour", 1, "observation.0.colour"),
        ("action.0.unit", "rad", "'dx' cannot be in rad"),
        ("action.3.unit", "m", "'dyaw' cannot be in m"),
        ("action.0.limit", 0, "action.0.limit"),
        ("action.0.map", "cube", "action.0.map"),
        ("action.0.name", "dw", "action.0.name"),
        ("action.0.frame", "base", "dx and dy must be in the same frame"),
        ("dsl.press_m", -1.0, "dsl.press_m"),
        ("dsl.depth", 1.0, "dsl.depth"),
        ("dsl.mode", "soft", "dsl.mode"),
        ("dsl.mode", "peck", "dsl.mode"),
        ("compliance.stiffness", [1.0] * 5, "compliance.stiffness"),
        ("compliance.damping.0", 0.0, "compliance.damping.0"),
        ("hidden_size", -1, "hidden_size"),
        ("wrench_window_ticks", 0, "wrench_window_ticks"),
        ("evaluation", [{"clearance_m": 1e-3}], "evaluation.0.episodes"),
        ("surprise", 1, "surprise"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(path: str, value: Any, says: str) -> None:
    with pytest.raises(ContractError) as refusal:
        PolicyContract.from_json(changed(path, value))
    assert says in str(refusal.value)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", '{"name": NaN}', b"\xff\xfe"])
def test_text_that_is_no_contract_is_refused(text: str | bytes) -> None:
    with pytest.raises(ContractError):
        PolicyContract.from_json(text)


def test_not_a_number_is_no_number() -> None:
    with pytest.raises(ContractError, match=r"action\.0\.limit"):
        PolicyContract.from_json(changed("action.0.limit", "nan"))


def test_every_fault_is_named_at_once() -> None:
    document = json.loads(contract().to_json())
    document["max_steps"], document["observation"][1]["name"] = 0, "colour"
    with pytest.raises(ContractError, match=r"(?s)max_steps.*colour|colour.*max_steps"):
        PolicyContract.from_json(json.dumps(document))


def test_names_stand_once() -> None:
    with pytest.raises(ValidationError, match="height more than once"):
        contract(observation=(ObservationEntry.of("height"), ObservationEntry.of("height")))
    with pytest.raises(ValidationError, match="dx more than once"):
        contract(action=(*ACTION, ACTION[0]))


def test_a_policy_owns_z() -> None:
    without_z = tuple(entry for entry in ACTION if entry.name != "dz")
    with pytest.raises(ValidationError, match="action lacks dz"):
        contract(action=without_z)


def test_a_file_that_carries_the_constant_of_a_lock_mode_that_is_gone_still_loads() -> None:
    document = json.loads(contract().to_json())
    document["dsl"]["peck_deeper_m"] = 5e-4
    assert PolicyContract.from_json(json.dumps(document)) == contract()


def test_vm_feels_nothing_and_bypasses_the_lock() -> None:
    seen = (ObservationEntry.of("hole_offset_xy"), ObservationEntry.of("height"))
    off = DslParameters(mode="off")
    assert contract(mode="VM", observation=seen, dsl=off).mode == "VM"
    with pytest.raises(ValidationError, match="force_mean need it"):
        contract(mode="VM", dsl=off)
    with pytest.raises(ValidationError, match="bypasses the lock"):
        contract(mode="VM", observation=seen)


def test_an_entry_by_name_takes_its_size_unit_and_frame_from_the_registry() -> None:
    entry = ObservationEntry.of("lag", scale=(1e-3, 1e-3, 1e-3, 0.1), history=4)
    assert (entry.size, entry.unit, entry.frame, entry.history) == (4, "m,rad", "tool", 4)
    with pytest.raises(ValueError, match="colour"):
        ObservationEntry.of("colour")


def test_the_schema_names_every_field() -> None:
    schema = json.dumps(json_schema())
    for field in (*PolicyContract.model_fields, *ActionEntry.model_fields, "delta_f", "stiffness"):
        assert f'"{field}"' in schema


def test_the_reference_page_holds_the_registry() -> None:
    page = (Path(__file__).parents[3] / "docs/reference/policy-contract.md").read_text()
    for name, spec in ENTRIES.items():
        needs = ", ".join(sorted(spec.needs)) or "–"
        assert f"| `{name}` | {spec.size} | {spec.unit} | {spec.frame} | {needs} | {spec.meaning} |" in page
    for field in PolicyContract.model_fields:
        assert f"`{field}`" in page
    for reason in PolicyFault:
        assert f"`{reason}`" in page
