"""Events of a universe: people's requests and the faults, all drawn from its seed."""

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from tests.simulation.lies import LIES
from tests.simulation.plant import Surroundings

PARTS = ("world", "control", "api", "operator")
LINKS = (("operator", "api"), ("api", "control"), ("control", "world"))
SPELLINGS: tuple[dict[str, str], ...] = (
    {}, {}, {}, {"path": "/stop/"}, {"path": "/cell/Stop"}, {"host": "cell.example:8000"}
)  # fmt: skip
"""Ways in which people and proxies write a stop."""
LENGTH_S = 3.2
"""Time in which requests and faults happen."""


@dataclass(frozen=True)
class Happening:
    """Something that happens at a moment: a request of a person, or a fault."""

    at_s: float
    kind: str
    details: dict[str, Any]

    def __str__(self) -> str:
        details = ", ".join(f"{key}={value}" for key, value in self.details.items())
        return f"{self.at_s:.4f} {self.kind} {details}"


@dataclass
class Plan:
    """One universe's story.

    Attributes:
        policy: name of the policy that runs.
        lie: name of what is wrong with the sensor, from `lie_s` on.
        autostart: the API starts the control process.
        patience_s: time that a run has to end by itself, before it is stopped for the end of the story.
    """

    seed: int
    surroundings: Surroundings
    policy: str = "straight"
    lie: str = "honest"
    lie_s: float = 0.0
    happenings: list[Happening] = field(default_factory=list)
    patience_s: float = 0.0
    autostart: bool = False

    def add(self, at_s: float, kind: str, **details: Any) -> None:
        self.happenings.append(Happening(max(0.0, at_s), kind, details))


Story = Callable[[Plan, random.Random], None]


def drawn(seed: int, story: Story | None = None) -> Plan:
    """Draw a universe; `story` names its kind, where chance does not choose it."""
    chance = random.Random(seed)
    plan = Plan(seed, Surroundings())
    s = plan.surroundings
    s.stiffness = chance.choice((2e4, 3e4, 5e4))
    s.delay_ticks = chance.randint(1, 4)
    s.hole = (
        0.3 + chance.uniform(-0.02, 0.02),
        -0.11 + chance.uniform(-0.02, 0.02),
        0.08 + chance.uniform(-0.005, 0.005),
    )
    s.camera_m = tuple(chance.gauss(0.0, 4e-4) for _ in range(3))  # type: ignore[assignment]
    (story or chance.choice(STORIES))(plan, chance)
    plan.happenings.sort(key=lambda one: one.at_s)
    return plan


# --- what people do


def _run(plan: Plan, chance: random.Random, at_s: float | None = None) -> float:
    """Let somebody start a run; return when."""
    at_s = chance.uniform(0.05, 0.5) if at_s is None else at_s
    details: dict[str, Any] = {"name": f"start-{len(plan.happenings)}"}
    if chance.random() < 0.3:
        details["key"] = f"key-{chance.randint(1, 2)}"
    plan.add(at_s, "start", **details)
    return at_s


def _stop(plan: Plan, at_s: float, **spelling: str) -> None:
    plan.add(at_s, "stop", name=f"stop-{len(plan.happenings)}", **spelling)


def _reset(plan: Plan, at_s: float) -> None:
    plan.add(at_s, "reset", name=f"reset-{len(plan.happenings)}")


def _look(plan: Plan, chance: random.Random) -> None:
    for _ in range(chance.randint(0, 3)):
        plan.add(chance.uniform(0.0, LENGTH_S), chance.choice(("status", "runs", "health")))


def _afterwards(plan: Plan, chance: random.Random, at_s: float) -> None:
    """Reset and start once more, perhaps."""
    if chance.random() < 0.6:
        _reset(plan, at_s + chance.uniform(0.2, 0.6))
    if chance.random() < 0.5:
        _run(plan, chance, at_s + chance.uniform(0.3, 0.9))


# --- what goes wrong


def _any_fault(plan: Plan, chance: random.Random, at_s: float) -> None:
    chance.choice((_freeze, _network, _disk, _database, _crash, _clock))(plan, chance, at_s)


def _freeze(plan: Plan, chance: random.Random, at_s: float) -> None:
    kind = chance.choice(("freeze", "block"))
    plan.add(at_s, kind, part=chance.choice(PARTS[:3]), seconds=chance.choice((0.02, 0.1, 0.3, 0.8)))


