"""Rows of the fault table that are about the order of events between processes, in universes of their own."""

import asyncio

import pytest

from service.messages import RunState
from tests.simulation.judge import ledger_runs
from tests.simulation.plan import Plan, drawn, reset_at_any_moment
from tests.simulation.plant import Surroundings
from tests.simulation.story import Story, tell


@pytest.mark.parametrize("seed", range(8))
def test_44_a_reset_at_any_moment_moves_nothing(seed: int) -> None:
    outcome = tell(seed, drawn(seed, reset_at_any_moment))
    assert not outcome.violations


class Ends:
    """Keeps how the runs of a universe ended."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.codes: list[tuple[str, str | None]] = []
        rest = Story.come_to_rest

        async def seen(story: Story) -> None:
            await asyncio.sleep(0.3)
            self.codes = [(run["state"], run["code"]) for run in ledger_runs(story.universe).values()]
            await rest(story)

        monkeypatch.setattr(Story, "come_to_rest", seen)


@pytest.fixture
def ends(monkeypatch: pytest.MonkeyPatch) -> Ends:
    return Ends(monkeypatch)


def run_with(kind: str, at_s: float, **details: object) -> Plan:
    plan = Plan(1, Surroundings())
    plan.add(0.1, "start", name="start-0")
    plan.add(at_s, kind, **details)
    return plan


@pytest.mark.parametrize("at_s", [0.9, 1.4, 2.0])
def test_17_a_link_that_carries_nothing_any_more_latches_stale(ends: Ends, at_s: float) -> None:
    outcome = tell(1, run_with("stall", at_s, link=("world", "control"), seconds=1.0))
    assert not outcome.violations
    assert ends.codes == [(RunState.LATCHED, "STALE")]


def test_19_a_simulator_that_is_killed_latches_the_run(ends: Ends) -> None:
    outcome = tell(1, run_with("kill", 1.2, part="world", again_s=0.3))
    assert not outcome.violations
    assert ends.codes == [(RunState.LATCHED, "STALE")]


def test_20_a_simulator_that_is_frozen_latches_the_run(ends: Ends) -> None:
    outcome = tell(1, run_with("freeze", 1.2, part="world", seconds=0.5))
    assert not outcome.violations
    assert ends.codes == [(RunState.LATCHED, "STALE")]


@pytest.mark.parametrize("kind", ["kill", "power cut"])
def test_53_a_control_process_that_dies_in_a_run_leaves_it_interrupted(ends: Ends, kind: str) -> None:
    outcome = tell(1, run_with(kind, 1.2, part="control", again_s=0.2))
    assert not outcome.violations
    assert ends.codes == [(RunState.INTERRUPTED, "INTERRUPTED")]
