"""The report of a handful of results: what it says of them, and that it says what is missing."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

pytest.importorskip("matplotlib", reason="needs the extra `training`: pip install -e '.[training]'")

from training.commands.report import report
from training.evaluation import panel
from training.evaluation.evaluate import FIRST_TEST_SEED
from training.evaluation.results import Block, EpisodeResult, MeasuringSession, Results, ResultsError, Setting
from training.report import curves, paper
from training.report.measured import Measured
from training.report.paper_chapters import beaten
from training.report.writing import document
from wire.plant import PlantErrors
from wire.task import Conditions, Part


def block(
    successes: int,
    episodes: int = 50,
    *,
    clearance_mm: float = 1.33,
    part: Part = "tr",
    conditions: Conditions = "standard",
    lock: Any = "paper",
    through: Any = "environment",
    first_seed: int = FIRST_TEST_SEED,
    force_n: float = 10.0,
) -> Block:
    played = tuple(
        EpisodeResult(
            first_seed + i,
            success=i < successes,
            fault=False,
            steps=50,
            peak_force_n=force_n + i / 100,
            episode_return=-1.0 if i % 2 else -3.0,
            success_10mm=i < successes - 1,
            code=None if i < successes + 1 or through == "environment" else "SEARCH_LIMIT",
            claimed=i < successes + 1 if through != "environment" else None,
        )
        for i in range(episodes)
    )
    setting = Setting(
        part=part,
        clearance_m=paper.metres(clearance_mm),
        conditions=conditions,
        lock=lock,
        through=through,
        first_seed=first_seed,
    )
    return Block(setting=setting, episodes=played)


def results(*blocks: Block, mode: Any = "VFTM", lock: Any = "paper", **changes: Any) -> Results:
    found = Results(
        policy="p",
        sha256="0" * 64,
        sources="0" * 64,
        deployed_sources="1" * 64,
        mode=mode,
        lock=lock,
        period_s=0.1,
        max_steps=110,
        stiffness=(1, 1, 1, 1, 1, 1),
        press_m=0.0,
        seek_step_m=3e-3,
        provenance={},
        blocks=blocks,
    )
    return found.model_copy(update=changes)


def exported(experiment: str, steps: int, clearance_mm: tuple[float, float], **session: Any) -> dict[str, Any]:
    """A provenance as `dsl-assembly export` writes it."""
    task = {"parts": ["tr"], "clearance_mm": clearance_mm, "conditions": "standard", "randomise_plant": True}
    return {
        "experiment": {
            "name": experiment,
            "title": "of a test",
            "task": task | {"reward": "potential", "force_ceiling_n": 30.0},
            "algorithm": {"memory": "gru", "steps": steps, "cells": 8},
            "start_from": "wide",
        },
        "seed": 3,
        "sessions": [{"steps": 0, "began": "2026-01-01", "commit": None, "machine": "one", **session}],
        "steps": steps,
        "elapsed_s": 3600.0,
    }


def told(measured: Measured) -> str:
    return document(measured).to_markdown(Path("pictures"))


def line_with(text: str, *words: str) -> str:
    (line,) = [line for line in text.splitlines() if all(word in line for word in words)]
    return line


def test_a_report_of_nothing_says_that_nothing_was_measured() -> None:
    report = document(Measured({}, ()))
    text = report.to_markdown(Path("pictures"))
    assert report.pictures == []
    assert line_with(text, "success at 1.33 mm per face").endswith("| not measured | not measured |")
    assert line_with(text, "cells of Table II above").endswith("| not measured | not measured |")
    assert "met |" not in text


def test_a_target_is_met_by_the_rate_and_the_paper_is_beaten_by_the_lower_end_of_the_interval() -> None:
    enough = told(Measured({"vftm-dsl": results(block(500, 500))}, ()))
    assert line_with(enough, "success at 1.33 mm per face").endswith("| **100.0 %** (99.2–100.0) | met |")
    assert line_with(enough, "above the paper at 1.33 mm").endswith("| 88.57 % | 99.2 % | met |")
    # 46 of 50 is 92 %, above the paper's 88.57 %, but its interval begins at 81 %
    doubtful = told(Measured({"vftm-dsl": results(block(46))}, ()))
    assert line_with(doubtful, "above the paper at 1.33 mm").endswith("| 81.2 % | missed |")


def test_harder_conditions_stand_beside_the_standard_ones_and_do_not_count_as_them() -> None:
    text = told(Measured({"vftm-dsl": results(block(40, conditions="stiff"))}, ()))
    assert line_with(text, "success at 1.33 mm per face").endswith("| not measured | not measured |")
    assert "The same policy in the conditions `stiff`" in text
    assert line_with(text, "| 1.33 mm | **80.0 %**")


def test_a_limit_of_force_is_met_only_once_every_clearance_was_measured() -> None:
    levels = [level.clearance_mm for level in paper.comparison().strength.levels]

    def verdict(levels: list[float], force_n: float) -> str:
        found = {"vftm-dsl": results(*(block(40, clearance_mm=level, force_n=force_n) for level in levels))}
        return line_with(told(Measured(found, ())), "p99 of the peak force, at").split(" | ")[-1]

    assert verdict(levels, 10.0) == "met |"
    assert verdict(levels[:1], 10.0) == "not measured |"
    assert verdict(levels[:1], 20.0) == "missed |"


def test_what_was_measured_in_another_reward_or_at_another_ceiling_stands_in_no_table() -> None:
    known = block(40)
    for change in ({"reward": "potential"}, {"force_ceiling_n": 50.0}):
        other = known.model_copy(update={"setting": replace(known.setting, **change)})
        assert Measured({"p": results(other)}, ()).block("p", 1.33) is None
        assert Measured({"p": results(other, known)}, ()).block("p", 1.33) == known


def test_a_measurement_of_several_sessions_names_the_commits_of_all() -> None:
    sessions = tuple(
        MeasuringSession(
            ended="2026-01-01", commit=commit, machine="one", versions={}, workers=1, episodes=25, wall_s=1.0
        )
        for commit in ("aaaaaaaaaaaa", "bbbbbbbbbbbb-dirty", "aaaaaaaaaaaa")
    )
    text = told(Measured({"p": results(block(40).model_copy(update={"sessions": sessions}))}, ()))
    line_with(text, "| 2000000, 50 |", "| `aaaaaaaaa`, `bbbbbbbbb-dirty` | one |")


def test_table_1_has_the_paper_our_run_of_it_and_the_mean_and_variance_of_the_return() -> None:
    text = told(Measured({"paper-vftm-c133": results(block(40))}, ()))
    row = line_with(text, "| reproduced | 1.33 mm | **80.0 %** (67.0–88.8), n = 50 |")
    assert "| 78.0 % | 50 | −2.0000 | 1.0000 | 10.2 / 10.5 / 10.5 |" in row
    assert "| **VFTM-DSL** | the paper | 4 mm | 88.57 % |" in text
    assert "| **FTM-DSL** | the paper | 4 mm | 56.42 % |" in text


def test_the_papers_order_is_said_to_appear_only_where_it_does() -> None:
    modes = {"vftm": "VFTM", "ftm": "FTM", "vm": "VM"}
    for counts, verdict in (((45, 25, 5), "yes"), ((45, 43, 5), "yes, but intervals overlap"), ((45, 5, 25), "no")):
        found = {
            f"paper-{name}-c133": results(block(count, conditions="search" if mode == "FTM" else "standard"), mode=mode)
            for (name, mode), count in zip(modes.items(), counts, strict=True)
        }
        assert line_with(told(Measured(found, ())), "VFTM-DSL > FTM-DSL > VM").endswith(f"| {verdict} |")


def test_table_2_takes_measurements_of_the_other_plant_only() -> None:
    cell = {"clearance_mm": 1.333333, "part": "cir"}
    wrong = told(Measured({"vftm-dsl": results(block(50, **cell))}, ()))
    assert "c = 1.33 mm | `vftm-dsl` | not measured |" in line_with(wrong, "13.76 %")
    right = told(Measured({"vftm-dsl": results(block(50, conditions="transfer", **cell))}, ()))
    assert line_with(right, "13.76 %").endswith("| above |")
    assert line_with(right, "cells of Table II above", "by their rate, in the environment").endswith(
        "| 1 of 1 measured, 1 with the whole interval; n ≥ 50 | not measured |"
    )
    # 11 of 50 is 22 %, above the paper's 20 %, but its interval begins at 13 %
    doubtful = told(Measured({"vftm-dsl": results(block(11, conditions="transfer", **cell))}, ()))
    assert "| 1 of 1 measured, 0 with the whole interval; n ≥ 50 |" in line_with(doubtful, "cells of Table II above")


def test_beside_the_transfer_stands_the_same_part_on_the_plant_of_the_training() -> None:
    cell = {"clearance_mm": 1.333333, "part": "cir"}
    measured = Measured({"vftm-dsl": results(block(40, **cell), block(20, conditions="transfer", **cell))}, ())
    text = told(measured)
    assert "**80.0 %**" in line_with(text, "| **cir**, 1.33 mm |")
    assert "**40.0 %**" in line_with(text, "13.76 %")


@pytest.mark.parametrize(
    ("successes", "verdict"), [(50, "above"), (15, "above, interval overlaps"), (14, "below"), (0, "below")]
)
def test_a_cell_of_table_2_is_compared_with_the_larger_figure(successes: int, verdict: str) -> None:
    judged = beaten(block(successes), 0.2864)
    assert getattr(judged, "text", None) == verdict


def test_how_policies_were_trained_stands_beside_what_they_do() -> None:
    found = {
        "vftm-dsl": results(block(40), provenance=exported("vftm-dsl", 3_000_000, (0.25, 2.0)), policy="vftm-dsl"),
        "vftm-sliding": results(
            block(30, lock="sliding"),
            lock="sliding",
            policy="vftm-sliding",
            provenance=exported("vftm-sliding", 500_000, (1.0, 1.0), began_with={"file": "best.pt", "steps": 1}),
        ),
        "scripted-search": results(block(20), policy="scripted-search", provenance={"script": "of a test"}),
    }
    text = told(Measured(found, ()))
    line_with(text, "| `vftm-dsl` | `vftm-dsl` | 3 | `wide` | 3.00 M | 60 min | 0.25 to 2 mm |")
    line_with(text, "| `vftm-sliding` | `vftm-sliding` | 3 | `best.pt` at 0.00 M steps | 0.50 M | 60 min | 1 mm |")
    line_with(text, "| `scripted-search` | by hand |")
    both = "`vftm-dsl` 3.00 M steps after `wide` at c = 0.25 to 2 mm; `vftm-sliding` 0.50 M steps after `best.pt`"
    assert sum(both in line for line in text.splitlines()) == 2  # Table I, and force


def test_what_a_lock_allows_beyond_the_papers_is_said() -> None:
    found = {
        "vftm-dsl": results(block(40), press_m=3e-3),
        "paper-vftm-c133": results(block(40)),
        "vftm-sliding": results(block(30, lock="sliding"), lock="sliding", press_m=7e-3),
    }
    text = told(Measured(found, ()))
    assert "of ours `vftm-dsl` by 3 mm may. Before contact ours steps down by 3 mm." in text
    line_with(text, "| paper | 3 mm, 3 mm | 10 Hz")
    line_with(text, "| paper | 0 mm, 3 mm | 10 Hz")


def test_results_of_a_policy_of_another_name_are_flagged() -> None:
    right = told(Measured({"vftm-dsl": results(block(40), policy="vftm-dsl")}, ()))
    assert "under another name" not in right
    wrong = told(Measured({"vftm-dsl": results(block(40), policy="somebody-elses")}, ()))
    line_with(wrong, "under another name", "`vftm-dsl` holds `somebody-elses`")
    line_with(wrong, "| `vftm-dsl` | `somebody-elses` | VFTM |")


def test_measurements_with_several_sources_are_told_apart() -> None:
    found = {"one": results(block(40)), "other": results(block(40), sources="1" * 64)}
    assert "with the same sources" in told(Measured(found, ()))
    assert "with the same sources" not in told(Measured({"one": found["one"]}, ()))


def test_forces_are_compared_over_the_seeds_that_both_insert() -> None:
    found = {
        "vftm-dsl": results(block(40, force_n=8.0)),
        "vftm-sliding": results(block(30, lock="sliding", force_n=12.0), lock="sliding"),
    }
    report = document(Measured(found, ()))
    row = line_with(report.to_markdown(Path("pictures")), "| sliding | **60.0 %**")
    assert "| 30 | 8.1 / 8.3 / 8.3 | 12.1 / 12.3 / 12.3 | 100.0 % (88.6–100.0) |" in row
    assert "force" in {picture.name for picture in report.pictures}


def test_a_policy_under_another_lock_is_not_taken_for_itself() -> None:
    swapped = block(0, lock="off")
    text = told(Measured({"vftm-dsl": results(swapped)}, ()))
    assert line_with(text, "success at 1.33 mm per face").endswith("| not measured | not measured |")
    assert "| DSL's policy without a lock | **0.0 %**" in text


def test_only_test_seeds_and_the_batched_environment_count_for_a_policys_strength() -> None:
    for other in (block(50, first_seed=500_000), block(50, through="rtde")):
        text = told(Measured({"vftm-dsl": results(other)}, ()))
        assert line_with(text, "success at 1.33 mm per face").endswith("| not measured | not measured |")


def test_the_service_stands_beside_the_environment_on_the_same_seeds() -> None:
    found = {"vftm-dsl": results(block(40), block(8, 10, through="rtde"))}
    row = line_with(told(Measured(found, ())), "service over RTDE | 10 |")
    assert "**80.0 %**" in row
    assert "| 100.0 % of 10 |" in row
    assert row.endswith("| 1 | SEARCH_LIMIT 1 |")


TASK = {"reward": "paper", "mode": "VFTM"}


def run_folder(folder: Path, name: str = "paper-vftm-c133") -> Path:
    """A training as `training.learning.run` leaves it, its last line half written."""
    folder = folder / name / "seed-3"
    folder.mkdir(parents=True)
    account = {
        "experiment": {"name": name, "title": "of a test", "start_from": None, "task": TASK},
        "seed": 3,
        "sessions": [{"machine": "a machine", "commit": "abc"}],
    }
    (folder / "run.json").write_text(json.dumps(account))
    lines: list[dict[str, Any]] = []
    for steps in range(0, 3000, 1000):
        lines.append({"kind": "rollout", "steps": steps, "elapsed_s": steps / 10, "success": 0.5})
        evaluation = {
            "part": "tr",
            "clearance_m": 1.33e-3,
            "conditions": "standard",
            "episodes": 10,
            "successes": steps // 1000,
            "return_mean": -1,
        }
        lines.append({"kind": "evaluation", "steps": steps, "elapsed_s": steps / 10, **evaluation})
    text = "".join(json.dumps(line) + "\n" for line in lines)
    (folder / "progress.jsonl").write_text(text + '{"kind": "roll')
    return folder


def test_learning_curves_are_kept_beside_the_results_and_drawn(tmp_path: Path) -> None:
    run_folder(tmp_path / "runs")
    (tmp_path / "runs" / "just-begun" / "seed-0").mkdir(parents=True)
    assert curves.collect(tmp_path / "runs", tmp_path / "results") == 1
    (curve,) = curves.load(tmp_path / "results")
    assert [(point.steps, point.success, point.clearance_mm) for point in curve.evaluations] == [
        (0, 0.0, 1.33),
        (1000, 0.1, 1.33),
        (2000, 0.2, 1.33),
    ]
    drawn = document(Measured({}, (curve,)))
    (picture, lock) = [picture for picture in drawn.pictures if picture.name.startswith("curves-")]
    assert picture.name == "curves-observation-c133"
    assert "VFTM: 1 seed, 20.0 % after 0.00 M steps" in picture.caption
    assert lock.name == "curves-lock-real"


def test_a_longer_curve_that_is_kept_stays(tmp_path: Path) -> None:
    runs, kept = tmp_path / "runs", tmp_path / "results"
    progress = run_folder(runs) / "progress.jsonl"
    assert curves.collect(runs, kept) == 1
    assert curves.collect(runs, kept) == 0
    (longer,) = curves.load(kept)
    progress.write_text("".join(f"{line}\n" for line in progress.read_text().splitlines()[:2]))
    assert curves.collect(runs, kept) == 0
    assert curves.load(kept) == [longer]


def test_a_curve_says_what_other_weights_its_training_began_with(tmp_path: Path) -> None:
    folder = run_folder(tmp_path / "runs")
    account = json.loads((folder / "run.json").read_text())
    account["sessions"].insert(0, {"began_with": {"file": "best.pt", "steps": 7}})
    (folder / "run.json").write_text(json.dumps(account))
    curve = curves.Curve.of_run(folder)
    assert curve is not None
    assert curve.label == "`paper-vftm-c133`, after `best.pt`"


def test_the_time_to_the_papers_success_is_that_of_the_first_of_two_evaluations_that_have_it(tmp_path: Path) -> None:
    folder = run_folder(tmp_path / "runs")
    lines = [json.loads(line) for line in (folder / "progress.jsonl").read_text().splitlines()[:-1]]
    late = [{**lines[1], "steps": 500_000 * n, "elapsed_s": 100.0 * n, "successes": 7 + n} for n in range(1, 4)]
    (folder / "progress.jsonl").write_text("".join(json.dumps(line) + "\n" for line in [*lines, *late]))
    (curve,) = [curve for curve in [curves.Curve.of_run(folder)] if curve is not None]
    row = line_with(told(Measured({}, (curve,))), "1.33 mm, `standard` | 88.57 % | `paper-vftm-c133` | 3")
    assert "| 1.00 M | 3 min | 10 |" in row
    for successes, reached in (((9, 8, 9, 9), 1_500_000), ((9, 8, 9), 1_500_000), ((9, 8, 8), None)):
        points = [
            curve.evaluations[0].model_copy(update={"steps": 500_000 * n, "success": count / 10})
            for n, count in enumerate(successes, 1)
        ]
        point = curve.model_copy(update={"evaluations": tuple(points)}).reached(0.88, 1.33)
        assert (point and point.steps) == reached
    without_camera = curve.model_copy(update={"mode": "FTM"})
    assert "| 88.57 % | `paper-vftm-c133` |" not in told(Measured({}, (without_camera,)))
    continued = curve.model_copy(update={"start_from": "easier"})
    line_with(told(Measured({}, (continued,))), "| 88.57 % | `paper-vftm-c133`, after `easier` | 3 |")
    assert curve.reached(0.88, 0.33) is None


def test_the_command_writes_page_markdown_and_pictures_and_the_same_again(tmp_path: Path) -> None:
    folder = tmp_path / "results"
    results(block(40), block(10, clearance_mm=0.33)).save(folder / "vftm-dsl.json")
    run_folder(tmp_path / "runs")
    out = tmp_path / "docs"

    def written() -> dict[str, bytes]:
        report(folder, tmp_path / "runs", out, tmp_path / "no models")
        return {str(path.relative_to(out)): path.read_bytes() for path in out.rglob("*") if path.is_file()}

    first = written()
    assert {"results.html", "results.md", "pictures/results/strength.svg"} <= first.keys()
    for name, data in first.items():
        if name.endswith(".svg"):
            ElementTree.fromstring(data)  # noqa: S314
            assert f"pictures/results/{Path(name).name}".encode() in first["results.md"]
    stale = out / "pictures/results/of-an-earlier-report.svg"
    stale.write_text("<svg/>")
    assert written() == first


def test_a_file_that_holds_something_else_is_named(tmp_path: Path) -> None:
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(ResultsError, match=r"other\.json"):
        Measured.read(tmp_path)


def on_panel(line: str, plant: PlantErrors | None, successes: int, clearance_mm: float = 1.33) -> Block:
    found = block(successes, 20, clearance_mm=clearance_mm)
    return found.model_copy(update={"setting": replace(found.setting, line=line, plant=plant)})


def test_the_page_of_the_panels_has_a_line_per_error_beside_nominal(tmp_path: Path) -> None:
    shared = PlantErrors(plants=2, hole_tilt_deg=1.0)
    found = results(
        on_panel("nominal", None, 20),
        on_panel("nominal", None, 19, 0.33),
        on_panel("hole tilted 1°", PlantErrors(hole_tilt_deg=1.0), 10),
        on_panel("everything", shared, 10),
    )
    path = panel.load("plant").path(tmp_path / "results", "vftm")
    path.parent.mkdir(parents=True)
    found.save(path)
    report(tmp_path / "results", tmp_path / "var", tmp_path / "docs", tmp_path / "models")
    page = (tmp_path / "docs" / "panels.md").read_text()
    assert "| plant | success, c = 1.33 mm | peak force, N | faults | success, c = 0.33 mm |" in page
    assert "| nominal | 100.0 % (83.9–100.0) | 10.1 / 10.2 / 10.2 | 0 | 95.0 % (76.4–99.1) |" in page
    assert "| hole tilted 1° | 50.0 % (29.9–70.1) | 10.1 / 10.2 / 10.2 | 0 | – | – | – |" in page
    assert "everything, c = 1.33 mm, plant by plant: 50.0 %, 50.0 %." in page


def test_without_results_on_panels_there_is_no_page_of_them(tmp_path: Path) -> None:
    report(tmp_path / "results", tmp_path / "var", tmp_path / "docs", tmp_path / "models")
    assert not (tmp_path / "docs" / "panels.md").exists()
