"""A state machine over the API's operations and the faults, with the invariants of the seeds: Hypothesis chooses."""

import random
import tempfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from tests.simulation.judge import Judge
from tests.simulation.plan import LINKS, Happening, Plan
from tests.simulation.plant import LightCell, Surroundings
from tests.simulation.story import READY_S, Story, configuration, force_bound_n, policy
from tests.simulation.universe import Universe

PARTS = st.sampled_from(("world", "control", "api"))
DIRECTED = st.sampled_from([*LINKS, *((b, a) for a, b in LINKS)])
SECONDS = st.sampled_from((0.02, 0.1, 0.4, 1.0))


class Installation(RuleBasedStateMachine):
    """One installation: people ask for things, parts fail, time passes, and the judge looks at every tick."""

    def __init__(self) -> None:
        super().__init__()
        self._folder = tempfile.TemporaryDirectory()
        plan = Plan(0, Surroundings())
        state_dir = Path(self._folder.name) / "state"
        state_dir.mkdir()
        plant = LightCell(1, plan.surroundings, random.Random(0))
        self.universe = Universe(0, configuration(state_dir, policy("straight")), plant)
        self.judge = Judge(self.universe, force_bound_n(plan, self.universe))
        self.universe.judge = self.judge.on_tick
        self.story = Story(self.universe, self.judge, plan)
        self._alive = self.universe.alive()
        self._alive.__enter__()
        self._requests = 0
        self._wait(READY_S)

    # --- what people do

    @rule(key=st.sampled_from((None, "key-1", "key-2")))
    def start(self, key: str | None) -> None:
        self._let("start", name=self._name("start"), **({} if key is None else {"key": key}))

    @rule()
    def stop(self) -> None:
        self._let("stop", name=self._name("stop"))

    @rule()
    def reset(self) -> None:
        self._let("reset", name=self._name("reset"))

    @rule(kind=st.sampled_from(("status", "runs", "health")))
    def look(self, kind: str) -> None:
        self._let(kind)

    @rule(seconds=st.sampled_from((0.001, 0.004, 0.02, 0.1, 0.5, 1.5)))
    def time_passes(self, seconds: float) -> None:
        self._wait(seconds)

    # --- what goes wrong

    @rule(kind=st.sampled_from(("freeze", "block")), part=PARTS, seconds=SECONDS)
    def hold(self, kind: str, part: str, seconds: float) -> None:
        self._let(kind, part=part, seconds=seconds)

    @precondition(lambda self: all(process.alive for process in self.universe.processes.values()))
    @rule(kind=st.sampled_from(("kill", "terminate", "power cut")), part=PARTS, seconds=SECONDS)
    def crash(self, kind: str, part: str, seconds: float) -> None:
        self._let(kind, part=part, again_s=seconds)
        self._wait(seconds + 1.2)

    @rule(kind=st.sampled_from(("stall", "cut")), link=DIRECTED, seconds=SECONDS)
    def break_link(self, kind: str, link: tuple[str, str], seconds: float) -> None:
        self._let(kind, link=link, seconds=seconds)

    @rule(kind=st.sampled_from(("disk hangs", "disk full", "disk slow", "database busy")), seconds=SECONDS)
    def spoil_storage(self, kind: str, seconds: float) -> None:
        self._let(kind, seconds=seconds)

    @rule(kind=st.sampled_from(("policy hangs", "policy loads", "log full", "log unread")), seconds=SECONDS)
    def hold_foreign_work(self, kind: str, seconds: float) -> None:
        self._let(kind, seconds=seconds)

    @rule(key=st.sampled_from(("**", "cell/**", "cell/*/command/*")))
    def read_everything(self, key: str) -> None:
        self._let("read", key=key)

    @rule()
    def drive_as_a_stranger(self) -> None:
        self._let("drive")

    @rule(kind=st.sampled_from(("empty", "copy")), command=st.sampled_from(("start", "stop", "reset")))
    def command_as_a_stranger(self, kind: str, command: str) -> None:
        self._let(kind, command=command)

    @rule(seconds=st.sampled_from((-86400.0, 86400.0)))
    def set_clock(self, seconds: float) -> None:
        self._let("clock set", seconds=seconds)

    @invariant()
    def nothing_is_violated(self) -> None:
        assert not self.judge.violations, "\n".join(f"{at_s} {text}" for at_s, text in self.universe.trace)

    def teardown(self) -> None:
        try:
            self.universe.live(self.story.come_to_rest())
            self.nothing_is_violated()
        finally:
            self._alive.__exit__(None, None, None)
            self._folder.cleanup()

    # --- small parts

    def _name(self, kind: str) -> str:
        self._requests += 1
        return f"{kind}-{self._requests}"

    def _let(self, kind: str, **details: object) -> None:
        async def happen() -> None:
            self.universe.note(f"{kind} {details}")
            self.story.happen(Happening(0.0, kind, details))

        self.universe.live(happen())

    def _wait(self, seconds: float) -> None:
        self.universe.live(self.story.wait(seconds))


COMMON = {"deadline": None, "print_blob": True, "suppress_health_check": list(HealthCheck)}
Installation.TestCase.settings = settings(max_examples=15, stateful_step_count=12, **COMMON)  # type: ignore[arg-type]
test_whatever_people_do_and_whatever_fails = pytest.mark.timeout(300)(Installation.TestCase)


@pytest.mark.nightly
@pytest.mark.timeout(7200)
class TestAtLength(Installation.TestCase):  # type: ignore[name-defined,misc]
    settings = settings(max_examples=1000, stateful_step_count=25, **COMMON)  # type: ignore[arg-type]
