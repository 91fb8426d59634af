"""`docs/reference/wire.md` says what the code does: layouts, numbers, keys, task."""

import dataclasses
import json
import re
from enum import IntEnum
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from sim_backend.ur_controller.server import Counters as UrCounters
from sim_backend.ur_controller.surroundings import PRESSES
from sim_backend.zenoh_cell import answers, server
from wire import keys, records, task

DOCUMENT = (Path(__file__).parents[2] / "docs/reference/wire.md").read_text(encoding="utf-8")


def section(heading: str) -> str:
    """Text from a heading whose title starts with `heading` to the next heading."""
    match = re.search(rf"^#+ {heading}\b.*?$(.*?)(?=^#|\Z)", DOCUMENT, re.M | re.S)
    assert match is not None, f"docs/reference/wire.md has no section {heading}"
    return match[0]


def rows(heading: str) -> list[list[str]]:
    lines = [line for line in section(heading).splitlines() if line.startswith("|")]
    return [[cell.strip().strip("`") for cell in line.strip("|").split("|")] for line in lines[2:]]


@pytest.mark.parametrize(
    ("name", "dtype"), [("STATE", records.STATE), ("COMMAND", records.COMMAND), ("CAMERA", records.CAMERA)]
)
def test_record_tables_give_the_layout(name: str, dtype: np.dtype) -> None:
    def written(field: np.dtype) -> str:
        shape = f"[{'×'.join(map(str, field.shape))}]" if field.shape else ""
        return field.base.str.lstrip("<|") + shape

    layout = [[str(dtype.fields[field][1]), field, written(dtype.fields[field][0])] for field in dtype.names]
    assert [row[:3] for row in rows(name)] == layout
    assert f"{name}, {dtype.itemsize} bytes" in section(name)
    assert all(row[3] for row in rows(name))


@pytest.mark.parametrize("enumeration", [records.Kind, records.Program, records.StopReason])
def test_enumeration_tables_give_names_and_numbers(enumeration: type[IntEnum]) -> None:
    assert [row[:2] for row in rows(enumeration.__name__)] == [[str(int(e)), e.name] for e in enumeration]


def test_every_key_stands_in_the_table() -> None:
    in_code = {value.removeprefix("sim/{world}/") for name, value in vars(keys).items() if name.isupper()}
    assert {row[0] for row in rows("Keys")} == in_code


def test_task_table_gives_fields_and_defaults() -> None:
    fields = [
        [field.name, "required" if field.default is dataclasses.MISSING else json.dumps(field.default)]
        for field in dataclasses.fields(task.Task)
    ]
    assert [[row[0], row[2].strip("`")] for row in rows("Task")] == fields
    for name in (*get_args(task.Part), *get_args(task.Conditions)):
        assert f"`{name}`" in section("Task")


def test_the_emulated_controllers_section_names_presses_and_counters() -> None:
    text = section("An emulated UR controller")
    presses = [name for row in rows("An emulated UR controller") for name in re.findall(r"[a-z_]+", row[0])]
    assert sorted(presses) == sorted(PRESSES)
    for counter in dataclasses.fields(UrCounters):
        assert f"`{counter.name}`" in text


def test_numbers_in_the_prose_are_those_of_the_code() -> None:
    assert f"Schema version: {records.VERSION}." in DOCUMENT
    assert f"(1 … {answers.MAX_TICKS})" in section("Keys")
    assert f"at most {answers.MAX_COMMANDS}" in section("Keys")
    assert f"newest {server.MAX_COMMANDS_PER_TICK} are applied" in section("Real time")
    assert f"every {records.TICK_S * 1000:.0f} ms" in section("Real time")
    for counter in dataclasses.fields(server.Counters):
        assert f"`{counter.name}`" in section("Info")
