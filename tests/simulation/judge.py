"""The invariants, judged by the true motion, the true force and the record."""

import json
from dataclasses import dataclass, field
from typing import Any

from service.cell.cell import Cell
from service.cell.runs import ActiveRun
from service.faults import FaultCode
from service.messages import Latch, Run, RunState
from tests.simulation.universe import RECIPE, Answer, Universe
from wire.records import TICK_S, Program

MOVING_M_S = 2e-3
"""Speed at which an arm counts as moving; the cell measures standstill with the same number."""
BRAKING_S = 0.6
"""Time in which an arm stands whose run is gone: its target grows old, its speed limit falls to zero."""
SETTLED_S = 0.05
"""Time after which a latch must survive a kill: the disk has had it."""
UNSEEN_S = 0.3
"""Time after the ledger was taken away in which a kill may lose the run under way: a documented limit.

So is a ledger that is taken away while no control process runs.
"""
ENDS_S = 3.0
"""Time in which a process that is told to end has ended."""
ANSWERED_S = 1.1
"""Time in which a stop is answered, with the way to the client."""
ANSWER_LATE_S = 0.1
"""Time by which the policy's deadline may be overrun: a sample that is late."""
HOLDING = frozenset({"freeze", "block", "stall", "cut", "slow", "drop", "repeat", "reorder", "database busy"})
"""Faults that hold up an answer or an end for as long as they last."""
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
        self._listed: set[str] = set()
        self._held_s = 0.0
        self._may_lose = False
        self._taken_s = -1.0
        self._state_lost = False
        self._killed_id: str | None = None
        self._unrecorded: set[str | None] = set()
        self._began_s = 0.0
        self._run_id: str | None = None
        self._owed: tuple[str, int] | None = None
        self._owed_ticks = 0
        self.deepest: dict[str, float] = {}
        self._seen: set[str] = set()
        self.moved_s = 0.0

    def violation(self, kind: str, text: str) -> None:
        """Note a violation, the first one of its kind."""
        if kind not in self._seen:
            self._seen.add(kind)
            line = f"{kind}: {text}"
            self.violations.append(f"{self.universe.loop.time():.4f} {line}")
            self.universe.note(f"VIOLATION {line}")

    @property
    def _world_s(self) -> float:
        """Time of the world, which stands still while its process is frozen."""
        return self.universe.plant.ticks * TICK_S

    def note_fault(self, kind: str, seconds: float) -> None:
        """Take note of a fault that begins: it excuses what is late, and a cut link what never comes."""
        self._may_lose |= kind == "cut"
        now, cell = self.universe.loop.time(), self.universe.cell
        if kind in ("ledger moved", "state deleted"):
            self._taken_s = now
            if not self.universe.processes["control"].alive:
                self._unrecorded.add(self._killed_id)
                self._state_lost |= kind == "state deleted"
        elif kind in ("kill", "power cut") and cell is not None:
            self._killed_id = cell.runs.active_id
            if now - self._taken_s < UNSEEN_S:
                self._unrecorded.add(self._killed_id)
        if kind in HOLDING:
            self._held_s += seconds

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
            if run_id != self._run_id:
                self._run_id, self._began_s = run_id, now
                self._judge_acceptance(active.accepted, now)
            self._judge_policy(active, now)
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
                self.violation("force", f"{self.peak_n:.1f} N, bound {self.force_bound_n:.1f} N, {plant.lie.name}")
        if cell is not None and (cell.journal.epoch != self._epoch or cell.journal.latch is not self._latch):
            self._judge_latch(cell, now)

    def _judge_acceptance(self, run: Run, now: float) -> None:
        """No run begins after its client was told no; only an API that ends does not know."""
        for answer in self.universe.answers:
            if answer.kind != "start" or answer.name != run.requested_by or answer.status is None:
                continue
            refused = answer.status >= 400 and answer.document.get("reason") != "SHUTTING_DOWN"
            if refused and (answer.received_s or 0.0) < now:
                self.violation("late start", f"{answer.name} was answered {answer.status}, then {run.id} began")

    def _judge_policy(self, active: ActiveRun, now: float) -> None:
        """A run does not wait for its policy beyond the deadline, as far as its process has had time."""
        owed = active.accepted.id, getattr(active._inference, "owed", 0)
        if owed != self._owed or not owed[1]:
            self._owed, self._owed_ticks = owed, 0
        elif self.universe.processes["control"].main.awake_at() <= now:
            self._owed_ticks += 1
            waited_s = self._owed_ticks * TICK_S
            if waited_s > self.universe.config.limits.policy_deadline_s + ANSWER_LATE_S:
                self.violation("hanging policy", f"{owed[0]} has waited {waited_s:.3f} s for an action")

    def _judge_motion(self, now: float, has_run: bool) -> None:
        since_s = self._world_s - self._last_run_s
        if not has_run and since_s > BRAKING_S:
            self.violation("motion without a run", f"the last run ended {since_s:.3f} s ago")
        stop = self._stop
        if stop is None or stop.received_s is None:
            return
        answers = self.universe.answers
        start = next((a for a in answers if a.kind == "start" and a.name == self._driving), None)
        if start is not None and answers.index(start) > answers.index(stop):
            return  # sent after the stop, were it in the same instant: it may have been received after it
        confirmed = stop.status == 200
        if confirmed or self._world_s - self._stopped_s > BRAKING_S:
            text = f"the stop was answered {now - stop.received_s:.3f} s ago, {self._driving} moves the arm"
            self.violation("motion after a stop", text)

    def _judge_latch(self, cell: Cell, now: float) -> None:
        before, restarted = self._latch, cell.journal.epoch != self._epoch
        self._epoch = cell.journal.epoch
        self._latch = latch = cell.journal.latch
        forgets = (
            restarted and self._state_lost
        )  # latch and ledger are both lost, and nobody saw it: a documented limit
        self._state_lost &= not restarted
        if before is not None and latch is None and not forgets:
            settled = now - self._latched_s > SETTLED_S and not self.universe.disk.faulty
            resets = [
                answer
                for answer in self.universe.answers
                if answer.kind == "reset" and answer.body is not None and answer.body["acknowledge"] == before.code
            ]
            if not any(reset.sent_s >= self._latched_s for reset in resets) and (settled or not restarted):
                self.violation("latch", f"{before.code} left without a reset")
        elif latch is not None and (before is None or before.code != latch.code):
            self._latched_s = now
            if not restarted:
                self._judge_stopper(latch.code)

    def _judge_stopper(self, code: FaultCode) -> None:
        """A run that was stopped was stopped by somebody who may; nobody else drives the arm."""
        if code is FaultCode.AUTHORITY:
            self.violation("stopped by a stranger", f"{self._run_id} latched {code}")
        if code is not FaultCode.OPERATOR_STOP:
            return
        stops = [answer for answer in self.universe.answers if answer.kind == "stop"]
        if not any(stop.status not in (200, 202) or (stop.received_s or 0.0) >= self._began_s for stop in stops):
            self.violation("stopped by nobody", f"{self._run_id} latched {code}")

    # --- at every answer

    def on_answer(self, answer: Answer) -> None:
        taken_s = self.universe.loop.time() - answer.sent_s
        waited = answer.kind == "stop" and (answer.status is not None or (answer.gave_up and not self._may_lose))
        if waited and taken_s > ANSWERED_S + self._held_s:
            self.violation("late answer", f"{answer.name} was answered {answer.status} after {taken_s:.3f} s")
        if answer.status is None:
            return
        if answer.status >= 500 and answer.document is None:
            self.violation("crash", f"{answer.kind} was answered {answer.status}")
        if answer.kind == "stop" and 300 <= answer.status < 500:
            self.violation("stop refused", f"{answer.name} was answered {answer.status}")
        told = answer.kind == "stop" and answer.status in (200, 202) and answer.document["state"] != "UNKNOWN"
        newest_s = 0.0 if self._stop is None else self._stop.received_s or 0.0
        if told and (answer.received_s or 0.0) >= newest_s:
            self._stop, self._stopped_s = answer, self._world_s
        if answer.kind == "runs" and answer.status == 200:
            active = [run["id"] for run in answer.document["runs"] if run["state"] == RunState.ACTIVE]
            if len(active) > 1:
                self.violation("several runs", f"{active} are told as ACTIVE")
            for run in answer.document["runs"]:
                self._listed.add(run["id"])
                if run["state"] != RunState.ACTIVE:
                    self._told.setdefault(run["id"], (run["state"], run["code"]))

    # --- in the end

    def on_end(self, listed: Answer) -> None:
        """Judge the record, once everything has come to rest.

        Args:
            listed: the history, as the API tells it last.
        """
        universe = self.universe
        recorded = self._recorded()
        for run in recorded.values():
            if run["state"] == RunState.SUCCEEDED:
                depth_m = self.deepest.get(run["id"], -1.0)
                wanted_m = universe.config.recipes[RECIPE].success_depth_m - 2e-4
                if depth_m < wanted_m:
                    self.violation("false success", f"the peg was {depth_m * 1e3:.2f} mm deep at most")
        active = [run["id"] for run in recorded.values() if run["state"] == RunState.ACTIVE]
        if active:
            self.violation("endless run", f"{active} are ACTIVE in the ledger, and nothing runs")
        for answer in universe.answers:
            if answer.kind != "start" or answer.status is None:
                continue
            if answer.status == 202:
                if answer.document["id"] not in recorded:
                    self.violation("record", f"{answer.name} was answered with {answer.document['id']}, not recorded")
            elif answer.document.get("reason") not in UNKNOWN_OUTCOMES:
                phantom = [run["id"] for run in recorded.values() if run["requested_by"] == answer.name]
                if phantom:
                    self.violation("phantom", f"{answer.name} was refused, and is {phantom} in the ledger")
        self._judge_history(listed, recorded)
        self._judge_told(recorded)
        self._judge_names(recorded)
        self._judge_ends()

    def is_told(self, listed: Answer) -> bool:
        """Return True once the history lists every run of the ledger in the ledger's state."""
        recorded = {run["id"]: run["state"] for run in self._recorded().values()}
        return listed.status == 200 and {run["id"]: run["state"] for run in listed.document["runs"]} == recorded

    def _recorded(self) -> dict[str, Any]:
        """Return the runs of the ledger; one whose end may be lost counts as interrupted."""
        runs = ledger_runs(self.universe)
        for run_id, run in runs.items():
            if run_id in self._unrecorded and run["state"] == RunState.ACTIVE:
                runs[run_id] = run | {"state": RunState.INTERRUPTED, "code": FaultCode.INTERRUPTED}
        return runs

    def _judge_history(self, listed: Answer, recorded: dict[str, Any]) -> None:
        if listed.status != 200:
            self.violation("history", f"GET /runs is answered {listed.status} after everything is well again")
            return
        told = {run["id"]: run["state"] for run in listed.document["runs"]}
        kept = {run["id"]: run["state"] for run in recorded.values()}
        if told != kept:
            self.violation("history", f"GET /runs tells {told}, the ledger has {kept}")
        order = [run["id"] for run in listed.document["runs"]]
        newest_first = list(reversed(recorded))
        if sorted(order) == sorted(newest_first) and order != newest_first:
            self.violation("order", f"GET /runs lists {order}, the ledger {newest_first}")

    def _judge_names(self, recorded: dict[str, Any]) -> None:
        """Every run was asked for, once."""
        asked = {answer.name for answer in self.universe.answers if answer.kind == "start"}
        names = [run["requested_by"] for run in recorded.values()]
        for name in names:
            if name not in asked or names.count(name) > 1:
                self.violation("started by nobody", f"{names.count(name)} runs by {name}")

    def _judge_ends(self) -> None:
        """A process that was told to end has ended, and has started nothing since."""
        universe, now = self.universe, self.universe.loop.time()
        for process, told_s in universe.told_to_end.items():
            if process.alive and now - told_s > ENDS_S + self._held_s:
                self.violation("never ends", f"{process.name} was told to end {now - told_s:.3f} s ago")
            if any(starter is process and at_s > told_s for starter, at_s in universe.starts):
                self.violation("start after the end", f"{process.name} started a process after it was told to end")

    def _judge_told(self, recorded: dict[str, Any]) -> None:
        """An end that was told is the end that is found, whatever came later; a run that was listed is one."""
        phantoms = self._listed - set(recorded)
        if phantoms:
            self.violation("phantom", f"{sorted(phantoms)} were listed, and are not in the ledger")
        for run_id, told in self._told.items():
            run = recorded.get(run_id)
            found = None if run is None else (run["state"], run["code"])
            if found != told:
                self.violation("cause", f"{run_id} was told as {told}, found as {found}")


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
