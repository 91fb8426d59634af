import json
from dataclasses import replace
from pathlib import Path

import pytest

from training.evaluation.results import (
    Block,
    EpisodeResult,
    MeasuringSession,
    Results,
    ResultsError,
    Setting,
    exclusive,
    wilson,
)

SETTING = Setting(part="tr", clearance_m=1e-3, conditions="standard", lock="paper", first_seed=100)
EPISODES = tuple(
    EpisodeResult(
        100 + i,
        success=i < 3,
        fault=i == 3,
        steps=10 * i,
        peak_force_n=float(i),
        episode_return=-0.5 * i,
        success_10mm=i < 2,
    )
    for i in range(5)
)
SESSION = MeasuringSession(
    ended="2026-01-01 00:00 UTC", commit="abc", machine="one, 2 cores", versions={}, workers=1, episodes=5, wall_s=2.5
)
BLOCK = Block(setting=SETTING, sessions=(SESSION,), episodes=EPISODES)
RESULTS = Results(
    policy="of a test",
    sha256="00ff",
    sources="11ee",
    mode="VFTM",
    lock="paper",
    period_s=0.1,
    max_steps=110,
    stiffness=(1, 1, 1, 1, 1, 1),
    press_m=3e-3,
    seek_step_m=1e-3,
    provenance={"algorithm": "none"},
    blocks=(BLOCK,),
)


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [
        # from the published formula, worked out by hand or to be found in any table of it
        (0, 10, 0.0, 0.2775),
        (10, 10, 0.7225, 1.0),
        (5, 10, 0.2366, 0.7634),
        (450, 500, 0.8706, 0.9233),
        (1, 1, 0.2065, 1.0),
    ],
)
def test_the_wilson_interval_has_its_known_values(successes: int, trials: int, low: float, high: float) -> None:
    assert wilson(successes, trials) == pytest.approx((low, high), abs=1e-4)


def test_an_interval_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one"):
        wilson(0, 0)


def test_a_block_sums_up_its_episodes() -> None:
    assert (BLOCK.successes, BLOCK.rate, BLOCK.interval) == (3, 0.6, wilson(3, 5))
    assert BLOCK.peaks == pytest.approx((2.0, 3.96, 4.0))
    figure = BLOCK.figure()
    assert (figure.episodes, figure.successes, figure.peak_force_median_n, figure.peak_force_max_n) == (5, 3, 2.0, 4.0)
    assert BLOCK.line().startswith("| 1.00 | tr | standard | 3/5 = 60.0% (")
    assert BLOCK.line().endswith("| 1 |")


def test_what_is_written_reads_back_the_same(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "of-a-test.json"
    RESULTS.save(path)
    assert Results.load(path) == RESULTS
    assert list(path.parent.iterdir()) == [path]


def test_a_column_takes_one_line_so_that_a_difference_can_be_read(tmp_path: Path) -> None:
    path = tmp_path / "r.json"
    RESULTS.save(path)
    lines = [line.strip().rstrip(",") for line in path.read_text().splitlines()]
    assert '"seed": [100,101,102,103,104]' in lines
    assert '"success": [1,1,1,0,0]' in lines
    assert '"claimed": [null,null,null,null,null]' in lines


def test_episodes_played_later_join_the_earlier_ones_in_the_order_of_their_seeds() -> None:
    some = BLOCK.model_copy(update={"episodes": EPISODES[2:]})
    assert some.missing(5) == [100, 101]
    again = replace(EPISODES[4], steps=99)
    whole = some.with_episodes([*EPISODES[:2], again])
    assert whole.episodes == (*EPISODES[:4], again)
    assert whole.missing(5) == []
    assert whole.first(2).episodes == EPISODES[:2]


def test_what_was_broken_off_counts_up_to_the_first_seed_that_is_missing() -> None:
    gap = BLOCK.model_copy(update={"episodes": (*EPISODES[:2], *EPISODES[3:])})
    assert gap.unbroken().episodes == EPISODES[:2]
    assert BLOCK.unbroken() == BLOCK
    assert BLOCK.model_copy(update={"episodes": EPISODES[1:]}).unbroken().episodes == ()


def test_a_block_takes_the_place_of_the_one_with_its_setting_and_no_other() -> None:
    other = Block(setting=replace(SETTING, clearance_m=2e-3))
    both = RESULTS.with_block(other)
    assert [block.setting.clearance_m for block in both.blocks] == [1e-3, 2e-3]
    shorter = both.with_block(BLOCK.first(1))
    assert [len(block.episodes) for block in shorter.blocks] == [1, 0]
    assert shorter.block(replace(SETTING, through="rtde")).episodes == ()


def test_a_file_that_is_being_added_to_is_refused_until_that_has_ended(tmp_path: Path) -> None:
    path = tmp_path / "results" / "r.json"
    with exclusive(path):
        with pytest.raises(ResultsError, match=r"another process is measuring into .*r\.json"), exclusive(path):
            pass
        with exclusive(path.with_name("other.json")):
            pass
    with exclusive(path):
        RESULTS.save(path)


def _ragged(document: dict[str, object]) -> None:
    document["blocks"][0]["episodes"]["steps"].pop()  # type: ignore[index]


def _of_no_service(document: dict[str, object]) -> None:
    document["blocks"][0]["setting"]["through"] = "zenoh"  # type: ignore[index]


def _unknown(document: dict[str, object]) -> None:
    document["colour"] = "red"


@pytest.mark.parametrize(
    ("spoil", "text"),
    [(_ragged, "columns differ in length"), (_unknown, "colour"), (_of_no_service, "not of which sources")],
)
def test_a_file_that_does_not_hold_results_is_refused_with_a_reason(tmp_path: Path, spoil: object, text: str) -> None:
    assert callable(spoil)
    path = tmp_path / "r.json"
    RESULTS.save(path)
    document = json.loads(path.read_text())
    spoil(document)
    path.write_text(json.dumps(document))
    with pytest.raises(ResultsError, match=text):
        Results.load(path)
    with pytest.raises(ResultsError, match="no results"):
        Results.load(tmp_path / "missing.json")
