"""Results as data: the episodes of one policy, which `evaluate` writes and `report` reads.

Each policy has one file, `results/NAME.json`. A file holds no summaries: rates, intervals and percentiles are computed
from the episodes whenever they are shown.
"""

import fcntl
import json
import math
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, Self, cast

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    JsonValue,
    ValidationError,
    field_serializer,
    field_validator,
    model_validator,
)

from service.policy.contract import EvaluationFigure
from service.policy.observation import ObservationMode
from training import files
from training.environment.reward import RewardName
from wire.limits import FORCE_CEILING_N
from wire.modes import LockMode
from wire.plant import PlantErrors
from wire.task import Conditions, Part

RESULTS = Path("results")
SCHEMA_VERSION = 1
WILSON_Z = 1.959964
"""Quantile of the normal distribution for a 95 % interval."""
Through = Literal["environment", "zenoh", "rtde"]
"""Player of episodes: the batched environment, or the deployed service with the simulated arm over Zenoh or with an
emulated UR controller over RTDE."""


class ResultsError(ValueError):
    """A results file cannot be read, is in use, or belongs to another policy or other sources."""


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Return the 95 % Wilson score interval of a proportion (Wilson 1927).

    Raises:
        ValueError: there are no trials.
    """
    if trials < 1:
        raise ValueError("an interval needs at least one trial")
    z2 = WILSON_Z**2
    share = successes / trials
    centre = (share + z2 / (2 * trials)) / (1 + z2 / trials)
    half = WILSON_Z / (1 + z2 / trials) * math.sqrt(share * (1 - share) / trials + z2 / (4 * trials**2))
    return max(0.0, centre - half), min(1.0, centre + half)


@dataclass(frozen=True, slots=True)
class EpisodeResult:
    """Result of one episode.

    Attributes:
        seed: seed of its world.
        success: the peg was in: the paper's 2.5 mm deep, its axis inside the hole.
        fault: the force ceiling, or another fault, stopped it.
        steps: number of policy steps.
        peak_force_n: largest resultant over every 2 ms sample.
        episode_return: sum of its rewards; None through the service, which counts none.
        success_10mm: the policy, left on, also went 10 mm deep within its time; None: it was not left on.
        claimed: success as the service reports it; None: no service ran.
        code: the service's reason for a run that did not succeed.
    """

    seed: int
    success: bool
    fault: bool
    steps: int
    peak_force_n: float
    episode_return: float | None = None
    success_10mm: bool | None = None
    claimed: bool | None = None
    code: str | None = None


class ResultsSection(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """Setting of a measurement.

    Attributes:
        part: peg and hole.
        clearance_m: clearance per face.
        conditions: distributions of an episode, `docs/reference/conditions.md`.
        lock: lock that it ran with; the contract's own unless another one was put in its place.
        through: player of the episodes.
        reward: reward whose sums are the returns.
        force_ceiling_n: resultant at which an episode ends.
        first_seed: first seed; the others follow it.
        plant: errors of the plant; None: it has none.
        line: name of the line of a panel; empty: it belongs to none.
    """

    part: Part
    clearance_m: float
    conditions: Conditions
    lock: LockMode
    through: Through = "environment"
    reward: RewardName = "paper"
    force_ceiling_n: float = FORCE_CEILING_N
    first_seed: int
    plant: PlantErrors | None = None
    line: str = ""


class MeasuringSession(ResultsSection):
    """One stretch of measuring.

    Attributes:
        ended: date and time, UTC.
        commit: commit of this project.
        machine: processor and cores.
        versions: versions of Python and the packages that matter.
        workers: number of players at once: processes of the batched environment, or services.
        episodes: number of episodes played in it.
        wall_s: duration.
    """

    ended: str
    commit: str | None
    machine: str
    versions: dict[str, str]
    workers: int
    episodes: int
    wall_s: float


class Replay(ResultsSection):
    """Episodes that were played again with earlier and with later sources.

    Attributes:
        through: player of the episodes.
        policy: name of the policy's file: the measured policy, or one that stands in for it.
        compared: the quantities that were compared.
        blocks: number of settings.
        episodes: number of episodes played with either sources.
        agreed: number of episodes that agree.
        as_on_file: number of episodes whose every figure is that on file; None: another policy stood in.
    """

    through: Through
    policy: str
    compared: str
    blocks: int
    episodes: int
    agreed: int
    as_on_file: int | None


class Carried(ResultsSection):
    """One change of the sources that results were carried over, because it alters no episode.

    Attributes:
        date: date and time, UTC.
        from_sources: `sources` before.
        to_sources: `sources` after.
        from_deployed_sources: `deployed_sources` before; None: episodes through the service were not carried.
        to_deployed_sources: `deployed_sources` after.
        from_commit: revision before.
        to_commit: revision after.
        machine: processor and cores that played the episodes.
        versions: versions of Python and the packages that matter.
        replays: the episodes that were played and compared.
    """

    date: str
    from_sources: str
    to_sources: str
    from_deployed_sources: str | None
    to_deployed_sources: str | None
    from_commit: str | None
    to_commit: str | None
    machine: str
    versions: dict[str, str]
    replays: tuple[Replay, ...]


class Block(ResultsSection):
    """Episodes under one setting, in the order of their seeds."""

    setting: Setting
    sessions: tuple[MeasuringSession, ...] = ()
    episodes: tuple[EpisodeResult, ...] = ()

    @field_serializer("setting")
    def _to_document(self, setting: Setting) -> dict[str, JsonValue]:
        document = asdict(setting) | {"plant": None if setting.plant is None else setting.plant.to_json()}
        return {name: value for name, value in document.items() if value or name not in ("plant", "line")}

    @field_validator("episodes", mode="before")
    @classmethod
    def _from_columns(cls, value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        columns = cast(dict[str, list[Any]], value)
        if len({len(column) for column in columns.values()}) > 1:
            raise ValueError("the columns differ in length")
        return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]

    @field_serializer("episodes")
    def _to_columns(self, episodes: tuple[EpisodeResult, ...]) -> dict[str, list[JsonValue]]:
        rows = [asdict(episode) for episode in episodes]
        return {name: [rounded(row[name]) for row in rows] for name in EpisodeResult.__slots__}

    @property
    def successes(self) -> int:
        return sum(e.success for e in self.episodes)

    @property
    def rate(self) -> float:
        return self.successes / len(self.episodes)

    @property
    def interval(self) -> tuple[float, float]:
        """95 % Wilson interval of the success rate."""
        return wilson(self.successes, len(self.episodes))

    @property
    def peaks(self) -> tuple[float, float, float]:
        """Median, 99th percentile and maximum of the episodes' peak forces, N."""
        median, high, most = np.percentile([e.peak_force_n for e in self.episodes], [50, 99, 100])
        return float(median), float(high), float(most)

    @property
    def wall_s(self) -> float:
        return sum(session.wall_s for session in self.sessions)

    def first(self, count: int) -> "Block":
        """Return this block with its first `count` episodes only."""
        return self.model_copy(update={"episodes": self.episodes[:count]})

    def unbroken(self) -> "Block":
        """Return this block up to the first seed that was not played."""
        first = self.setting.first_seed
        return self.model_copy(
            update={"episodes": tuple(e for n, e in enumerate(self.episodes) if e.seed == first + n)}
        )

    def missing(self, count: int) -> list[int]:
        """Return the seeds of the first `count` that have not been played."""
        played = {episode.seed for episode in self.episodes}
        first = self.setting.first_seed
        return [seed for seed in range(first, first + count) if seed not in played]

    def with_episodes(self, more: Iterable[EpisodeResult]) -> "Block":
        """Return this block with more episodes; an episode played again replaces the old one."""
        episodes = {e.seed: e for e in (*self.episodes, *more)}
        return self.model_copy(update={"episodes": tuple(episodes[seed] for seed in sorted(episodes))})

    def figure(self) -> EvaluationFigure:
        """Return the figure for the policy's contract."""
        low, high = self.interval
        median, _, most = self.peaks
        return EvaluationFigure(
            clearance_m=self.setting.clearance_m,
            conditions=self.setting.conditions,
            episodes=len(self.episodes),
            successes=self.successes,
            low=round(low, 6),
            high=round(high, 6),
            peak_force_median_n=round(median, 2),
            peak_force_max_n=round(most, 2),
        )

    def line(self) -> str:
        """Return one row of `HEADER`'s table."""
        setting = self.setting
        low, high = self.interval
        median, p99, most = self.peaks
        steps = np.mean([e.steps for e in self.episodes])
        success = f"{self.successes}/{len(self.episodes)} = {self.rate:.1%} ({low:.1%} to {high:.1%})"
        return (
            f"| {setting.clearance_m * 1e3:.2f} | {setting.part} | {setting.conditions} | {success} | {steps:.0f} | "
            f"{median:.1f} / {p99:.1f} / {most:.1f} | {sum(e.fault for e in self.episodes)} |"
        )


