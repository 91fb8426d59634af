"""Learning curves: read from the folders of trainings, thinned, and kept beside the results for the report."""

import json
from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, ValidationError

from service.policy.observation import ObservationMode
from training import files
from training.evaluation.results import ResultsError

FOLDER = "curves"
"""Folder of the curves within the folder of the results."""
MOST_POINTS = 200
"""Largest number of the training's own figures kept per training."""


class CurveSection(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class CurvePoint(CurveSection):
    """One evaluation as the training went on: deterministic policy, the validation's seeds.

    Attributes:
        steps: environment steps until then.
        elapsed_s: host time until then, evaluations included.
        clearance_mm: clearance per face.
        part: peg and hole.
        conditions: distributions of its episodes.
        episodes: number of episodes.
        success: success rate.
        return_mean: mean return, in the experiment's own reward.
    """

    steps: int
    elapsed_s: float
    clearance_mm: float
    part: str
    conditions: str
    episodes: int
    success: float
    return_mean: float


class Curve(CurveSection):
    """One training.

    Attributes:
        experiment: name of the experiment.
        seed: seed of network, exploration and tasks.
        mode: observation mode of the policy.
        start_from: experiment, or file, whose weights it began with; None: it began from nothing.
        reward: reward whose sums are the returns.
        machine: processor and cores of its last session.
        commit: commit of its last session.
        steps: environment steps in all.
        elapsed_s: host time in all.
        evaluations: evaluations in order.
        rollouts: steps, and success while exploring, of at most `MOST_POINTS` updates.
    """

    experiment: str
    seed: int
    mode: ObservationMode
    start_from: str | None
    reward: str
    machine: str
    commit: str | None
    steps: int
    elapsed_s: float
    evaluations: tuple[CurvePoint, ...]
    rollouts: tuple[tuple[int, float], ...]

    @property
    def label(self) -> str:
        """Name of the experiment, and the weights it began with, whose steps and time it does not include."""
        return f"`{self.experiment}`" + (f", after `{self.start_from}`" if self.start_from else "")

    @property
    def length(self) -> tuple[int, int]:
        """Steps and evaluations; of two curves of one training the larger pair holds more."""
        return self.steps, len(self.evaluations)

    def reached(self, success: float, clearance_mm: float) -> CurvePoint | None:
        """Return the first evaluation of the triangle at a clearance with at least that success; None if there is none.

        One evaluation alone may be chance, so the next one, if there is one, must reach it too.
        """
        judged = [point for point in self.evaluations if point.part == "tr" and point.clearance_mm == clearance_mm]
        pairs = zip_longest(judged, judged[1:])
        return next(
            (
                point
                for point, after in pairs
                if point.success >= success and (after is None or after.success >= success)
            ),
            None,
        )

    @classmethod
    def of_run(cls, directory: Path) -> Self | None:
        """Read the folder of a training; None before its first line."""
        records = list(_records(directory / "progress.jsonl"))
        if not records:
            return None
        account = json.loads((directory / "run.json").read_text())
        experiment, session = account["experiment"], account["sessions"][-1]
        began_with = account["sessions"][0].get("began_with", {})
        evaluations = tuple(
            CurvePoint(
                steps=record["steps"],
                elapsed_s=record["elapsed_s"],
                clearance_mm=round(record["clearance_m"] * 1e3, 3),
                part=record["part"],
                conditions=record["conditions"],
                episodes=record["episodes"],
                success=record["successes"] / record["episodes"],
                return_mean=record["return_mean"],
            )
            for record in records
            if record["kind"] == "evaluation"
        )
        updates = [(r["steps"], round(r["success"], 4)) for r in records if r["kind"] == "rollout" and "success" in r]
        return cls(
            experiment=experiment["name"],
            seed=account["seed"],
            mode=experiment["task"]["mode"],
            start_from=began_with.get("experiment", began_with.get("file", experiment["start_from"])),
            reward=experiment["task"]["reward"],
            machine=session["machine"],
            commit=session["commit"],
            steps=records[-1]["steps"],
            elapsed_s=records[-1]["elapsed_s"],
            evaluations=evaluations,
            rollouts=tuple(updates[:: -(-len(updates) // MOST_POINTS) or 1]),
        )


def collect(runs: Path, results: Path) -> int:
    """Keep a curve of each training under `runs` beside the results, unless a longer one of it is there.

    Returns:
        Number of curves that are new or longer than before.

    Raises:
        ResultsError: a file where a curve belongs holds none.
    """
    written = 0
    for directory in sorted(runs.glob("*/seed-*")):
        curve = Curve.of_run(directory)
        if curve is None:
            continue
        path = results / FOLDER / f"{curve.experiment}-seed-{curve.seed}.json"
        if not path.exists() or _load(path).length < curve.length:
            files.write(path, curve.model_dump_json().encode() + b"\n")
            written += 1
    return written


def load(results: Path) -> list[Curve]:
    """Read the curves that are kept beside the results.

    Raises:
        ResultsError: a file holds none.
    """
    return [_load(path) for path in sorted((results / FOLDER).glob("*.json"))]


def _load(path: Path) -> Curve:
    try:
        return Curve.model_validate_json(path.read_bytes())
    except ValidationError as error:
        raise ResultsError(f"{path} holds no learning curve: {error}") from error


def _records(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the lines of a progress file, without one that a training is just writing."""
    if path.is_file():
        for line in path.read_text().split("\n")[:-1]:
            yield json.loads(line)