def _network(plan: Plan, chance: random.Random, at_s: float) -> None:
    one, other = chance.choice(LINKS)
    if chance.random() < 0.5:
        one, other = other, one
    kind = chance.choice(("slow", "stall", "cut", "drop", "repeat", "reorder"))
    if kind in ("stall", "cut"):
        plan.add(at_s, kind, link=(one, other), seconds=chance.choice((0.05, 0.2, 0.6)))
        return
    strength = {
        "slow": (1e-3, chance.choice((0.01, 0.05))),
        "drop": chance.choice((0.05, 0.3)),
        "repeat": 0.3,
        "reorder": 1,
    }
    plan.add(at_s, kind, link=(one, other), strength=strength[kind], seconds=chance.uniform(0.2, 2.0))


def _disk(plan: Plan, chance: random.Random, at_s: float) -> None:
    kind = chance.choice(("disk hangs", "disk full", "disk slow", "ledger moved", "state deleted"))
    plan.add(at_s, kind, seconds=chance.choice((0.05, 0.3, 1.5)))


def _database(plan: Plan, chance: random.Random, at_s: float) -> None:
    plan.add(at_s, "database busy", seconds=chance.choice((0.05, 0.3, 1.0)))


def _crash(plan: Plan, chance: random.Random, at_s: float) -> None:
    kind = chance.choice(("kill", "kill", "power cut", "terminate"))
    part = chance.choice(PARTS[:3])
    plan.add(at_s, kind, part=part, again_s=chance.uniform(0.05, 0.6))


def _clock(plan: Plan, chance: random.Random, at_s: float) -> None:
    plan.add(at_s, "clock set", seconds=chance.choice((-86400.0, 86400.0, -3600.0, -5.0)))


# --- stories


def plain(plan: Plan, chance: random.Random) -> None:
    """A run to its end, with one fault or none, and people who look on."""
    start_s = _run(plan, chance)
    _look(plan, chance)
    if chance.random() < 0.5:
        _any_fault(plan, chance, start_s + chance.uniform(0.0, 2.0))


def stop_beside_start(plan: Plan, chance: random.Random) -> None:
    """A stop within some milliseconds of a start, while something is slow."""
    start_s = _run(plan, chance)
    if chance.random() < 0.7:
        chance.choice((_database, _freeze, _network, _disk))(plan, chance, start_s - chance.uniform(0.0, 0.05))
    _stop(plan, start_s + chance.uniform(-0.002, 0.012))
    if chance.random() < 0.3:
        _stop(plan, start_s + chance.uniform(0.0, 0.3))
    _afterwards(plan, chance, start_s)


def stop_in_run(plan: Plan, chance: random.Random) -> None:
    """A stop at any moment of a run, perhaps under a fault; then a reset."""
    start_s = _run(plan, chance)
    stop_s = start_s + chance.uniform(0.0, 2.2)
    if chance.random() < 0.6:
        _any_fault(plan, chance, stop_s - chance.uniform(-0.05, 0.2))
    _stop(plan, stop_s, **chance.choice(SPELLINGS))
    _afterwards(plan, chance, stop_s)


def many_starts(plan: Plan, chance: random.Random) -> None:
    """Several people start at once; some starts share a key."""
    start_s = _run(plan, chance)
    for _ in range(chance.randint(2, 6)):
        _run(plan, chance, start_s + abs(chance.gauss(0.0, 0.1)))
    if chance.random() < 0.5:
        chance.choice((_disk, _database))(plan, chance, start_s - chance.uniform(0.0, 0.05))
    if chance.random() < 0.5:
        _stop(plan, start_s + chance.uniform(0.0, 1.0))
    _look(plan, chance)


def two_faults(plan: Plan, chance: random.Random) -> None:
    """A run and two faults at any time."""
    start_s = _run(plan, chance)
    for _ in range(2):
        _any_fault(plan, chance, start_s + chance.uniform(-0.1, 2.0))
    if chance.random() < 0.5:
        _stop(plan, start_s + chance.uniform(0.0, 2.2))
    _afterwards(plan, chance, start_s + chance.uniform(0.5, 2.0))


def lying_sensor(plan: Plan, chance: random.Random) -> None:
    """A sensor that lies, from the start or from some moment of the run on."""
    plan.patience_s = 2.0
    start_s = _run(plan, chance)
    plan.lie = chance.choice(tuple(LIES))
    if chance.random() < 0.7:  # it presses on the block beside the hole
        plan.surroundings.camera_m = (chance.choice((-1, 1)) * chance.uniform(4e-3, 8e-3), 0.0, 0.0)
    plan.lie_s = 0.0 if chance.random() < 0.5 else start_s + chance.uniform(0.3, 1.8)


