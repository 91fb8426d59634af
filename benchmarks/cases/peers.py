"""The project's environment and training beside tasks of robosuite and Gymnasium-Robotics, each on one thread."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

from benchmarks.cases import training_share
from benchmarks.harness.processes import ROOT
from benchmarks.harness.result import Result
from benchmarks.stands.peer_environments import CELLS, WARM_UP, Taken
from training.environment.design import vftm_dsl
from wire.records import TICK_S

OURS = {"one_cell": "ours, 1 cell", "many_cells": f"ours, {CELLS} cells"}
PEERS = {
    "fetch_pick_and_place": "Gymnasium-Robotics FetchPickAndPlace-v4",
    "nut_assembly": "robosuite NutAssemblySquare, UR5e",
    "two_arm_peg_in_hole": "robosuite TwoArmPegInHole, two Pandas",
}
TURNS = 2
SPAN_S = 12.0
ROLLOUTS = 4
TIMEOUT_S = 300.0
ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL", "NUMBA")}


def measure(scale: float, python: Path | None = None) -> Result:
    """Measure; `scale` multiplies the 12 s per environment and turn, and the rollouts of training.

    Args:
        scale: factor on the durations.
        python: Python with the peers; by default the running one.
    """
    here = Path(sys.executable)
    pythons = dict.fromkeys(OURS, here) | dict.fromkeys(PEERS, python or here)
    found: dict[str, list[Taken]] = {name: [] for name in pythons}
    lacking: dict[str, str] = {}
    for name in [*pythons] * TURNS:
        if name in lacking:
            continue
        taken = _step(pythons[name], name, SPAN_S * scale)
        if isinstance(taken, Taken):
            found[name].append(taken)
        else:
            lacking[name] = taken
    rows = [_row(label, found[name], lacking.get(name, "")) for name, label in (OURS | PEERS).items()]
    rollouts = max(1, round(ROLLOUTS * scale))
    share = training_share.one_process(rollouts, CELLS)
    workers = len(os.sched_getaffinity(0))
    physics = f"{share.ticks_s / share.total_s:.0%}"
    spread = training_share.steps_per_s(workers, rollouts, CELLS * workers)
    rows[len(OURS) : len(OURS)] = [
        _training(f"our training end to end, {CELLS} cells", share.steps / share.total_s, physics),
        _training(f"the same, {workers} workers of {CELLS} cells", spread, "–"),
    ]
    return Result(
        question="How fast are the environment and training beside other robot-learning environments?",
        columns=(
            "environment",
            "Hz",
            "physics steps",
            "env steps/s",
            "simulated s/s",
            "physics",
            "ms/reset",
            "versions",
        ),
        rows=tuple(rows),
        finding=_finding({name: _simulated(taken) for name, taken in found.items() if name not in lacking}),
        method=f"Hz: env steps per simulated second. physics steps: per env step. simulated s/s: of all cells, per "
        "second of wall-clock. physics: share of the engine's own step. Random actions, no pictures. The environments "
        f"take turns, {TURNS} of {SPAN_S * scale:g} s each after {WARM_UP} steps, each in a process of its own on one "
        f"thread; the rates exclude resets. Training: {rollouts} rollouts of the experiment "
        f"{training_share.EXPERIMENT} with their updates, resets included.",
    )


def _step(python: Path, name: str, seconds: float) -> Taken | str:
    """Step one environment in a process of its own; return its figures, or the reason why it could not be stepped."""
    try:
        done = subprocess.run(
            [python.absolute(), "-m", "benchmarks.stands.peer_environments", name, str(seconds)],
            cwd=ROOT,
            env=os.environ | ONE_THREAD,
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"did not run: {error}"
    if done.returncode != 0:
        raised = re.findall(r"^[\w.]*(?:Error|Exception)\b.*", done.stderr, re.MULTILINE)
        return f"did not run: {raised[-1][:120] if raised else f'status {done.returncode}'}"
    answer = json.loads(done.stdout.splitlines()[-1])
    return f"not installed: {answer['missing']}" if "missing" in answer else Taken(**answer)


def _row(label: str, turns: list[Taken], lacking: str) -> tuple[str, ...]:
    if lacking:
        return (label, *["–"] * 6, lacking)
    first, seconds = turns[0], sum(taken.stepping_s for taken in turns)
    resets = sum(taken.resets for taken in turns)
    return (
        label,
        f"{1.0 / first.step_s:g}",
        _ticks(first.step_s, first.tick_s),
        f"{sum(taken.steps for taken in turns) / seconds:.0f}",
        f"{_simulated(turns):.1f}",
        f"{sum(taken.physics_s for taken in turns) / seconds:.0%}",
        f"{sum(taken.resets_s for taken in turns) / resets * 1e3:.2g}" if resets else "–",
        first.versions,
    )


def _training(label: str, steps_per_s: float, physics: str) -> tuple[str, ...]:
    period_s = vftm_dsl().period_s
    ticks = _ticks(period_s, TICK_S)
    return (
        label,
        f"{1.0 / period_s:g}",
        ticks,
        f"{steps_per_s:.0f}",
        f"{steps_per_s * period_s:.1f}",
        physics,
        "–",
        "",
    )


def _ticks(step_s: float, tick_s: float) -> str:
    return f"{round(step_s / tick_s)} x {tick_s * 1e3:g} ms"


def _simulated(turns: list[Taken]) -> float:
    """Return the simulated seconds of all cells per second of wall-clock."""
    return sum(taken.steps * taken.step_s for taken in turns) / sum(taken.stepping_s for taken in turns)


def _finding(simulated: dict[str, float]) -> str:
    ours = {name: simulated[name] for name in OURS if name in simulated}
    theirs = {name: simulated[name] for name in PEERS if name in simulated}
    if not theirs:
        return "No peer could be stepped: `--peers-python` names a Python that has them."
    return " ".join(
        f"Simulated time of {OURS[name]}: "
        + "; ".join(f"{rate / other:.2g} times {PEERS[peer]}" for peer, other in theirs.items())
        + "."
        for name, rate in ours.items()
    )
