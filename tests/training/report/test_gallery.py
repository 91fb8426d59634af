"""Pictures of insertions; skipped only where EGL is missing."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("PIL", reason="needs the extra `training`")

import typer
from PIL import Image
from typer.testing import CliRunner

from service.policy.model import Policy
from sim_backend.world.rendering import RenderingUnavailableError
from training.commands.gallery import gallery as command
from training.evaluation.evaluate import evaluate
from training.report import gallery
from wire.task import Task

MODEL = Path(__file__).parents[3] / "models" / "scripted-search.onnx"
SIZE = (120, 90)
APP = typer.Typer()
APP.command()(command)


@pytest.fixture(scope="module")
def policy() -> Policy:
    return Policy.load(MODEL)


@pytest.fixture(scope="module")
def task(policy: Policy) -> Task:
    task = gallery.typical_success(policy, "tr", 3e-3, "easy", 5)
    assert task is not None
    return task


@pytest.fixture(scope="module")
def film(policy: Policy, task: Task) -> gallery.Film:
    try:
        return gallery.film(policy, task, SIZE)
    except RenderingUnavailableError as error:
        pytest.skip(str(error))


def test_the_episode_shown_is_the_success_of_median_length_among_the_first_of_the_test(
    policy: Policy, task: Task
) -> None:
    played = evaluate(policy, 3e-3, 5, conditions="easy", cells=5, threads=1).episodes
    steps = {episode.seed: episode.steps for episode in played if episode.success}
    assert sorted(steps.values())[len(steps) // 2] == steps[task.seed]
    assert len(set(steps.values())) > 1  # else any would be


def test_a_film_begins_in_the_air_and_goes_on_until_the_peg_is_seated(film: gallery.Film) -> None:
    depths = [shot.depth_m for shot in film.shots]
    assert depths[0] < -15e-3
    assert max(depths[:-1]) < gallery.SEATED_DEPTH_M <= depths[-1]
    assert film.inserted_s is not None
    assert film.inserted_s < film.shots[-1].time_s
    assert film.shots[1].time_s - film.shots[0].time_s == pytest.approx(0.1)


def test_the_pictures_change_as_the_peg_goes_in(film: gallery.Film) -> None:
    first, last = film.shots[0].picture.astype(int), film.shots[-1].picture.astype(int)
    assert first.shape == (SIZE[1], SIZE[0], 3)
    assert (np.abs(first - last).max(axis=2) > 40).mean() > 0.05


def test_an_animation_runs_in_real_time_and_for_ever(film: gallery.Film, tmp_path: Path) -> None:
    path = tmp_path / "film.gif"
    gallery.write_animation(path, film)
    with Image.open(path) as animation:
        durations = []
        for index in range(animation.n_frames):
            animation.seek(index)
            durations.append(animation.info["duration"])
        assert animation.info["loop"] == 0
    moving = film.shots[-1].time_s * 1e3
    assert sum(durations) == pytest.approx(moving + gallery.HELD_MS)
    assert animation.size[0] == SIZE[0]


def test_a_strip_shows_six_frames_of_the_film(film: gallery.Film, tmp_path: Path) -> None:
    path = tmp_path / "film.png"
    gallery.write_strip(path, film)
    with Image.open(path) as strip:
        picture = np.asarray(strip.convert("RGB"), int)
    assert picture.shape[1] == 3 * SIZE[0] + 8
    last = film.shots[-1].picture.astype(int)
    corner = picture[picture.shape[0] // 2 + 2 :][: SIZE[1], -SIZE[0] :]
    assert np.abs(corner - last).mean() < 12


def test_the_page_names_what_is_shown(film: gallery.Film) -> None:
    page = gallery.page([film])
    assert f"| [tr](tr.png) | 3 mm | easy, {film.task.seed} | {film.inserted_s:.1f} s |" in page
    assert "![tr](tr.gif)" in page
    assert "policy: scripted-search." in page


def test_the_command_draws_each_part_and_a_page(
    film: gallery.Film, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gallery, "film", lambda *_: film)
    options = [str(MODEL), "--part", "tr", "--clearance", "3", "--conditions", "easy", "--seeds", "5"]
    result = CliRunner().invoke(APP, [*options, "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    assert {path.name for path in tmp_path.iterdir()} == {"tr.gif", "tr.png", "README.md"}


def test_a_policy_that_never_succeeds_has_nothing_to_show(tmp_path: Path) -> None:
    options = [str(MODEL), "--part", "tr", "--clearance", "0.05", "--seeds", "1", "--out", str(tmp_path)]
    result = CliRunner().invoke(APP, options)
    assert result.exit_code == 2
    assert "tr: none of 1 seeds succeeds" in result.output
    assert not list(tmp_path.iterdir())


def test_a_file_that_is_no_policy_is_refused(tmp_path: Path) -> None:
    result = CliRunner().invoke(APP, [str(tmp_path / "absent.onnx")])
    assert result.exit_code == 2
    assert "absent.onnx" in result.output
