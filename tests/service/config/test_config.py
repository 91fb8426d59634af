from pathlib import Path
from typing import get_args

import pytest

from service.config import PATH_VARIABLE, CellConfig, ConfigError, RecipeSection, find, load
from tests.conftest import REALTIME_VARIABLE
from wire.limits import FORCE_HARD_MAXIMUM_N
from wire.plant import PlantErrors
from wire.task import Conditions

SHIPPED = Path(__file__).parents[3] / "config" / "cell.toml"


def written(tmp_path: Path, old: str = "", new: str = "") -> Path:
    text = SHIPPED.read_text()
    assert old in text
    path = tmp_path / "cell.toml"
    path.write_text(text.replace(old, new))
    return path


def test_the_shipped_configuration_is_whole_and_its_paths_are_relative_to_the_file() -> None:
    config = load(SHIPPED)
    assert config.cell.state_dir.is_absolute()
    assert all(recipe.policy.is_absolute() for recipe in config.recipes.values())
    assert config.limits.force_ceiling_n == 30.0


def test_the_file_is_the_named_one_else_that_of_the_environment_else_that_of_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(PATH_VARIABLE, raising=False)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match="dsl-assembly config new FOLDER"):
        find()
    (tmp_path / "config").mkdir()
    for name in ("config/cell.toml", "cell.toml"):
        (tmp_path / name).touch()
        assert find() == tmp_path / name
        (tmp_path / name).unlink()
    for name in ("config/cell.toml", "cell.toml"):
        (tmp_path / name).touch()
    with pytest.raises(ConfigError, match="are both in"):
        find()
    monkeypatch.setenv(PATH_VARIABLE, "")
    with pytest.raises(ConfigError, match="no configuration at"):
        load()
    monkeypatch.setenv(PATH_VARIABLE, "other.toml")
    assert find() == tmp_path / "other.toml", "named and missing: that is an error, and no reason to take another"
    with pytest.raises(ConfigError, match=r"no configuration at .*other\.toml"):
        load()
    assert find(Path("third.toml")) == tmp_path / "third.toml"


@pytest.mark.parametrize("value", ["50.001", "0.0", "-1.0", "nan", "inf", "-inf", '"much"'])
def test_55_a_ceiling_out_of_range_is_refused_by_its_name(tmp_path: Path, value: str) -> None:
    path = written(tmp_path, "force_ceiling_n = 30.0", f"force_ceiling_n = {value}")
    with pytest.raises(ConfigError, match=r"limits\.force_ceiling_n"):
        load(path)


def test_55_a_missing_ceiling_is_refused_by_its_name(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"limits\.force_ceiling_n: Field required"):
        load(written(tmp_path, "force_ceiling_n = 30.0", ""))


def test_the_hard_maximum_itself_is_allowed(tmp_path: Path) -> None:
    config = load(written(tmp_path, "force_ceiling_n = 30.0", f"force_ceiling_n = {FORCE_HARD_MAXIMUM_N}"))
    assert config.limits.force_ceiling_n == FORCE_HARD_MAXIMUM_N


def test_a_recipe_may_lower_the_ceiling_and_not_raise_it(tmp_path: Path) -> None:
    lower = load(written(tmp_path, 'part = "tr"', 'part = "tr"\nforce_ceiling_n = 12.0'))
    assert lower.recipes["triangle-2mm"].force_ceiling_n == 12.0
    with pytest.raises(ConfigError, match=r"recipes\.triangle-2mm\.force_ceiling_n is 31"):
        load(written(tmp_path, 'part = "tr"', 'part = "tr"\nforce_ceiling_n = 31.0'))


def test_an_unknown_field_is_refused_by_its_name(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"limits\.force_celing_n: no such field"):
        load(written(tmp_path, "force_ceiling_n = 30.0", "force_ceiling_n = 30.0\nforce_celing_n = 10.0"))


def test_every_wrong_field_is_named_at_once(tmp_path: Path) -> None:
    path = written(tmp_path, "[api]", "[api]\nthreads = 4")
    path.write_text(path.read_text().replace("port = 8000", "port = 0"))
    with pytest.raises(ConfigError, match=r"(?s)api\.port.*api\.threads|api\.threads.*api\.port"):
        load(path)


def test_a_workspace_whose_corners_are_swapped_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"limits\.workspace_m"):
        load(written(tmp_path, "[[0.15, -0.26, 0.01], [0.45", "[[0.55, -0.26, 0.01], [0.45"))


def test_the_environment_overrides_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DSL_ASSEMBLY__API__PORT", "8123")
    monkeypatch.setenv("DSL_ASSEMBLY__LIMITS__FORCE_CEILING_N", "20")
    config = load(written(tmp_path))
    assert (config.api.port, config.limits.force_ceiling_n) == (8123, 20.0)
    monkeypatch.setenv("DSL_ASSEMBLY__LIMITS__FORCE_CEILING_N", "60")
    with pytest.raises(ConfigError, match=r"limits\.force_ceiling_n"):
        load(written(tmp_path))


def test_the_file_is_the_one_that_the_environment_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DSL_ASSEMBLY_CONFIG", str(written(tmp_path, 'id = "cell-1"', 'id = "other"')))
    assert load().cell.id == "other"