def wrong_camera(plan: Plan, chance: random.Random) -> None:
    """A camera that is wrong by up to 20 mm, a hole that is not there, or a policy that pushes sideways."""
    plan.patience_s = 5.0
    _run(plan, chance, 0.05)
    s = plan.surroundings
    match chance.randrange(3):
        case 0:
            error = [0.0, 0.0, 0.0]
            error[chance.choice((0, 1, 2, 2))] = chance.choice((-1, 1)) * chance.uniform(4e-3, 20e-3)
            s.camera_m = tuple(error)  # type: ignore[assignment]
        case 1:
            s.half_m = -1.0
        case _:
            plan.policy, s.block_m = "sideways", 0.01


def idle(plan: Plan, chance: random.Random) -> None:
    """Nobody starts anything, and things go wrong all the same."""
    for _ in range(chance.randint(1, 3)):
        _any_fault(plan, chance, chance.uniform(0.1, 2.0))
    _stop(plan, chance.uniform(0.1, 2.0))
    _look(plan, chance)


def moved_files(plan: Plan, chance: random.Random) -> None:
    """Somebody moves the ledger or deletes the state, before, in or after a run."""
    start_s = _run(plan, chance)
    kind = chance.choice(("ledger moved", "state deleted"))
    plan.add(start_s + chance.uniform(-0.1, 2.5), kind)
    if chance.random() < 0.5:
        plan.add(start_s + chance.uniform(0.5, 2.5), "kill", part="control", again_s=0.1)
    _afterwards(plan, chance, start_s + 1.0)


def clock_set(plan: Plan, chance: random.Random) -> None:
    """Two runs, and between them somebody sets the clock."""
    start_s = _run(plan, chance)
    _stop(plan, start_s + 0.5)
    _clock(plan, chance, start_s + 0.8)
    _reset(plan, start_s + 1.2)
    _run(plan, chance, start_s + 1.6)


def killed_while_latched(plan: Plan, chance: random.Random) -> None:
    """A stop latches, and then the control process or the whole host dies."""
    start_s = _run(plan, chance)
    stop_s = start_s + chance.uniform(0.3, 1.5)
    _stop(plan, stop_s)
    kind = chance.choice(("kill", "power cut"))
    plan.add(stop_s + chance.uniform(0.2, 1.0), kind, part="control", again_s=0.1)
    _look(plan, chance)


def reset_at_any_moment(plan: Plan, chance: random.Random) -> None:
    """A stop latches; resets come at any moment, among faults, and starts beside them."""
    start_s = _run(plan, chance)
    stop_s = start_s + chance.uniform(0.1, 1.5)
    _stop(plan, stop_s)
    for _ in range(chance.randint(2, 5)):
        _reset(plan, stop_s + chance.uniform(-0.05, 0.5))
    if chance.random() < 0.5:
        _any_fault(plan, chance, stop_s + chance.uniform(-0.1, 0.4))
    if chance.random() < 0.5:
        _run(plan, chance, stop_s + chance.uniform(0.0, 0.5))


def waiting_for_disk(plan: Plan, chance: random.Random) -> None:
    """A start whose record waits for the disk; meanwhile people repeat it, look on and stop."""
    start_s, hang_s = chance.uniform(0.05, 0.3), chance.choice((0.3, 1.0, 9.0, 12.0))
    kind = chance.choice(("disk hangs", "disk hangs", "disk full", "disk slow"))
    plan.add(start_s - 0.01, kind, seconds=hang_s if kind == "disk hangs" else 1.0)
    key = {"key": "key-1"} if chance.random() < 0.6 else {}
    for number in range(chance.randint(1, 4)):
        at_s = start_s + number * chance.uniform(0.0, 0.1)
        plan.add(at_s, "start", name=f"start-{number}", patience_s=hang_s + 3.0, **key)
    if chance.random() < 0.6:
        _stop(plan, start_s + chance.uniform(0.005, min(hang_s, 1.5)))
    plan.add(start_s + chance.uniform(0.02, 1.0), "runs")
    if kind == "disk hangs" and hang_s > 3.0:
        plan.add(start_s + hang_s + 1.0, "runs")
    _afterwards(plan, chance, start_s + hang_s)


