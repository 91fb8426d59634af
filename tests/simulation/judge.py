"""The invariants, judged by the true motion, the true force and the record."""

import json
from dataclasses import dataclass, field
from typing import Any

from service.cell.cell import Cell
from service.messages import Latch, RunState
from tests.simulation.universe import RECIPE, Answer, Universe
from wire.records import TICK_S, Program

MOVING_M_S = 2e-3
"""Speed at which an arm counts as moving; the cell measures standstill with the same number."""
BRAKING_S = 0.6
"""Time in which an arm stands whose run is gone: its target grows old, its speed limit falls to zero."""
SETTLED_S = 0.05
"""Time after which a latch must survive a kill: the disk has had it."""
UNKNOWN_OUTCOMES = frozenset({"CELL_SILENT", "SHUTTING_DOWN", None})
"""Reasons of a refused start that leave open whether it was accepted."""


@dataclass
class Judge:
    """Looks at each tick of the world and at each answer, and at the record in the end.

    Attributes:
        force_bound_n: bound of the true force for this sensor and this contact.
        violations: one line each; empty where everything holds.
    """

    universe: Universe
    force_bound_n: float
    violations: list[str] = field(default_factory=list)
    peak_n: float = 0.0

    def __post_init__(self) -> None:
        self._driving: str | None = None
        self._program = Program.IDLE
        self._last_run_s = self._stopped_s = 0.0
        self._latch: Latch | None = None
        self._latched_s = 0.0
        self._epoch: str | None = None
        self._stop: Answer | None = None
        self._told: dict[str, tuple[str, str | None]] = {}
        self.deepest: dict[str, float] = {}
        self._seen: set[str] = set()
        self.moved_s = 0.0

    def _violation(self, kind: str, text: str) -> None:
        if kind not in self._seen:
            self._seen.add(kind)
            line = f"{kind}: {text}"
            self.violations.append(f"{self.universe.loop.time():.4f} {line}")
            self.universe.note(f"VIOLATION {line}")

    @property
    def _world_s(self) -> float:
        """Time of the world, which stands still while its process is frozen."""
        return self.universe.plant.ticks * TICK_S

    # --- at every tick

    def on_tick(self) -> None:
        universe, plant = self.universe, self.universe.plant
        now = universe.loop.time()
        cell = universe.cell
        active = None if cell is None else cell.runs.active
        if active is not None:
            self._last_run_s = self._world_s
            run_id = active.accepted.id
            self.deepest[run_id] = max(self.deepest.get(run_id, -1.0), plant.depth)
        if plant.program is Program.ENGAGED and self._program is not Program.ENGAGED:
            self._driving = None if active is None else active.accepted.requested_by
        self._program = plant.program
        vx, vy, vz = plant.velocity
        if vx * vx + vy * vy + vz * vz > MOVING_M_S**2:
            self.moved_s = now
            self._judge_motion(now, active is not None)
        if plant.truth_force_n > self.peak_n:
            self.peak_n = plant.truth_force_n
            if self.peak_n > self.force_bound_n:
                self._violation("force", f"{self.peak_n:.1f} N, bound {self.force_bound_n:.1f} N, {plant.lie.name}")
        if cell is not None and (cell.journal.epoch != self._epoch or cell.journal.latch is not self._latch):
            self._judge_latch(cell, now)

    def _judge_motion(self, now: float, has_run: bool) -> None:
        since_s = self._world_s - self._last_run_s
        if not has_run and since_s > BRAKING_S:
            self._violation("motion without a run", f"the last run ended {since_s:.3f} s ago")
        stop = self._stop
        if stop is None or stop.received_s is None:
            return
        start = next((a for a in self.universe.answers if a.kind == "start" and a.name == self._driving), None)
        if start is not None and start.sent_s > stop.sent_s:
            return  # it may have been received after the stop
        confirmed = stop.status == 200
        if confirmed or self._world_s - self._stopped_s > BRAKING_S:
            text = f"the stop was answered {now - stop.received_s:.3f} s ago, {self._driving} moves the arm"
            self._violation("motion after a stop", text)

    def _judge_latch(self, cell: Cell, now: float) -> None:
        before, restarted = self._latch, cell.journal.epoch != self._epoch
        self._epoch = cell.journal.epoch
        self._latch = latch = cell.journal.latch
        if before is not None and latch is None:
            settled = now - self._latched_s > SETTLED_S and not self.universe.disk.faulty
            resets = [
                answer
                for answer in self.universe.answers
                if answer.kind == "reset" and answer.body is not None and answer.body["acknowledge"] == before.code
            ]
            if not any(reset.sent_s >= self._latched_s for reset in resets) and (settled or not restarted):
                self._violation("latch", f"{before.code} left without a reset")
        elif latch is not None and (before is None or before.code != latch.code):
            self._latched_s = now

    # --- at every answer

    def on_answer(self, answer: Answer) -> None:
        if answer.status is None:
            return
        if answer.status >= 500 and answer.document is None:
            self._violation("crash", f"{answer.kind} was answered {answer.status}")
        told = answer.kind == "stop" and answer.status in (200, 202) and answer.document["state"] != "UNKNOWN"
        newest_s = 0.0 if self._stop is None else self._stop.received_s or 0.0
        if told and (answer.received_s or 0.0) >= newest_s:
            self._stop, self._stopped_s = answer, self._world_s
        if answer.kind == "runs" and answer.status == 200:
            active = [run["id"] for run in answer.document["runs"] if run["state"] == RunState.ACTIVE]
            if len(active) > 1:
                self._violation("several runs", f"{active} are told as ACTIVE")
            for run in answer.document["runs"]:
                if run["state"] != RunState.ACTIVE:
                    self._told.setdefault(run["id"], (run["state"], run["code"]))

    # --- in the end

    def on_end(self, listed: Answer) -> None:
        """Judge the record, once everything has come to rest.

        Args:
            listed: the history, as the API tells it last.
        """
        universe = self.universe
        recorded = ledger_runs(universe)
        for run in recorded.values():
            if run["state"] == RunState.SUCCEEDED:
                depth_m = self.deepest.get(run["id"], -1.0)
                wanted_m = universe.config.recipes[RECIPE].success_depth_m - 2e-4
                if depth_m < wanted_m:
                    self._violation("false success", f"the peg was {depth_m * 1e3:.2f} mm deep at most")
        active = [run["id"] for run in recorded.values() if run["state"] == RunState.ACTIVE]
        if active:
            self._violation("endless run", f"{active} are ACTIVE in the ledger, and nothing runs")
        for answer in universe.answers:
            if answer.kind != "start" or answer.status is None:
                continue
            if answer.status == 202:
                if answer.document["id"] not in recorded:
                    self._violation("record", f"{answer.name} was answered with {answer.document['id']}, not recorded")
            elif answer.document.get("reason") not in UNKNOWN_OUTCOMES:
                phantom = [run["id"] for run in recorded.values() if run["requested_by"] == answer.name]
                if phantom:
                    self._violation("phantom", f"{answer.name} was refused, and is {phantom} in the ledger")
        self._judge_history(listed, recorded)
        self._judge_told(recorded)

    def is_told(self, listed: Answer) -> bool:
        """Return True once the history lists every run of the ledger in the ledger's state."""
        recorded = {run["id"]: run["state"] for run in ledger_runs(self.universe).values()}
        return listed.status == 200 and {run["id"]: run["state"] for run in listed.document["runs"]} == recorded

    def _judge_history(self, listed: Answer, recorded: dict[str, Any]) -> None:
        if listed.status != 200:
            self._violation("history", f"GET /runs is answered {listed.status} after everything is well again")
            return
        told = {run["id"]: run["state"] for run in listed.document["runs"]}
        kept = {run["id"]: run["state"] for run in recorded.values()}
        if told != kept:
            self._violation("history", f"GET /runs tells {told}, the ledger has {kept}")
        order = [run["id"] for run in listed.document["runs"]]
        newest_first = list(reversed(recorded))
        if sorted(order) == sorted(newest_first) and order != newest_first:
            self._violation("order", f"GET /runs lists {order}, the ledger {newest_first}")

    def _judge_told(self, recorded: dict[str, Any]) -> None:
        """An end that was told is the end that is found, whatever came later."""
        for run_id, told in self._told.items():
            run = recorded.get(run_id)
            found = None if run is None else (run["state"], run["code"])
            if found != told:
                self._violation("cause", f"{run_id} was told as {told}, found as {found}")


def ledger_runs(universe: Universe) -> dict[str, Any]:
    """The runs of the ledger's file, oldest first, each as its last line has it."""
    runs: dict[str, Any] = {}
    path = universe.state_dir / "ledger.jsonl"
    present = path.read_bytes() if path.exists() else b""
    for line in (universe.set_aside + present).splitlines():
        try:
            document = json.loads(line)
        except ValueError:
            continue
        if isinstance(document, dict) and "run" in document:
            runs[document["run"]["id"]] = document["run"]
        elif isinstance(document, dict) and "forgotten" in document:
            runs.pop(document["forgotten"], None)
    return runs
