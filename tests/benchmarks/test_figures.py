"""A figure stands beside its limit, and a policy step beside the sample that it belongs to."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.cases.deployed_step import refereed
from benchmarks.harness.report import save
from benchmarks.harness.result import Figure, Result, quantile_figures
from benchmarks.harness.stopwatch import Stopwatch
from benchmarks.stands.watched_service import policy_steps


def watch(*calls: tuple[float, float]) -> Stopwatch:
    taken = Stopwatch()
    taken.calls = list(calls)
    return taken


def test_a_figure_beyond_its_limit_is_shown_as_such(tmp_path: Path) -> None:
    figures = Figure("slow", 3.0, "ms", 2.0), Figure("fast", 3.0, "steps/s", 2.0, at_least=True)
    document, _ = save(tmp_path, {}, {"one": Result("how?", ("a",), (("b",),), figures=figures)})
    text = document.read_text()
    assert "| slow | 3 ms | at most 2 | NO |" in text
    assert "| fast | 3 steps/s | at least 2 | yes |" in text


def test_quantiles_become_figures_in_their_unit() -> None:
    found = quantile_figures("span", np.linspace(0.0, 1e-3, 1001).tolist(), {"p50": 400.0, "p99.9": 1000.0})
    assert [(one.name, round(one.value), one.holds) for one in found] == [
        ("span, p50", 500, False),
        ("span, p99.9", 999, True),
    ]


def test_a_policy_step_goes_from_its_own_sample_to_the_command_in_its_answer() -> None:
    rows = policy_steps(
        [(0.1, 9.9), (0.2, 19.9), (0.3, 29.9), (0.4, 39.9), (0.5, 49.9)],
        judged=watch((10.0, 11.0), (20.0, 22.0), (30.0, 31.0), (40.0, 41.0), (50.0, 51.0)),
        asked=watch((21.0, 21.5), (30.5, 30.6), (40.5, 40.6), (50.5, 50.6)),
        answered=watch((24.0, 25.0), (32.0, 33.0), (52.0, 53.0)),
        sent=watch((10.1, 10.2), (24.1, 24.6), (52.1, 52.5)),
    )
    first, last = [0.2, 19.9, 24.6, pytest.approx(3.0)], [0.5, 49.9, 52.5, pytest.approx(2.0)]
    assert rows.tolist() == [first, last], "the second answer led to no command, the third never came"


def test_arrivals_are_those_that_the_referee_saw(tmp_path: Path) -> None:
    np.save(tmp_path / "arrivals.npy", np.array([(0.100, 5.0), (0.102, 5.002), (0.106, 5.006)]))
    steps = np.array([(0.102, np.nan, 5.0025, 1e-4), (0.104, np.nan, 5.1, 1e-4)])
    np.savez(tmp_path / "watched.npz", steps=steps, judged=np.array([(0.106, 5.0061)]))
    taken = refereed(tmp_path / "watched.npz", tmp_path / "arrivals.npy")
    assert taken.command == pytest.approx([5e-4]), "nothing is made of a package that the referee missed"
    assert taken.held == [1e-4]
    assert taken.judged == pytest.approx([1e-4])
