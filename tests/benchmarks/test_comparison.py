"""Two commits are compared turn by turn; an interval holds what the host's load does not explain."""

import numpy as np
import pytest

from benchmarks import comparison
from benchmarks.comparison import CommitError, change, compare


def test_a_load_that_changes_from_turn_to_turn_is_no_change() -> None:
    loads = np.array([1.0, 3.0, 1.5, 4.0, 1.0, 2.0])
    rng = np.random.default_rng(1)
    before, after = loads * rng.normal(1.0, 0.02, 6), loads * rng.normal(1.0, 0.02, 6)
    found = change("a step", "µs", before.tolist(), after.tolist())
    assert not found.is_clear
    assert found.ratio == pytest.approx(1.0, abs=0.05)


def test_a_fifth_less_is_clear_and_its_interval_holds_it() -> None:
    rng = np.random.default_rng(2)
    before = 100.0 * rng.normal(1.0, 0.03, 8)
    found = change("a step", "µs", before.tolist(), (0.8 * 100.0 * rng.normal(1.0, 0.03, 8)).tolist())
    assert found.is_clear
    assert found.interval[0] <= 0.8 <= found.interval[1]
    assert found.ratio < 1.0, "after to before"


def test_a_commit_is_measured_from_its_own_files_with_these_benchmarks(tmp_path) -> None:
    tree = comparison._check_out("HEAD", tmp_path / "tree")
    assert (tree / "service/cell/cell.py").is_file()
    here = comparison.ROOT / "benchmarks/comparison.py"
    assert (tree / "benchmarks/comparison.py").read_bytes() == here.read_bytes()


def test_one_commit_twice_gives_all_figures_of_the_benchmark() -> None:
    told: list[str] = []
    changes = compare(("HEAD", "HEAD"), ["round_trip"], 2, told.append)
    assert [one.name for one in changes] == ["lockstep tick to bare query"]
    assert changes[0].before > 1.0
    assert len(told) == 4


def test_an_unknown_commit_is_named() -> None:
    with pytest.raises(CommitError, match="no-such-commit"):
        compare(("no-such-commit", "HEAD"), ["tick"], 2, print)
