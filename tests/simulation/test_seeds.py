"""Seeded universes: the real code, from the HTTP request to the arm's tip, under faults between every pair of parts."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import pytest

from tests.simulation.seeds import live_through
from tests.simulation.story import tell

SEEDS_IN_CI = 500


@pytest.mark.timeout(900)
def test_no_seed_violates_an_invariant() -> None:
    report = live_through(range(SEEDS_IN_CI))
    assert report.count == SEEDS_IN_CI
    assert not report.failed, report.text(0.0)


@pytest.mark.parametrize("seed", [3, 101])
def test_a_seed_is_replayed_exactly_in_another_process(seed: int) -> None:
    here = tell(seed)
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        there = pool.submit(tell, seed).result()
    assert there.trace == here.trace
