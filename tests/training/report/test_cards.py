"""Model cards: they say what the file and its own results say, and where neither says anything."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import typer

pytest.importorskip("onnx", reason="needs the extra `training`: pip install -e '.[training]'")
pytest.importorskip("matplotlib", reason="needs the extra `training`")

from service.policy.contract import EvaluationFigure, PolicyContract
from service.policy.model import Policy
from training.commands.report import report
from training.environment import design
from training.evaluation import baseline
from training.evaluation.evaluate import FIRST_TEST_SEED
from training.evaluation.results import Block, EpisodeResult, Results, ResultsError, Setting
from training.learning import experiment
from training.report import cards, paper
from training.report.cards import Card, Note
from training.report.measured import Measured
from wire.task import Conditions

EXPORTED: dict[str, Any] = {
    "steps": 1_500_000,
    "experiment": {
        "name": "narrow",
        "title": "One part | tight",
        "task": {
            "parts": ["tr"],
            "clearance_mm": [0.5, 2.0],
            "conditions": "standard",
            "randomise_plant": True,
            "reward": "potential",
            "force_ceiling_n": 30.0,
        },
        "algorithm": {"memory": "gru", "steps": 2_000_000, "cells": 192, "learning_rate": 5e-4},
        "start_from": "wide",
    },
    "seed": 3,
    "sessions": [
        {"steps": 0, "began": "2026-01-01T00:00:00Z", "commit": "abcdef0123456", "machine": "one", "versions": {}}
    ],
    "elapsed_s": 3600.0,
    "validation": [
        {"part": "tr", "clearance_m": 1.33e-3, "conditions": "standard", "episodes": 100, "successes": 90, "more": 1}
    ],
}


def card(contract: PolicyContract | None = None, *blocks: Block, name: str = "p", **changes: Any) -> Card:
    contract = contract or design.contract_for()
    results = results_of(contract, "0" * 64, *blocks) if blocks else None
    return replace(Card(name, 1234, "0" * 64, contract, results), **changes)


def results_of(contract: PolicyContract, sha256: str, *blocks: Block) -> Results:
    return Results(
        policy=contract.name,
        sources="0" * 64,
        deployed_sources="1" * 64,
        press_m=contract.dsl.press_m,
        seek_step_m=contract.dsl.seek_step_m,
        sha256=sha256,
        mode=contract.mode,
        lock=contract.dsl.mode,
        period_s=contract.period_s,
        max_steps=contract.max_steps,
        stiffness=contract.compliance.stiffness,
        provenance={},
        blocks=blocks,
    )


def block(successes: int, clearance_mm: float = 1.33, conditions: Conditions = "standard", **changes: Any) -> Block:
    setting = Setting(
        part="tr",
        clearance_m=paper.metres(clearance_mm),
        conditions=conditions,
        lock="paper",
        first_seed=FIRST_TEST_SEED,
    )
    episodes = tuple(
        EpisodeResult(FIRST_TEST_SEED + i, i < successes, fault=i >= 48, steps=40, peak_force_n=10.0 + i / 10)
        for i in range(50)
    )
    return Block(setting=replace(setting, **changes), episodes=episodes)


def told(*shown: Card) -> str:
    return cards.document(shown).to_markdown(Path("pictures"))


def line_with(text: str, *words: str) -> str:
    (line,) = [line for line in text.splitlines() if all(word in line for word in words)]
    return line


def limits_of(shown: Card) -> str:
    return told(shown).split("### Known limits")[1]


def test_the_table_has_every_model_with_success_by_its_own_results() -> None:
    text = told(card(None, block(40)), card(name="other"))
    assert line_with(text, "[p](#p)").endswith("| 1 | **80.0 %** (67.0–88.8), 40 of 50 | not measured |")
    assert line_with(text, "[other](#other)").endswith("| not measured | not measured |")
    assert text.index("\n## p\n") < text.index("\n## other\n")


def test_peaks_and_faults_stand_beside_the_conditions_they_were_measured_under() -> None:
    text = told(card(None, block(40, conditions="transfer", through="rtde", lock="sliding")))
    row = line_with(text, "| tr | 1.33 mm | `transfer` | sliding | service over RTDE | 30 N |")
    assert row.endswith("| **80.0 %** (67.0–88.8), 40 of 50 | 40 | 12.4 / 14.9 / 14.9 | 2 |")
    # Another plant under another lock is not the policy's success
    assert line_with(text, "[p](#p)").endswith("| not measured | not measured |")


def test_what_the_file_records_counts_where_results_are_missing_and_says_so() -> None:
    known = block(40).figure()
    hard = EvaluationFigure(clearance_m=0.33e-3, conditions="standard", episodes=10, successes=1, low=0.0, high=0.4)
    contract = design.contract_for().model_copy(update={"evaluation": (known, hard)})
    text = told(card(contract, block(40)))
    assert line_with(text, "[p](#p)").endswith("40 of 50 | **10.0 %** (0.0–40.0), 1 of 10, recorded in the file |")
    recorded = text.split("Recorded in the file")[1]
    assert "| 0.33 mm | `standard` | **10.0 %** (0.0–40.0), 1 of 10 | – / – |" in recorded
    assert "1.33 mm" not in recorded.split("###")[0]


def test_a_model_that_nobody_measured_says_so() -> None:
    text = told(card())
    assert "### What was measured\n\nNot measured.\n" in text
    assert "The results have nothing for tr; on the plant of `transfer`; through the deployed service" in text


def test_results_of_another_file_are_refused(tmp_path: Path) -> None:
    (tmp_path / "still.onnx").write_bytes(baseline.still())
    policy = Policy.load(tmp_path / "still.onnx")
    text = told(*cards.read(tmp_path, Measured({"still": results_of(policy.contract, policy.sha256, block(40))}, ())))
    assert "40 of 50" in text
    assert f"SHA-256 `{policy.sha256}`" in text
    foreign = Measured({"still": results_of(policy.contract, "f" * 64, block(40))}, ())
    with pytest.raises(ResultsError, match=r"still\.json are not of .*still\.onnx as it is now"):
        cards.read(tmp_path, foreign)


def test_what_export_wrote_is_told_in_words_and_where_admission_goes_beyond_it() -> None:
    contract = design.contract_for("VFTM", "paper", ("tr", "cir"), clearance_m=(0.1e-3, 2e-3), hidden_size=128)
    text = told(card(contract.model_copy(update={"provenance": EXPORTED})))
    line_with(text, "Experiment `narrow`", "(One part \\| tight)", "seed 3, begun with weights of `wide`")
    line_with(text, "after 1.50 of 2.00 million steps and 60 min", "Trained on tr at 0.5 to 2 mm")
    line_with(text, "tr at 1.33 mm, `standard`: 90.0 % of 100")
    line_with(text, "| 0 | 2026-01-01T00:00:00Z | `abcdef012` | one |")
    limits = limits_of(card(contract.model_copy(update={"provenance": EXPORTED})))
    assert "parts that it was not trained on (what it began with aside): cir." in limits
    assert "Admitted at 0.1 to 2 mm, trained at 0.5 to 2 mm" in limits


@pytest.mark.parametrize("name", experiment.names())
def test_every_experiment_is_told_in_words(name: str) -> None:
    trained = experiment.load(name)
    provenance = {**EXPORTED, "experiment": trained.model_dump(mode="json")}
    text = told(card(trained.contract().model_copy(update={"provenance": provenance})))
    line_with(text, f"Experiment `{name}`", f"Trained on {', '.join(trained.task.parts)} at ")


def test_admission_of_what_it_was_trained_on_is_no_limit() -> None:
    contract = design.contract_for(clearance_m=(0.5e-3, 2e-3)).model_copy(update={"provenance": EXPORTED})
    assert "Admitted" not in limits_of(card(contract))


def test_another_provenance_stands_as_it_is_and_none_is_said_to_be_none() -> None:
    provenance = {"by": "hand | eye", "recipe": {"rate": 3e-4, "last": True, "inner": {"seed": 1}}, "continues": None}
    text = told(card(design.contract_for().model_copy(update={"provenance": provenance})))
    for row in (
        "| `by` | hand \\| eye |",
        "| `recipe` | rate 0.0003, last true |",
        "| `recipe.inner` | seed 1 |",
        "| `continues` | none |",
    ):
        assert row in text.splitlines()
    assert "### How it was trained\n\nThe file does not say.\n" in told(card())


@pytest.mark.parametrize(
    ("mode", "lock", "needs"),
    [
        ("VFTM", "paper", "a force/torque sensor and a camera's estimate of the hole"),
        ("FTM", "paper", "a force/torque sensor"),
        ("VM", "off", "a camera's estimate of the hole"),
    ],
)
def test_a_card_says_what_the_cell_must_have(mode: Any, lock: Any, needs: str) -> None:
    text = told(card(design.contract_for(mode, lock)))
    assert f" mm in a cell with {needs}. **Not for**" in text
    assert ('`allow_lock = ["off"]`' in text) is (lock == "off")


def test_behaviour_and_law_are_those_of_the_contract() -> None:
    text = told(card(design.adjusted(design.contract_for(), press_m=3e-3)))
    assert "Every 0.1 s, at most 110 times (11 s)" in text
    assert "`dx` up to 4 mm in tool axes" in text
    assert "`dyaw` up to 10.0°; finer near zero in `dx`, `dy`, `dyaw`." in text
    assert "contact counts from 5 N. A command may go 3 mm below the lock." in text
    assert "| stiffness, N/m and N·m/rad | 2500 | 2500 | 3000 | 5 | 5 | 8 |" in text
    assert "It has no memory; it is given 190 numbers." in text
    observed = text.split("### What it observes and does")[1].split("###")[0]
    assert observed.count("\n| `") == len(design.contract_for().observation)


def test_use_and_weakness_come_from_the_notes_and_are_left_out_of_a_model_without() -> None:
    noted = told(card(note=Note(use="For a test.", weakness="It is small.")))
    assert "## p\n\nFor a test.\n" in noted
    assert "### Known limits\n\nIt is small. The results have nothing" in noted
    assert "## p\n\n**For** tr at" in told(card())
    assert cards.notes()["still"].weakness == "It does not search."


def test_the_command_writes_the_page_of_the_models_folder_and_none_without(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    models, out = tmp_path / "models", tmp_path / "docs"
    report(tmp_path / "results", tmp_path / "runs", out, models)
    assert not (out / cards.PAGE).exists()
    assert f"no policies in {models}" in capsys.readouterr().out
    models.mkdir()
    for name, data in (("still", baseline.still()), ("unheard-of", baseline.scripted_search("FTM"))):
        (models / f"{name}.onnx").write_bytes(data)
    report(tmp_path / "results", tmp_path / "runs", out, models)
    text = (out / cards.PAGE).read_text()
    line_with(text, "[still](#still)")
    assert "(`scripted-search-ftm` in its contract)" in text


def test_a_file_that_a_cell_would_refuse_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "broken.onnx").write_bytes(b"no model")
    with pytest.raises(typer.Exit):
        report(tmp_path / "results", tmp_path / "runs", tmp_path / "docs", tmp_path)
    assert "broken.onnx" in capsys.readouterr().err
    assert not (tmp_path / "docs").exists()
