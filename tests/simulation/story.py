"""Tells one seed's story in a universe, and judges it."""

import asyncio
import hashlib
import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from service.cell.cell import Cell
from service.messages import CellState
from service.policy.contract import ObservationEntry
from tests.service.cell import policies
from tests.service.policy.model_files import linear_model
from tests.simulation.judge import Judge
from tests.simulation.lies import LIES
from tests.simulation.network import Link
from tests.simulation.plan import LENGTH_S, Happening, Plan, drawn
from tests.simulation.plant import SERVO_S, LightCell
from tests.simulation.universe import RECIPE, Answer, Universe, configuration

PATIENCE_S = 5.0
"""Time for which a client waits for an answer."""
READY_S = 0.4
"""Time in which everything has started."""
APPROACH_M_S = 0.08
"""Largest speed of a scripted move."""


@dataclass(frozen=True)
class Outcome:
    """Outcome of one seed.

    Attributes:
        digest: of the trace; the same seed gives the same one.
    """

    seed: int
    plan: Plan
    violations: tuple[str, ...]
    trace: tuple[tuple[float, str], ...]
    digest: str
    simulated_s: float
    took_s: float
    peak_n: float

    def without_trace(self) -> "Outcome":
        return replace(self, trace=())


@lru_cache(maxsize=1)
def _folder() -> Path:
    shared = Path("/dev/shm")  # noqa: S108 - memory: a seed writes and forgets some hundred small files
    return Path(tempfile.mkdtemp(prefix="universe-", dir=shared if shared.is_dir() else None))


@lru_cache(maxsize=8)
def policy(name: str) -> Path:
    """A small real policy by name."""
    folder = _folder()
    if name != "sideways":
        return getattr(policies, name)(folder)
    asked = policies.document(observation=(*policies.OBSERVATION, ObservationEntry.of("time_fraction")))
    weights = np.zeros((asked.observation_size, len(asked.action)))
    weights[-1, 0] = 1e3
    return policies.save(folder / "sideways.onnx", linear_model(asked, weights=weights))


def tell(seed: int, plan: Plan | None = None) -> Outcome:
    """Live through one seed."""
    plan = plan or drawn(seed)
    state_dir = Path(tempfile.mkdtemp(prefix=f"{seed}-", dir=_folder())) / "state"
    state_dir.mkdir()
    try:
        return _tell(plan, state_dir)
    finally:
        shutil.rmtree(state_dir.parent, ignore_errors=True)


def _tell(plan: Plan, state_dir: Path) -> Outcome:
    import random

    plant = LightCell(1 + plan.seed, plan.surroundings, random.Random(plan.seed))
    config = configuration(state_dir, policy(plan.policy), autostart=plan.autostart)
    universe = Universe(plan.seed, config, plant)
    judge = Judge(universe, force_bound_n(plan, universe))
    universe.judge = judge.on_tick
    began_s, first_s = time.process_time(), universe.loop.time()
    with universe.alive():
        universe.live(Story(universe, judge, plan).tell())
    lines = tuple(universe.trace)
    digest = hashlib.sha256(repr(lines).encode()).hexdigest()[:16]
    return Outcome(
        plan.seed, plan, tuple(judge.violations), lines, digest, universe.loop.time() - first_s,
        time.process_time() - began_s, judge.peak_n,
    )  # fmt: skip


def force_bound_n(plan: Plan, universe: Universe) -> float:
    """Bound of the true force: the ceiling, and what an approach adds before a stop takes hold.

    A sensor that lies adds what the second witness lets pass, and the time that it takes.
    """
    s, config = plan.surroundings, universe.config
    lag_s = (s.delay_ticks + 2) * 2e-3 + SERVO_S
    honest_n = config.limits.force_ceiling_n + s.stiffness * APPROACH_M_S * lag_s
    if plan.lie == "honest":
        return honest_n
    return honest_n + config.witness.force_n + s.stiffness * APPROACH_M_S * config.witness.time_s