def hanging_policy(plan: Plan, chance: random.Random) -> None:
    """A policy that gives no answer, or whose process does not load; people stop, start anew, or end the cell."""
    start_s = _run(plan, chance)
    if chance.random() < 0.3:  # from the control process's start on
        plan.add(start_s + 0.1, "policy loads", seconds=chance.choice((1.0, 30.0)))
        plan.add(start_s + 0.2, "kill", part="control", again_s=0.1)
        start_s += 1.0
    else:
        plan.add(start_s + chance.uniform(1.6, 2.2), "policy hangs", seconds=chance.choice((0.05, 0.2, 0.6)))
        start_s += 2.6
        plan.add(start_s - 0.1, "policy loads", seconds=chance.choice((0.0, 1.0, 30.0)))
    _reset(plan, start_s)
    _run(plan, chance, start_s + 0.2)
    if chance.random() < 0.3:
        _stop(plan, start_s + chance.uniform(0.2, 0.9))
    if chance.random() < 0.5:
        plan.add(start_s + chance.uniform(0.3, 0.6), "terminate", part="control", again_s=0.1)
        plan.add(start_s + 4.0, "status")


def lost_logs(plan: Plan, chance: random.Random) -> None:
    """A log that nobody reads, or whose disk is full, while there is something to log."""
    start_s = _run(plan, chance)
    kind = chance.choice(("log full", "log unread"))
    plan.add(start_s - chance.uniform(-1.0, 0.2), kind, seconds=chance.choice((0.5, 2.0, 6.0)))
    stop_s = start_s + chance.uniform(0.0, 2.0)
    if chance.random() < 0.5:
        _any_fault(plan, chance, stop_s - chance.uniform(0.0, 0.3))
    _stop(plan, stop_s)
    _afterwards(plan, chance, stop_s)


def strangers(plan: Plan, chance: random.Random) -> None:
    """Somebody reads by wildcards, sends empty commands and repeats what others sent, beside two runs and a stop."""
    start_s = _run(plan, chance)
    if chance.random() < 0.2:  # after a run that nobody stopped
        plan.add(start_s + chance.uniform(6.0, 6.5), "copy", command="start")
        return
    stop_s = start_s + chance.uniform(0.3, 1.0)
    if chance.random() < 0.7:
        _stop(plan, stop_s)
    again_s = stop_s + chance.uniform(0.4, 0.9)
    _reset(plan, again_s)
    _run(plan, chance, again_s + 0.05)
    if chance.random() < 0.3:
        _stop(plan, again_s + chance.uniform(0.2, 0.8))
    for _ in range(chance.randint(2, 5)):
        at_s = start_s + chance.uniform(0.1, 2.8)
        match chance.choice(("read", "empty", "copy", "copy", "drive")):
            case "read":
                plan.add(at_s, "read", key=chance.choice(("**", "cell/**", "cell/*/command/*", "cell/*/query/*")))
            case "drive":
                plan.add(at_s, "drive")
            case kind:
                plan.add(at_s, kind, command=chance.choice(("start", "stop", "reset")))


def told_to_end(plan: Plan, chance: random.Random) -> None:
    """An API that starts its control process gets SIGTERM at any moment of its start, perhaps after a freeze."""
    plan.autostart = True
    at_s = chance.uniform(0.0, 1.2)
    if chance.random() < 0.3:  # from its very beginning
        plan.add(at_s, "kill", part="api", again_s=0.1)
        at_s += 0.1 + chance.uniform(0.0, 0.03)
    if chance.random() < 0.6:
        kind = chance.choice(("freeze", "block", "database busy"))
        held = {} if kind == "database busy" else {"part": "api"}
        plan.add(at_s - chance.uniform(0.0, 0.2), kind, seconds=chance.choice((0.1, 0.3)), **held)
    plan.add(at_s, "terminate", part="api", again_s=3.0)
    _look(plan, chance)
    plan.add(at_s + 4.0, "status")


STORIES: tuple[Story, ...] = (
    plain,
    stop_beside_start,
    stop_beside_start,
    stop_in_run,
    many_starts,
    two_faults,
    lying_sensor,
    wrong_camera,
    idle,
    moved_files,
    clock_set,
    killed_while_latched,
    reset_at_any_moment,
    waiting_for_disk,
    hanging_policy,
    lost_logs,
    strangers,
    told_to_end,
)
