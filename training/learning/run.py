"""The folder of one training: its settings, its progress and its checkpoints.

| file | holds |
|---|---|
| `run.json` | experiment, contract, seed; of each session time, commit, versions, machine; initial weights |
| `progress.jsonl` | one line per update and per evaluation |
| `checkpoint.pt` | state from which the training goes on, written after every update |
| `best.pt` | weights that did best in an evaluation |
| `tensorboard/` | figures of `progress.jsonl` |
"""

import hashlib
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import torch

from service.policy.contract import PolicyContract
from training import files
from training.evaluation import provenance
from training.learning.experiment import Experiment, ExperimentError

RUNS = Path("var/training")
FREE_TO_CHANGE = {"title", "seeds", "evaluation", "admitted"}
"""Parts of an experiment that may change while a training is under way; so may `algorithm.steps`."""


class CheckpointError(ValueError):
    """A file of weights cannot be read or is not for this experiment."""


class TrainingRun:
    """The folder of one experiment and seed; it may hold a training under way.

    Args:
        experiment: experiment to train.
        seed: seed of network, exploration and tasks.
        directory: the folder; None: `var/training/EXPERIMENT/seed-N`.
    """

    def __init__(self, experiment: Experiment, seed: int, directory: Path | None = None) -> None:
        self.experiment = experiment
        self.seed = seed
        self.directory = directory or directory_of(experiment.name, seed)
        self.checkpoint = self.directory / "checkpoint.pt"
        self.best = self.directory / "best.pt"
        self._progress = self.directory / "progress.jsonl"
        self._document = self.directory / "run.json"

    def open(self, steps: int, began_with: dict[str, Any] | None = None) -> None:
        """Begin a session: note it, and drop progress that was made after the checkpoint.

        Args:
            steps: environment steps at which it begins.
            began_with: `beginning` of the weights that the training begins with; None: it begins with none.

        Raises:
            ExperimentError: the experiment is no longer the one that this training began with.
        """
        self.directory.mkdir(parents=True, exist_ok=True)
        document: dict[str, Any] = {"sessions": []}
        if steps:
            document = json.loads(self._document.read_text())
            changed = list(_changes(document["experiment"], self._described()))
            if changed:
                raise ExperimentError(
                    f"{self.directory} was begun with other settings ({', '.join(changed)}): "
                    "move it away, or give the experiment another name"
                )
        document |= {
            "experiment": self._described(),
            "contract": self.experiment.contract().model_dump(mode="json"),
            "seed": self.seed,
        }
        document["sessions"].append(
            {
                "steps": steps,
                "began": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
                "commit": provenance.commit(),
                "machine": provenance.machine(),
                "versions": provenance.versions(),
            }
            | ({} if began_with is None else {"began_with": began_with})
        )
        files.write(self._document, (json.dumps(document, indent=2) + "\n").encode())
        kept = [line for line in self.records() if line["steps"] <= steps] if steps else []
        files.write(self._progress, "".join(json.dumps(line) + "\n" for line in kept).encode())

    def add(self, record: dict[str, Any]) -> None:
        """Append a line to `progress.jsonl`."""
        with self._progress.open("a") as file:
            file.write(json.dumps(record) + "\n")

    def records(self) -> list[dict[str, Any]]:
        """Return the lines of `progress.jsonl` without a last one that was cut off."""
        if not self._progress.is_file():
            return []
        lines = self._progress.read_text().split("\n")[:-1]
        return [json.loads(line) for line in lines]

    @property
    def steps(self) -> int:
        """Environment steps trained so far."""
        return read(self.checkpoint)["steps"] if self.checkpoint.is_file() else 0

    @property
    def began_with(self) -> dict[str, Any] | None:
        """Return `beginning` of the weights that the training began with; None: none, or none are noted."""
        return json.loads(self._document.read_text())["sessions"][0].get("began_with")

    def _described(self) -> dict[str, Any]:
        return self.experiment.model_dump(mode="json")


def directory_of(name: str, seed: int) -> Path:
    """Return the folder of an experiment's training with this seed."""
    return RUNS / name / f"seed-{seed}"


def save(path: Path, document: dict[str, Any]) -> None:
    """Write tensors and plain values to a file, at once or not at all."""
    files.write_by(path, lambda fresh: torch.save(document, fresh))


def read(path: Path) -> dict[str, Any]:
    """Read a file that `save` wrote; it holds at least the weights `net` and the `steps` that they were trained.

    Raises:
        CheckpointError: the file does not exist or holds something else.
    """
    try:
        document = torch.load(path, map_location="cpu", weights_only=True)
        if not {"net", "steps"} <= document.keys():
            raise CheckpointError(f"{path} holds no network")
    except CheckpointError:
        raise
    except FileNotFoundError as error:
        raise CheckpointError(f"there is no {path}") from error
    except Exception as error:  # whatever unpickling raises
        raise CheckpointError(f"cannot read {path}: {error}") from error
    return document


def account_beside(path: Path) -> dict[str, Any]:
    """Return the account of a training from the `run.json` beside its weights; empty if there is none."""
    document = path.with_name("run.json")
    if not document.is_file():
        return {}
    account = json.loads(document.read_text())
    return {name: account[name] for name in ("experiment", "seed", "sessions")}


def beginning(path: Path) -> dict[str, Any]:
    """Return the note on weights to begin with: file, steps, digest and, if known, experiment and seed."""
    account = account_beside(path)
    whose = {"experiment": account["experiment"]["name"], "seed": account["seed"]} if account else {}
    data = {"steps": read(path)["steps"], "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
    return {"file": path.name, **whose, **data}


def contract_in(document: dict[str, Any]) -> PolicyContract | None:
    """Return the contract that a checkpoint was trained under; None if it names none."""
    return PolicyContract.from_json(document["contract"]) if "contract" in document else None


def _changes(before: dict[str, Any], now: dict[str, Any], under: str = "") -> Iterator[str]:
    """Yield the names of settings that differ although they must not."""
    for name in sorted(before.keys() | now.keys()):
        full = under + name
        if full in FREE_TO_CHANGE or full == "algorithm.steps":
            continue
        old, new = before.get(name), now.get(name)
        if isinstance(old, dict) and isinstance(new, dict):
            yield from _changes(cast("dict[str, Any]", old), cast("dict[str, Any]", new), full + ".")
        elif old != new:
            yield full
