"""The panels that ship: what they hold, and what is refused as a panel."""

from dataclasses import asdict
from pathlib import Path

import pytest

from service.policy.model import Policy
from training.environment.insertion import Insertions
from training.evaluation import carry, panel, provenance, replay
from training.evaluation.evaluate import FIRST_TEST_SEED, jobs_of, measure, play
from training.evaluation.results import Block, Setting
from wire.plant import PlantErrors
from wire.task import Task

NAMES = ("plant", "plant-validation")
GOOD = """
about = "Mine."
first_seed = 1
episodes = 2
clearances_mm = [1.33]
[lines]
"nominal" = {}
"tilted" = { hole_tilt_deg = 2.0 }
"""


def test_both_panels_have_the_same_kinds_of_errors_with_other_values_on_other_seeds() -> None:
    test, validation = (panel.load(name) for name in NAMES)
    kinds = [[plant and set(plant.to_json()) for plant in one.lines.values()] for one in (test, validation)]
    assert kinds[0] == kinds[1]
    assert [*test.lines.values()].count(None) == 1
    assert not set(test.lines.values()) & set(validation.lines.values()) - {None}
    assert validation.first_seed + validation.episodes < FIRST_TEST_SEED <= test.first_seed


def test_every_error_of_a_plant_is_on_the_panel() -> None:
    lines = panel.load("plant").lines.values()
    assert {name for plant in lines if plant is not None for name in plant.to_json()} == set(PlantErrors.__slots__)


def test_a_panel_of_ones_own_is_read_from_a_path(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(GOOD)
    mine = panel.load(str(path))
    assert mine.name == "mine"
    assert mine.lines == {"nominal": None, "tilted": PlantErrors(hole_tilt_deg=2.0)}
    assert mine.path(Path("results"), "p") == Path("results/panels/mine/p.json")


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (("hole_tilt_deg = 2.0", "hole_tilt = 2.0"), r"lines\.tilted[\s\S]*plant\.hole_tilt is no error of a plant"),
        (
            ("hole_tilt_deg = 2.0", "hole_tilt_deg = 9.0"),
            r"plant\.hole_tilt_deg must be a number from 0 to 5, not 9\.0",
        ),
        (("episodes = 2", "episodes = 0"), r"mine\.toml holds no panel: [\s\S]*episodes"),
        (("first_seed = 1", ""), "first_seed"),
        (("episodes = 2", "episodes = 2\ncolour = 1"), "colour"),
        (("[lines]", "[lines"), r"mine\.toml holds no panel"),
    ],
)
def test_what_is_no_panel_is_refused(tmp_path: Path, change: tuple[str, str], text: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(GOOD.replace(*change))
    with pytest.raises(panel.PanelError, match=text):
        panel.load(str(path))


def test_a_panel_that_there_is_not_is_refused_with_the_names_of_the_others() -> None:
    with pytest.raises(panel.PanelError, match="there is no panel plants; there are plant, plant-validation, and"):
        panel.load("plants")


def test_the_episodes_of_a_line_are_those_of_its_plant_and_so_is_their_replay(
    model_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy, errors = Policy.load(model_path), PlantErrors(hole_tilt_deg=3.0, ft_left_n=3.0)
    setting = Setting(
        part="tr",
        clearance_m=3e-3,
        conditions="easy",
        lock="paper",
        reward="potential",
        first_seed=FIRST_TEST_SEED,
        plant=errors,
        line="tilted",
    )
    ((_, (found,)),) = measure(jobs_of(model_path, policy.sha256, Block(setting=setting), 1), 1)
    job = carry.ReplayJob(Path("r.json"), Block(setting=setting, episodes=(found,)), model_path, None, repeatable=True)
    monkeypatch.chdir(provenance.ROOT)
    (again,) = replay.play_environment(job.request)["episodes"]
    assert again["result"] == asdict(found)
    own = Insertions(policy.contract, 1)
    (expected,) = play(policy, own, [Task(FIRST_TEST_SEED, "tr", 3e-3, "easy", plant=errors)])
    (nominal,) = play(policy, own, [Task(FIRST_TEST_SEED, "tr", 3e-3, "easy")])
    assert (found.steps, found.peak_force_n) == (expected.steps, expected.peak_force_n)
    assert found.peak_force_n != nominal.peak_force_n


def test_a_block_keeps_its_plant_and_its_line_on_file() -> None:
    usual = Setting(part="tr", clearance_m=1e-3, conditions="easy", lock="paper", first_seed=1)
    tilted = Setting(
        part="tr",
        clearance_m=1e-3,
        conditions="easy",
        lock="paper",
        first_seed=1,
        plant=PlantErrors(hole_tilt_deg=3.0),
        line="tilted",
    )
    for setting in (usual, tilted):
        assert Block.model_validate_json(Block(setting=setting).model_dump_json()).setting == setting
    assert not {"plant", "line"} & Block(setting=usual).model_dump()["setting"].keys()
    assert Block(setting=tilted).model_dump()["setting"]["plant"] == {"hole_tilt_deg": 3.0}
