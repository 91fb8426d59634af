from pathlib import Path

import pytest

from cli import address
from cli.address import AddressError, find_cell
from service import config
from service.config import ApiSection, CellSection, load


def test_the_short_reading_of_a_configuration_has_the_names_and_defaults_of_the_full_one(config_path: Path) -> None:
    assert address.PATH_VARIABLE == config.PATH_VARIABLE
    assert address.DEFAULT_PATHS == config.DEFAULT_PATHS
    assert config.CellConfig.model_config.get("env_prefix") == address.FIELD_VARIABLE
    assert CellSection.model_fields["endpoint"].default == address.DEFAULT_ENDPOINT
    assert (ApiSection().host, ApiSection().port) == (address.DEFAULT_HOST, address.DEFAULT_PORT)
    assert f"http://{address.DEFAULT_HOST}:{address.DEFAULT_PORT}" == address.DEFAULT_URL
    assert find_cell(None) is None


@pytest.mark.parametrize(
    ("variables", "url"),
    [
        ({}, "http://127.0.0.1:8000"),
        ({"DSL_ASSEMBLY__API__PORT": "8001"}, "http://127.0.0.1:8001"),
        ({"dsl_assembly__api__port": "8001"}, "http://127.0.0.1:8001"),
        ({"DSL_ASSEMBLY__API": '{"port": 8002}'}, "http://127.0.0.1:8002"),
        ({"DSL_ASSEMBLY__API__HOST": "0.0.0.0"}, "http://127.0.0.1:8000"),  # noqa: S104
        ({"DSL_ASSEMBLY__API__HOST": "::"}, "http://[::1]:8000"),
    ],
)
def test_variables_override_the_file_as_they_do_for_the_cell(
    config_path: Path, monkeypatch: pytest.MonkeyPatch, variables: dict[str, str], url: str
) -> None:
    monkeypatch.setenv("DSL_ASSEMBLY__CELL__ID", "cell-renamed")
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    found, full = find_cell(config_path), load(config_path)
    assert found is not None
    assert (found.cell, found.endpoint) == (full.cell.id, full.cell.endpoint)
    assert found.cell == "cell-renamed"
    assert found.url == url
    assert url.endswith(f":{full.api.port}")


@pytest.mark.parametrize("text", ["[cell", "[cell]", "cell = 1", "[cell]\nid = 'a'\n[api]\nport = 'b'"])
def test_a_file_that_names_no_cell_says_why(tmp_path: Path, text: str) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    with pytest.raises(AddressError, match=r"wrong\.toml names no cell"):
        find_cell(path)
