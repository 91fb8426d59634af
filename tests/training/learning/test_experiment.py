"""Experiments as data: those that come with the project, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from training.environment import design
from training.learning.experiment import Experiment, ExperimentError, load, names

MINIMAL = """
title = "Minimal"
[task]
clearance_mm = [1.0, 2.0]
[algorithm]
steps = 1000
[evaluation]
every_steps = 500
clearances_mm = [1.33]
"""


def written(folder: Path, text: str) -> Experiment:
    path = folder / "mine.toml"
    path.write_text(text)
    return load(str(path))


@pytest.mark.parametrize("name", names())
def test_every_experiment_of_the_project_can_be_read_and_starts_from_one_that_fits(name: str) -> None:
    experiment = load(name)
    contract = experiment.contract()
    assert contract.name == experiment.name == name
    task = experiment.task
    assert (contract.mode, contract.dsl.mode) == (task.mode, task.lock)
    assert set(task.parts) <= set(contract.parts)
    assert (contract.hidden_size > 0) == (experiment.algorithm.memory == "gru")
    if experiment.start_from is not None:
        earlier = load(experiment.start_from)
        assert set(experiment.seeds) <= set(earlier.seeds)
        assert earlier.contract().observation == contract.observation


def test_what_table_one_compares_is_there_at_both_readings_of_both_gaps_and_trained_like_the_papers() -> None:
    for policy, mode, lock in (
        ("vftm", "VFTM", "paper"),
        ("sliding", "VFTM", "sliding"),
        ("ftm", "FTM", "paper"),
        ("vm", "VM", "off"),
    ):
        for clearance in (4.0, 1.33, 1.0, 0.33):
            experiment = load(f"paper-{policy}-c{round(clearance * 100):03d}")
            task = experiment.task
            assert (task.mode, task.lock, task.clearance_mm) == (mode, lock, (clearance, clearance))
            steps = 2_000_000 if clearance in (1.33, 0.33) else 1_000_000
            assert (task.reward, task.max_steps, experiment.algorithm.steps) == ("paper", 110, steps)
            assert experiment.evaluation.clearances_mm == (clearance,)
            assert experiment.evaluation.every_steps % 10_000 == 0


def test_a_file_of_ones_own_is_named_by_its_path_and_says_only_what_differs(tmp_path: Path) -> None:
    experiment = written(tmp_path, MINIMAL)
    assert experiment.name == "mine"
    assert experiment.contract() == design.contract_for(
        "VFTM", "paper", "tr", name="mine", clearance_m=(1e-3, 2e-3), hidden_size=experiment.algorithm.hidden
    )


def test_a_policy_with_a_memory_sees_one_frame_and_one_without_several(tmp_path: Path) -> None:
    remembering = written(tmp_path, MINIMAL).contract()
    none = written(tmp_path, MINIMAL.replace("[algorithm]", '[algorithm]\nmemory = "none"')).contract()
    assert {entry.history for entry in remembering.observation} == {1}
    assert max(entry.history for entry in none.observation) > 4
    assert (remembering.hidden_size, none.hidden_size) == (128, 0)


def test_a_policy_may_be_admitted_for_more_than_it_is_trained_on(tmp_path: Path) -> None:
    trained = written(tmp_path, MINIMAL)
    assert (trained.contract().parts, trained.contract().clearance_m) == (("tr",), (1e-3, 2e-3))
    wider = written(tmp_path, MINIMAL + '[admitted]\nparts = ["tr", "cir"]\nclearance_mm = [0.5, 4.0]\n')
    assert (wider.contract().parts, wider.contract().clearance_m) == (("tr", "cir"), (0.5e-3, 4e-3))
    assert wider.task == trained.task


def test_what_the_policy_does_may_differ_from_the_usual(tmp_path: Path) -> None:
    usual = written(tmp_path, MINIMAL).contract()
    text = MINIMAL + "[policy]\npress_mm = 3.0\ndz_mm = 3.5\ndyaw_deg = 5.0\nwrench_window_ticks = 50\n"
    contract = written(tmp_path, text).contract()
    limits = {entry.name: entry.limit for entry in contract.action}
    assert limits["dx"] == limits["dy"] == usual.action[0].limit
    assert limits["dz"] == pytest.approx(3.5e-3)
    assert limits["dyaw"] == pytest.approx(np.deg2rad(5.0))
    assert (contract.dsl.press_m, contract.wrench_window_ticks) == (pytest.approx(3e-3), 50)
    assert contract.observation == usual.observation


def test_a_law_of_its_own_goes_into_the_contract(tmp_path: Path) -> None:
    law = "[law]\nstiffness = [1, 2, 3, 4, 5, 6]\ndamping = [400, 400, 400, 1, 1, 1]\n"
    law += "inertia = [2, 2, 2, 0.1, 0.1, 0.1]\n"
    assert written(tmp_path, MINIMAL + law).contract().compliance.stiffness == (1, 2, 3, 4, 5, 6)


def test_68_a_law_that_swings_is_refused_before_it_is_trained_with(tmp_path: Path) -> None:
    law = "[law]\nstiffness = [2500, 2500, 3000, 5, 5, 8]\ndamping = [380, 380, 60, 1, 1, 0.5]\n"
    law += "inertia = [2.5, 2.5, 0.5, 0.06, 0.06, 0.03]\n"
    with pytest.raises(ExperimentError, match=r"law: compliance z swings on a contact .* damping ratio -0\.39"):
        written(tmp_path, MINIMAL + law)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("[1.0, 2.0]", "[2.0, 1.0]", r"task: .*clearance_mm runs from 2.0 down to 1.0"),
        ("[1.0, 2.0]", "[0.0, 1.0]", r"task\.clearance_mm\.0: .*greater than 0"),
        ("[1.0, 2.0]", "[1.0, 20.0]", r"clearance_m must lie in"),
        ("[1.33]", "[]", r"evaluation\.clearances_mm: "),
        ("[1.33]", "[33.0]", r"clearance_m must lie in"),
        ("steps = 1000", "", r"algorithm\.steps: .*required"),
        ("steps = 1000", "steps = 1000\nbatch = 3", r"algorithm\.batch: Extra inputs"),
        ("steps = 1000", "steps = 1000\ncells = 5", r"5 cells do not divide evenly over 2 workers"),
        ("steps = 1000", "steps = 1000\ncells = 2\nminibatches = 3", r"3 minibatches are more than 2 cells"),
        ("[task]", '[task]\nparts = ["tr", "rtr", "cir"]', r"algorithm\.workers is 2, .* over 3 parts"),
        ("[task]", '[task]\nparts = ["tr", "tr"]', r"parts names one more than once"),
        ("[task]", "[task]\nforce_ceiling_n = 60.0", r"force_ceiling_n: .*less than or equal to 50"),
        ("[task]", '[task]\nmode = "VM"', r"VM bypasses the lock"),
        ("[task]", '[task]\nmode = "FTM"', r"too far from the nominal centre"),
        ("[task]", '[task]\nreward = "praise"', r"task\.reward: "),
        ("[task]", '[task]\nconditions = "transfer"', r"randomise_plant must be false"),
        ("[task]", "[policy]\nwrench_window_ticks = 51\n[task]", r"wrench_window_ticks is 51, a step has 50 ticks"),
        ("[task]", "[tusk]", r"tusk: Extra inputs.*|task: Field required"),
        ('"Minimal"', '"Minimal', r"cannot read"),
    ],
)
def test_what_cannot_be_trained_is_refused_by_the_name_of_its_field(
    old: str, new: str, text: str, tmp_path: Path
) -> None:
    assert old in MINIMAL
    with pytest.raises(ExperimentError, match=text):
        written(tmp_path, MINIMAL.replace(old, new, 1))


def test_an_unknown_name_is_answered_with_those_there_are() -> None:
    with pytest.raises(ExperimentError, match=r"no experiment 'vftm'; there are .*vftm-dsl"):
        load("vftm")
