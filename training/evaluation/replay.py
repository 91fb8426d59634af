"""Plays episodes with the code of one tree and prints a digest of every step; a script, run once in each of two trees.

It is started as `python -P replay.py` with the tree's root as working folder and as `PYTHONPATH`, reads one request
as JSON from each line of its input and answers with one line of JSON. The tree may be an earlier one with other module
names, so this file imports nothing of the project by itself: `MODULES` names where each thing is found.
"""

import hashlib
import importlib
import json
import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

import numpy as np

MODULES = {
    "insertion": ("training.environment.insertion", "training.insertion"),
    "evaluate": ("training.evaluation.evaluate", "training.evaluate"),
    "provenance": ("training.evaluation.provenance", "training.provenance"),
    "results": ("training.evaluation.results", "training.results"),
    "through_service": ("training.evaluation.through_service", "training.through_service"),
    "task": ("wire.task", "sim_backend.protocol.task"),
    "plant": ("wire.plant",),
    "contract": ("service.policy.contract",),
    "model": ("service.policy.model",),
}
"""Names of each module in the trees that this script knows, by role, the newest first."""
PROJECT = ("wire", "service", "sim_backend", "training")
OUTCOME = (
    *("observation", "reward", "terminated", "truncated", "success", "fault"),
    *("peak_force", "depth", "z_lock", "phase", "clamped"),
)
"""Arrays of a step's outcome whose bytes are compared."""
DIGEST_BYTES = 8


class ReplayError(RuntimeError):
    """This tree cannot play what it was asked to."""


class Recorder:
    """Watches n cells and keeps a digest of every array of every step, for each cell.

    Ticks that a tree makes in one call are made singly, so that each can be watched; its tests show that they are the
    same.

    Attributes:
        steps: per cell, per step, digests in the order of `names`.
        names: of the arrays.
    """

    names = ("action", "ticks", "true_peak", *OUTCOME)

    def __init__(self, insertions: Any) -> None:
        self.steps: list[list[list[str]]] = [[] for _ in range(insertions.n)]
        self._insertions = insertions
        self._true_peak = np.zeros(insertions.n)
        self._ticks = [hashlib.blake2b(digest_size=DIGEST_BYTES) for _ in range(insertions.n)]

    def play(self, run: Callable[[], Any]) -> Any:
        """Call `run` and record the cells meanwhile."""
        cells, world = self._insertions, self._insertions.world
        step, tick, reset = cells.step, world.tick, cells.reset

        def watched_reset(*arguments: Any) -> Any:
            observation = reset(*arguments)
            self._keep({"observation": observation})
            return observation

        def watched_tick() -> None:
            tick()
            np.maximum(self._true_peak, world.true_force, out=self._true_peak)
            for cell, digest in enumerate(self._ticks):
                digest.update(world.sensor.wrench[cell].tobytes())
                digest.update(world.position[cell].tobytes())
                digest.update(world.rotation[cell].tobytes())

        def watched_advance(readings: Any) -> None:
            for row in readings:
                watched_tick()
                row[:] = world.sensor.wrench

        def watched_step(action: Any) -> Any:
            outcome = step(action)
            self._keep({"action": np.asarray(action), **{name: getattr(outcome, name) for name in OUTCOME}})
            return outcome

        cells.step, world.tick, cells.reset = watched_step, watched_tick, watched_reset
        world.advance = watched_advance  # an earlier tree has none and does not call it
        try:
            return run()
        finally:
            del cells.step, world.tick, cells.reset, world.advance

    def _keep(self, arrays: dict[str, Any]) -> None:
        for cell, kept in enumerate(self.steps):
            digests = {name: _digest(array[cell]) for name, array in arrays.items()}
            digests |= {"ticks": self._ticks[cell].hexdigest(), "true_peak": _digest(self._true_peak[cell])}
            kept.append([digests.get(name, "") for name in self.names])


def module(role: str) -> Any:
    """Import the module of a role from this tree.

    Raises:
        ReplayError: the tree has none of the known names.
    """
    for name in MODULES[role]:
        if Path.cwd().joinpath(*name.split(".")).with_suffix(".py").is_file():
            return importlib.import_module(name)
    raise ReplayError(f"{Path.cwd()} has none of {', '.join(MODULES[role])}")