def test_a_real_arm_alone_asks_for_real_time_scheduling_unless_the_cell_says_otherwise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(REALTIME_VARIABLE)
    asked = {name: load(SHIPPED.with_name(f"{name}.toml")).asks_realtime for name in ("cell", "ur-emulated", "ur3e")}
    assert asked == {"cell": False, "ur-emulated": False, "ur3e": True}
    monkeypatch.setenv(REALTIME_VARIABLE, "true")
    assert load(SHIPPED).asks_realtime
    monkeypatch.setenv(REALTIME_VARIABLE, "false")
    assert not load(SHIPPED.with_name("ur3e.toml")).asks_realtime


def test_an_age_that_the_samples_of_a_resting_world_reach_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, "sample_age_s = 0.08", "sample_age_s = 0.015")
    with pytest.raises(
        ConfigError, match=r"limits\.sample_age_s is 0\.015 s, .* at rest it gives a sample every 0\.01"
    ):
        load(path)
    path.write_text(path.read_text().replace('"real_time"', '"lockstep"'))
    load(path)


@pytest.mark.parametrize("content", [None, "[cell", "\x00"])
def test_a_file_that_is_not_there_or_not_toml_is_a_clear_error(tmp_path: Path, content: str | None) -> None:
    path = tmp_path / "cell.toml"
    if content is not None:
        path.write_text(content)
    with pytest.raises(ConfigError, match=r"cell\.toml"):
        load(path)


@pytest.mark.parametrize(("name", "least"), [("damping", 6.0), ("inertia", 0.3)])
def test_a_law_that_no_policy_could_have_is_refused(tmp_path: Path, name: str, least: float) -> None:
    wrong = f"[limits]\nmin_{name} = [1.0, 1.0, 1.0, 0.1, 0.1, {least}]"
    with pytest.raises(ConfigError, match=rf"limits\.min_{name} must not be above limits\.max_{name}"):
        load(written(tmp_path, "[limits]", wrong))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("max_contact_share", 1.01),
        ("max_contact_share", 0.0),
        ("max_seek_step_m", 0.021),
        ("max_lift_m", 0.051),
        ("max_search_depth_m", 0.21),
        ("max_search_steps", 2001),
        ("max_damping", [-1.0] * 6),
        ("max_inertia", ["inf"] * 6),
    ],
)
def test_a_limit_of_locks_and_laws_out_of_range_is_refused_by_its_name(
    tmp_path: Path, field: str, value: object
) -> None:
    with pytest.raises(ConfigError, match=rf"limits\.{field}"):
        load(written(tmp_path, "[limits]", f"[limits]\n{field} = {value}".replace("'", "")))


@pytest.mark.parametrize("name", ["a/b", "a*b", "", "a b", "../x"])
def test_a_recipe_or_cell_whose_name_cannot_stand_in_a_key_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigError):
        load(written(tmp_path, "[recipes.triangle-2mm]", f'[recipes."{name}"]'))
    with pytest.raises(ConfigError, match=r"cell\.id"):
        load(written(tmp_path, 'id = "cell-1"', f'id = "{name}"'))


def test_the_schema_names_every_section() -> None:
    schema = CellConfig.model_json_schema()
    sections = {"cell", "limits", "preflight", "witness", "sim", "ur", "camera", "tls", "api", "client_loss", "recipes"}
    assert set(schema["properties"]) == sections
    assert schema["additionalProperties"] is False


def test_a_recipe_may_ask_for_every_set_of_conditions_that_a_world_has() -> None:
    assert get_args(RecipeSection.model_fields["conditions"].annotation) == get_args(Conditions)


def test_a_recipe_names_the_errors_of_its_simulated_plant(tmp_path: Path) -> None:
    text = "[recipes.triangle-2mm]\nplant = { hole_tilt_deg = 1.0 }"
    assert load(written(tmp_path, "[recipes.triangle-2mm]", text)).recipes["triangle-2mm"].plant == PlantErrors(
        hole_tilt_deg=1.0
    )
    with pytest.raises(ConfigError, match=r"plant\.hole_tilt_deg must be a number from 0 to 5, not 6\.0"):
        load(written(tmp_path, "[recipes.triangle-2mm]", text.replace("1.0", "6.0")))


@pytest.mark.parametrize(
    ("endpoint", "named"),
    [
        ("tcp/0.0.0.0:7447", "whoever reaches it commands the cell"),
        ("tcp/192.168.7.2:7447", "whoever reaches it commands the cell"),
        ("tls/192.168.7.2:7447", r"so the section \[tls\] must name the certificates"),
        ("tls/127.0.0.1:7447", r"so the section \[tls\] must name the certificates"),
    ],
)
def test_70_a_control_process_that_strangers_could_command_does_not_boot(
    tmp_path: Path, endpoint: str, named: str
) -> None:
    with pytest.raises(ConfigError, match=named):
        load(written(tmp_path, "tcp/127.0.0.1:7447", endpoint))


def test_a_socket_in_the_file_system_is_on_this_machine(tmp_path: Path) -> None:
    endpoint = "unixsock-stream//run/cell/control"
    assert load(written(tmp_path, "tcp/127.0.0.1:7447", endpoint)).cell.endpoint == endpoint


def test_certificates_are_relative_to_the_file(tmp_path: Path) -> None:
    path = written(tmp_path, "tcp/127.0.0.1:7447", "tls/192.168.7.2:7447")
    with path.open("a") as file:
        file.write('\n[tls]\nauthority = "a.pem"\ncertificate = "b.pem"\nkey = "c.key"\ncommanders = ["cell-1"]\n')
    certificates = load(path).certificates
    assert certificates is not None
    assert (certificates.authority, certificates.key) == (tmp_path / "a.pem", tmp_path / "c.key")