class Story:
    """Lets the happenings of a plan happen."""

    def __init__(self, universe: Universe, judge: Judge, plan: Plan) -> None:
        self.universe, self._judge, self._plan = universe, judge, plan
        self._tasks: list[asyncio.Task[Any]] = []

    async def tell(self) -> None:
        universe, plan = self.universe, self._plan
        await asyncio.sleep(READY_S)
        began_s = universe.loop.time()
        if plan.lie != "honest":
            universe.loop.call_at(began_s + plan.lie_s, self._lie)
        for happening in plan.happenings:
            await asyncio.sleep(began_s + happening.at_s - universe.loop.time())
            universe.note(str(happening))
            self.happen(happening)
        await asyncio.sleep(max(0.0, began_s + LENGTH_S - universe.loop.time()))
        patient_until = universe.loop.time() + plan.patience_s
        while (
            universe.loop.time() < patient_until and universe.cell is not None and universe.cell.runs.active is not None
        ):
            await asyncio.sleep(0.05)
        await self.come_to_rest()

    async def wait(self, seconds: float) -> None:
        """Let simulated time pass."""
        await asyncio.sleep(seconds)

    def _lie(self) -> None:
        self.universe.note(f"the sensor lies: {self._plan.lie}")
        self.universe.plant.lie = LIES[self._plan.lie]()

    def _later(self, seconds: float, call: Callable[[], object]) -> None:
        self.universe.loop.call_later(seconds, call)

    def _ask(self, *request: Any, **details: Any) -> None:
        async def ask() -> None:
            self._judge.on_answer(await self.universe.request(*request, **details))

        self._tasks.append(asyncio.create_task(ask()))

    def happen(self, one: Happening) -> None:
        universe, details = self.universe, one.details
        seconds = details.get("seconds", 0.0)
        self._judge.note_fault(one.kind, seconds)
        match one.kind:
            case "start":
                patience_s = details.get("patience_s", PATIENCE_S)
                headers = {"idempotency-key": details["key"]} if "key" in details else {}
                body = {"recipe": RECIPE, "operator": details["name"]}
                self._ask(
                    "POST", "/start", body, kind="start", name=details["name"], headers=headers, timeout_s=patience_s
                )
            case "stop":
                headers = {"host": details["host"]} if "host" in details else {}
                self._ask("POST", details.get("path", "/stop"), kind="stop", name=details["name"], headers=headers)
            case "reset":
                self._reset(details["name"])
            case "status" | "runs" | "health":
                self._ask("GET", f"/{one.kind}", kind=one.kind)
            case "freeze":
                universe.processes[details["part"]].freeze(seconds)
            case "block":
                universe.processes[details["part"]].block(seconds)
            case "kill" | "terminate" | "power cut":
                self._crash(one)
            case "clock set":
                universe.host.wall_step_s += seconds
            case "database busy":
                universe.host.database_busy_until = universe.loop.time() + seconds
            case "policy hangs":
                universe.host.inference_hangs_until = universe.loop.time() + seconds
            case "policy loads":
                universe.host.loading_until = universe.loop.time() + seconds
            case "log full":
                universe.host.log.full_until = universe.loop.time() + seconds
            case "log unread":
                universe.host.log.unread_until = universe.loop.time() + seconds
            case "read":
                universe.stranger.read(details["key"])
            case "empty":
                universe.stranger.empty(details["command"])
            case "copy":
                universe.stranger.repeat(details["command"])
            case "drive":
                universe.stranger.drive()
            case "disk hangs" | "disk full" | "disk slow" | "ledger moved" | "state deleted":
                self._spoil_disk(one.kind, seconds)
            case _:
                self._spoil_link(one)

    def _reset(self, name: str) -> None:
        cell = self.universe.cell
        latch = None if cell is None else cell.journal.latch
        if latch is not None:
            body = {"acknowledge": latch.code.value, "comment": "looked", "operator": name}
            self._ask("POST", "/reset", body, kind="reset", name=name)

    def _crash(self, one: Happening) -> None:
        universe, part = self.universe, one.details["part"]
        if one.kind == "terminate":
            universe.terminate(part)
            part = part if part != "world" else None
        elif one.kind == "power cut":  # of the host; the arm's controller has a supply of its own
            for name in ("control", "api"):
                universe.kill(name)
                self._later(one.details["again_s"], partial(self._revive, name))
            universe.disk.cut_power()
            return
        else:
            universe.kill(part)
        if part is not None:
            self._later(one.details["again_s"] + (1.0 if one.kind == "terminate" else 0.0), partial(self._revive, part))

    def _revive(self, part: str) -> None:
        universe = self.universe
        if not universe.processes[part].alive:
            {"world": universe.start_world, "control": universe.start_control, "api": universe.start_api}[part]()

    def _spoil_disk(self, kind: str, seconds: float) -> None:
        universe, disk = self.universe, self.universe.disk
        if kind == "disk hangs":
            disk.hangs_until = universe.loop.time() + seconds
        elif kind == "disk full":
            disk.full = True
            self._later(seconds, lambda: setattr(disk, "full", False))
        elif kind == "disk slow":
            disk.latency_s = (0.01, 0.2)
            self._later(seconds, lambda: setattr(disk, "latency_s", (1e-4, 3e-3)))
        else:
            names = ("ledger.jsonl",) if kind == "ledger moved" else ("ledger.jsonl", "latch.json")
            ledger = universe.state_dir / "ledger.jsonl"
            universe.set_aside += ledger.read_bytes() if ledger.exists() else b""
            for name in names:
                (universe.state_dir / name).unlink(missing_ok=True)

    def _spoil_link(self, one: Happening) -> None:
        universe, details = self.universe, one.details
        link = universe.network.link(*details["link"])
        now, seconds = universe.loop.time(), details["seconds"]
        if one.kind == "stall":
            link.stalled_until = now + seconds
        elif one.kind == "cut":
            link.cut_until = now + seconds
        else:
            name = {"slow": "delay_s"}.get(one.kind, one.kind)
            setattr(link, name, details["strength"])
            self._later(seconds, lambda: setattr(link, name, getattr(Link(), name)))

    async def come_to_rest(self) -> None:
        """End every fault, stop, and let the record catch up; then judge it."""
        universe = self.universe
        universe.disk.full, universe.disk.latency_s, universe.disk.hangs_until = False, (1e-4, 3e-3), 0.0
        universe.host.database_busy_until = universe.host.inference_hangs_until = universe.host.loading_until = 0.0
        universe.host.log.full_until = universe.host.log.unread_until = 0.0
        for link in universe.network.links.values():
            link.delay_s, link.drop, link.repeat, link.reorder, link.cut_until = Link().delay_s, 0.0, 0.0, False, 0.0
        await asyncio.sleep(0.7)
        for part in ("world", "control", "api"):
            self._revive(part)
        await asyncio.sleep(READY_S)
        for task in self._tasks:
            await task
        answer = await universe.request("POST", "/stop", kind="stop", name="stop at the end")
        self._judge.on_answer(answer)
        for _ in range(50):
            cell = universe.cell
            if cell is not None and _rests(cell):
                break
            await asyncio.sleep(0.1)
        else:
            state = None if universe.cell is None else universe.cell.state
            self._judge.violation("never at rest", f"the cell is {state} after everything is well again")
        listed = Answer("runs", "", None, 0.0)
        for _ in range(8):
            await asyncio.sleep(0.25)
            listed = await universe.request("GET", "/runs?limit=200", kind="runs")
            if self._judge.is_told(listed):
                break
        self._judge.on_end(listed)


def _rests(cell: Cell) -> bool:
    is_linked = not cell.unlinked.is_set()
    return is_linked and cell.state in (CellState.READY, CellState.LATCHED) and cell.runs.active is None
