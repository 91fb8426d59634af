import json
from pathlib import Path
from typing import Any

import pytest

from cli import shipped
from cli.config import Kind
from service.config import load
from tests.cli.serving import run


@pytest.mark.parametrize("kind", Kind)
def test_a_new_cell_s_folder_holds_all_that_its_configuration_names(
    kind: Kind, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cli.config._is_free", frozenset(range(65536)).__contains__)
    folder = tmp_path / "cells" / "one"
    done = run("config", "new", str(folder), "--kind", kind.value)
    assert done.exit_code == 0, done.output
    assert f"cd {folder}" in done.stdout
    text = (folder / "cell.toml").read_text()
    assert "../" not in text
    assert "config/" not in text
    cell = load(folder / "cell.toml")
    assert cell.cell.state_dir == folder / "state"
    for recipe in cell.recipes.values():
        assert recipe.policy.parent == folder / "policies"
        assert recipe.policy.read_bytes() == (shipped.MODELS / recipe.policy.name).read_bytes()
    assert cell.cell.id == "one"
    own: Any = {"cell": {"state_dir", "id"}, "recipes": {"__all__": {"policy"}}}
    assert cell.model_dump(exclude=own) == load(kind.example).model_dump(exclude=own)


@pytest.mark.parametrize("kind", Kind)
def test_a_new_cell_takes_no_port_that_is_in_use(kind: Kind, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cli.config._is_free", frozenset({8020, 7457, 7458}).__contains__)
    done = run("config", "new", str(tmp_path / "my cell"), "--kind", kind.value)
    assert done.exit_code == 0, done.output
    assert "port 8000 is in use here: the cell has 8020" in done.stdout
    cell = load(tmp_path / "my cell" / "cell.toml")
    assert (cell.cell.id, cell.api.port, cell.cell.endpoint) == ("my-cell", 8020, "tcp/127.0.0.1:7457")
    if kind is not Kind.UR3E:
        assert cell.sim.endpoint == "tcp/127.0.0.1:7458"


def test_a_new_cell_overwrites_nothing(tmp_path: Path) -> None:
    mine = tmp_path / "cell.toml"
    mine.write_text("mine")
    done = run("config", "new", str(tmp_path))
    assert done.exit_code == 2
    assert "another folder" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["cell.toml"]
    assert run("config", "new", str(mine)).exit_code == 2
    assert mine.read_text() == "mine"
    assert run("config", "new", str(mine / "below")).exit_code == 3


def test_a_configuration_is_checked_with_its_policies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run("config", "new", str(tmp_path / "cell")).exit_code == 0
    monkeypatch.chdir(tmp_path / "cell")
    good = run("config", "check")
    assert good.exit_code == 0, good.output
    assert "triangle-2mm" in good.stdout
    (tmp_path / "cell/policies/vftm-dsl.onnx").unlink()
    refused = run("config", "check", "cell.toml")
    assert refused.exit_code == 1
    assert "recipe triangle-2mm: " in refused.stderr
    assert "vftm-dsl.onnx" in refused.stderr
    file = Path("cell.toml")
    file.write_text(file.read_text().replace("force_ceiling_n = 30.0", "force_ceiling_n = 300.0"))
    wrong = run("config", "check", "cell.toml")
    assert wrong.exit_code == 2
    assert "limits.force_ceiling_n" in wrong.stderr


def test_the_schema_is_json() -> None:
    assert "limits" in json.loads(run("config", "schema").stdout)["properties"]