def sources() -> dict[str, Any]:
    """Return the digests of this tree's sources by the tree's own rule, and its commit."""
    provenance = module("provenance")
    return {
        "sources": provenance.sources(),
        "deployed_sources": provenance.deployed_sources(),
        "commit": provenance.commit(),
    }


def play_environment(request: dict[str, Any]) -> dict[str, Any]:
    """Play seeds of one setting in the batched environment.

    The request holds `model`, `setting`, `seeds` and `stand_in`: changes to the contract of a policy that stands in for
    the measured one; None: the measured policy plays.
    """
    setting = request["setting"]
    policy = _policy(request["model"])
    task_type = module("task").Task
    errors = _errors(setting)
    fixed = setting["part"], setting["clearance_m"], setting["conditions"]
    tasks = [task_type(seed, *fixed, **errors) for seed in request["seeds"]]
    changes = json.dumps(request["stand_in"] or {})
    insertions = _insertions(request["model"], changes, json.dumps(setting), len(tasks))
    recorder = Recorder(insertions)
    played = recorder.play(lambda: module("evaluate").play(policy, insertions, tasks, to_author_depth=True))
    return {
        "names": recorder.names,
        "episodes": [
            {"result": asdict(result), "steps": steps} for result, steps in zip(played, recorder.steps, strict=True)
        ],
    }


def play_service(request: dict[str, Any]) -> dict[str, Any]:
    """Play seeds of one setting through the deployed service of this tree.

    The true depth is left out: the arm stands under force while it is asked, for a time that differs.
    """
    setting = module("results").Block.model_validate({"setting": request["setting"]}).setting
    played = module("through_service").play(Path(request["model"]), request["seeds"], setting)
    return {"names": [], "episodes": [{"result": asdict(episode.result), "steps": []} for episode in played]}


def foreign_modules(root: Path) -> list[str]:
    """Return modules of the project that were loaded from elsewhere than `root`."""
    loaded = [(name, getattr(found, "__file__", None)) for name, found in sys.modules.items()]
    return sorted(
        name
        for name, file in loaded
        if name.split(".")[0] in PROJECT and file is not None and not Path(file).resolve().is_relative_to(root)
    )


@lru_cache(maxsize=1)
def _policy(model: str) -> Any:
    return module("model").Policy.load(Path(model))


@lru_cache(maxsize=1)
def _insertions(model: str, changes: str, setting: str, cells: int) -> Any:
    contract, wanted = _policy(model).contract, json.loads(setting)
    changed: dict[str, Any] = json.loads(changes)
    document: dict[str, Any] = contract.model_dump(mode="json")
    document["dsl"] |= {"mode": wanted["lock"], **changed.pop("dsl", {})}
    document["compliance"] |= changed.pop("compliance", {})
    contract_type: Any = module("contract").PolicyContract
    ceiling, reward = wanted["force_ceiling_n"], wanted["reward"]
    return module("insertion").Insertions(
        contract_type.model_validate(document | changed), cells, wanted["part"], 1, ceiling, reward, **_errors(wanted)
    )


def _errors(setting: dict[str, Any]) -> dict[str, Any]:
    """Return the argument with the errors of a setting's plant, none if it has none: an earlier tree knows of none."""
    return {"plant": module("plant").PlantErrors.from_json(setting["plant"])} if "plant" in setting else {}


def _digest(value: Any) -> str:
    return hashlib.blake2b(np.ascontiguousarray(value).tobytes(), digest_size=DIGEST_BYTES).hexdigest()


def answer(line: str) -> dict[str, Any]:
    """Serve one request.

    Raises:
        ReplayError: code of another tree was loaded.
    """
    request = json.loads(line)
    plays: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
        "sources": lambda _: sources(),
        "environment": play_environment,
        "service": play_service,
    }
    said = plays[request["play"]](request)
    foreign = foreign_modules(Path.cwd().resolve())
    if foreign:
        raise ReplayError(f"loaded from another tree: {', '.join(foreign)}")
    return said


def _end(number: int, frame: FrameType | None) -> NoReturn:
    """End in order, so that the service's processes end with this one."""
    sys.exit(1)


def main(lines: Sequence[str] | Any) -> None:
    """Answer line by line; what the project prints goes to the error stream."""
    signal.signal(signal.SIGTERM, _end)
    answers, sys.stdout = sys.stdout, sys.stderr
    for line in lines:
        print(json.dumps(answer(line)), file=answers, flush=True)


if __name__ == "__main__":
    main(sys.stdin)
