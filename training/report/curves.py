"""Learning curves: what the folders of trainings say, thinned and kept beside the results for the report."""

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
"""In the folder of the results."""
MOST_POINTS = 200
"""Of the training's own figures, per run."""


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Point(Section):
    """One evaluation as the training went on: deterministic policy, the validation's seeds.

    Attributes:
        steps: environment steps until then.
        elapsed_s: host time until then, evaluations included.
        clearance_mm: per face.
        part: peg and hole.
        conditions: distributions of its episodes.
        episodes: that the rate is of.
        success: rate.
        return_mean: of the episodes' returns, in the experiment's own reward.
    """

    steps: int
    elapsed_s: float
    clearance_mm: float
    part: str
    conditions: str
    episodes: int
    success: float
    return_mean: float


class Curve(Section):
    """One training.

    Attributes:
        experiment: its name.
        seed: of network, exploration and tasks.
        mode: what the policy observes.
        start_from: experiment, or file, whose weights it began with; None: it began from nothing.
        reward: that returns are sums of.
        machine: processor and cores of its last session.
        commit: likewise.
        steps: environment steps in all.
        elapsed_s: host time in all.
        evaluations: in order.
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
    evaluations: tuple[Point, ...]
    rollouts: tuple[tuple[int, float], ...]

    @property
    def label(self) -> str:
        """Its name, and what it began with: steps and time before that are not in its own."""
        return f"`{self.experiment}`" + (f", after `{self.start_from}`" if self.start_from else "")

    @property
    def length(self) -> tuple[int, int]:
        """Steps and evaluations: of two curves of one training the larger holds more."""
        return self.steps, len(self.evaluations)

    def reached(self, success: float, clearance_mm: float) -> Point | None:
        """The first evaluation of the triangle at a clearance with at least that success; None if there was none.

        One alone may be chance: the next one, if there is one, must have it too.
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
            Point(
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
        How many are new or longer than they were.

    Raises:
        ResultsError: a file in the place of a curve that holds none.
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
        ResultsError: a file that holds none.
    """
    return [_load(path) for path in sorted((results / FOLDER).glob("*.json"))]


def _load(path: Path) -> Curve:
    try:
        return Curve.model_validate_json(path.read_bytes())
    except ValidationError as error:
        raise ResultsError(f"{path} holds no learning curve: {error}") from error


def _records(path: Path) -> Iterator[dict[str, Any]]:
    """Lines of a progress file; one that a training is just writing is left out."""
    if path.is_file():
        for line in path.read_text().split("\n")[:-1]:
            yield json.loads(line)