HEADER = (
    "| clearance, mm | part | conditions | success (95 % interval) | mean steps "
    "| peak force median/p99/max, N | faults |\n|---|---|---|---|---|---|---|"
)


class Results(ResultsSection):
    """All measurements of one policy.

    Attributes:
        schema_version: version of this document.
        policy: name in its contract.
        sha256: digest of its file.
        sources: digest of the sources that decide an episode, `provenance.sources`: another world, arm, lock or
            criterion makes other results.
        deployed_sources: digest for the episodes through the service, `provenance.deployed_sources`; None: there are
            none.
        mode: observation mode.
        lock: lock of its contract.
        period_s: time between two actions.
        max_steps: largest number of steps of an episode.
        stiffness: stiffness of its compliance law, N/m and N·m/rad about x, y, z.
        press_m: largest distance of a command below the lock.
        seek_step_m: the lock's increment downwards before contact.
        provenance: provenance in its contract: the account of its training.
        carried: changes of the sources since the episodes were played, oldest first.
        blocks: one per setting.
    """

    schema_version: Literal[1] = SCHEMA_VERSION
    policy: str
    sha256: str
    sources: str
    deployed_sources: str | None = None
    mode: ObservationMode
    lock: LockMode
    period_s: float
    max_steps: int
    stiffness: tuple[float, float, float, float, float, float]
    press_m: float
    seek_step_m: float
    provenance: dict[str, JsonValue]
    carried: tuple[Carried, ...] = ()
    blocks: tuple[Block, ...] = ()

    @model_validator(mode="after")
    def _service_is_known(self) -> Self:
        if self.deployed_sources is None and any(block.setting.through != "environment" for block in self.blocks):
            raise ValueError("episodes through the service, but not of which sources (deployed_sources)")
        return self

    def block(self, setting: Setting) -> Block:
        """Return the block of a setting, an empty one if nothing was measured."""
        return next((block for block in self.blocks if block.setting == setting), Block(setting=setting))

    def with_block(self, block: Block) -> Self:
        """Return these results with a block that replaces the one of its setting, or follows the others."""
        settings = [known.setting for known in self.blocks]
        blocks = list(self.blocks)
        if block.setting in settings:
            blocks[settings.index(block.setting)] = block
        else:
            blocks.append(block)
        return self.model_copy(update={"blocks": tuple(blocks)})

    def unbroken(self) -> Self:
        """Return these results with each block up to the first seed that was not played: short episodes end first."""
        return self.model_copy(update={"blocks": tuple(block.unbroken() for block in self.blocks)})

    def without_service(self) -> Self:
        """Return these results without the blocks through the service."""
        kept = tuple(block for block in self.blocks if block.setting.through == "environment")
        return self.model_copy(update={"blocks": kept, "deployed_sources": None})

    def save(self, path: Path) -> None:
        """Write the file at once or not at all, one line per column, so that a difference can be read."""
        files.write(path, f"{_laid_out(self.model_dump(mode='json'), 0)}\n".encode())

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a file.

        Raises:
            ResultsError: the file cannot be read or holds something else.
        """
        try:
            return cls.model_validate_json(path.read_bytes())
        except (OSError, ValidationError) as error:
            raise ResultsError(f"{path} holds no results: {error}") from error


def rounded(value: Any) -> JsonValue:
    """Return a value of an episode as a file holds it."""
    if isinstance(value, bool):
        return int(value)
    return round(value, 3) if isinstance(value, float) else value


@contextmanager
def exclusive(path: Path) -> Generator[None]:
    """Keep other processes from adding to a results file while the context lasts.

    Raises:
        ResultsError: another process is adding to it.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.with_name(f".{path.stem}.lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ResultsError(
                f"another process is measuring into {path}: wait until it has ended, or choose another --name"
            ) from None
        yield


def _laid_out(value: Any, depth: int) -> str:
    """Return JSON with objects and lists of objects over several lines, and lists of numbers on one."""
    inner, outer = "\n" + " " * (depth + 1), "\n" + " " * depth
    if isinstance(value, dict) and value:
        items = cast(dict[str, Any], value)
        lines = [f"{json.dumps(key)}: {_laid_out(item, depth + 1)}" for key, item in items.items()]
        return "{" + inner + ("," + inner).join(lines) + outer + "}"
    if isinstance(value, list) and value and isinstance(value[0], dict):
        members = cast(list[Any], value)
        return "[" + inner + ("," + inner).join(_laid_out(item, depth + 1) for item in members) + outer + "]"
    return json.dumps(value, separators=(",", ":"), allow_nan=False)
