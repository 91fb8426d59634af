"""`evaluate`: measure a policy episode by episode, and keep the episodes in `results/NAME.json`."""

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, cast, get_args

import typer

from service.policy.model import Policy, PolicyError
from training.commands.refusal import refuse, refuse_without_extra
from training.environment import design
from training.environment.reward import RewardName
from training.evaluation import evaluate as evaluation
from training.evaluation import panel as panels
from training.evaluation import provenance, through_service
from training.evaluation.results import (
    HEADER,
    RESULTS,
    Block,
    EpisodeResult,
    MeasuringSession,
    Results,
    ResultsError,
    Setting,
    Through,
    exclusive,
)
from training.report import paper
from training.report.document import Document
from training.report.panels import table
from wire.limits import FORCE_CEILING_N, FORCE_HARD_MAXIMUM_N
from wire.modes import LockMode
from wire.task import Conditions, Part, Task

DEFAULT_EPISODES = 500
DEFAULT_CLEARANCES_MM = (2.0, 1.33, 0.33)
_REMEDY = "choose another --name or folder, or drop them (evaluate: --anew)"


def evaluate(
    model: Annotated[Path, typer.Argument(help="ONNX file of the policy.")],
    plan: Annotated[list[paper.TablePlan] | None, typer.Option(help="Cells of a table; may be repeated.")] = None,
    clearance: Annotated[list[float] | None, typer.Option(help="Clearance per face, mm; may be repeated.")] = None,
    part: Annotated[
        Part | None, typer.Option(help="Part to insert with --clearance; default: the policy's first.")
    ] = None,
    conditions: Annotated[
        Conditions | None,
        typer.Option(help="Conditions of an episode; default: the plan's, `search` for FTM, else `standard`."),
    ] = None,
    panel: Annotated[
        str,
        typer.Option(help="Measure on plants with errors: plant, plant-validation, or a path that ends in .toml."),
    ] = "",
    episodes: Annotated[
        int, typer.Option(min=0, help="Episodes per cell; those already there are kept. 0: 500, or as the panel says.")
    ] = 0,
    through: Annotated[
        Through,
        typer.Option(help="Player: the batched environment, or the deployed service with the simulated or a UR arm."),
    ] = "environment",
    lock: Annotated[str, typer.Option(help="Run under another lock than the policy's: paper, sliding or off.")] = "",
    reward: Annotated[RewardName, typer.Option(help="Reward that the returns sum up.")] = "paper",
    force_ceiling: Annotated[
        float, typer.Option(min=1.0, max=FORCE_HARD_MAXIMUM_N, help="Force that ends an episode, N.")
    ] = FORCE_CEILING_N,
    first_seed: Annotated[
        int | None, typer.Option(min=0, help="First seed; the others count up. Default: 2000000, or the panel's.")
    ] = None,
    workers: Annotated[
        int, typer.Option(min=0, help="Episodes played at once; 0: one per core, through RTDE one.")
    ] = 0,
    name: Annotated[str, typer.Option(help="Name of the results; default: the file's.")] = "",
    results: Annotated[Path, typer.Option(help="Folder of the results.")] = RESULTS,
    anew: Annotated[
        bool,
        typer.Option("--anew", help="Drop results of another file or of other sources."),
    ] = False,
    record: Annotated[bool, typer.Option("--record", help="Write the figures into the model's contract.")] = False,
) -> None:
    """Play fresh seeds with the deterministic policy; print successes, steps and peak forces.

    Every episode is kept as it ends. The same command again plays only the missing ones.
    """
    workers = workers or (1 if through == "rtde" else len(os.sched_getaffinity(0)))
    if lock and through != "environment":
        refuse("evaluate", "the service runs a policy under its own lock: --lock goes with --through environment")
    if lock and lock not in get_args(LockMode):
        refuse("evaluate", f"--lock must be one of {', '.join(get_args(LockMode))}, not {lock!r}")
    if panel and (plan or record):
        refuse("evaluate", "--panel goes with neither --plan nor --record")
    try:
        policy = Policy.load(model)
        plants = panels.load(panel) if panel else None
        episodes = episodes or (DEFAULT_EPISODES if plants is None else plants.episodes)
        settings = _settings(
            policy,
            plan or [],
            clearance or ([] if plants is None else list(plants.clearances_mm)),
            part,
            conditions,
            lock=lock or policy.contract.dsl.mode,
            through=through,
            reward=reward,
            force_ceiling_n=force_ceiling,
            first_seed=evaluation.FIRST_TEST_SEED if plants is None else plants.first_seed,
        )
        if first_seed is not None:
            settings = [replace(setting, first_seed=first_seed) for setting in settings]
        if plants is not None:
            settings = [
                replace(each, plant=errors, line=line) for line, errors in plants.lines.items() for each in settings
            ]
        if record:
            _check_recordable(policy, settings)
        kept_as = name or model.stem
        path = results / f"{kept_as}.json" if plants is None else plants.path(results, kept_as)
        with exclusive(path):
            measured = measure(model, policy, settings, path, episodes, workers, anew=anew)
            blocks = [measured.block(setting).first(episodes) for setting in settings]
            if record:
                _record(model, measured, path, blocks)
    except (PolicyError, ResultsError, ValueError, through_service.ServiceError) as error:
        refuse("evaluate", str(error))
    if plants is None:
        typer.echo("\n".join([HEADER, *(block.line() for block in blocks)]))
    else:
        typer.echo(Document(plants.about, [table(blocks)]).to_markdown(results))
    for episode in (e for block in blocks for e in block.episodes if e.claimed not in (None, e.success)):
        told = "succeeded" if episode.claimed else f"ended by {episode.code}"
        where = "in the hole" if episode.success else "not in the hole"
        typer.echo(f"seed {episode.seed}: the service says that it {told}, in truth the peg is {where}")
    typer.echo(f"kept in {path}")


def measure(
    model: Path,
    policy: Policy,
    settings: Sequence[Setting],
    path: Path,
    episodes: int,
    workers: int,
    *,
    anew: bool = False,
) -> Results:
    """Play the missing ones of the first `episodes` episodes of each setting, with a bar on the terminal.

    Args:
        model: file of the policy.
        policy: the policy in that file.
        settings: settings to measure.
        path: file of the results, which keeps every episode as it ends; the caller holds `exclusive` of it.
        episodes: number of episodes per setting.
        workers: number of players at once.
        anew: drop episodes in the file that are of another policy or of other sources.

    Returns:
        Everything that the file holds afterwards.

    Raises:
        ResultsError: the file holds results of another policy or of other sources.
        ServiceError: the service or the simulator failed.
    """
    by_service = any(setting.through != "environment" for setting in settings)
    known = _known(policy, path, provenance.deployed_sources() if by_service else None, anew=anew)
    keep = _Keeper(known, path, workers)
    wanted = [known.block(setting) for setting in settings]
    missing = sum(len(block.missing(episodes)) for block in wanted)
    if missing and (keep.commit or "").endswith(provenance.DIRTY):
        typer.echo("the code is not as committed, and the results will say so", err=True)
    with typer.progressbar(length=missing, label=path.stem) as bar:
        keep.on_kept = bar.update
        _play(model, policy, wanted, episodes, workers, keep)
    return keep.results


class _Keeper:
    """Keeper of episodes: writes each to the file as it ends."""

    def __init__(self, results: Results, path: Path, workers: int) -> None:
        self.results = results
        self.on_kept: Callable[[int], object] = lambda _: None
        self._path = path
        self._workers = workers
        self.commit = provenance.commit()
        self._before = results
        self._last = time.monotonic()

    def __call__(self, setting: Setting, episodes: Sequence[EpisodeResult]) -> None:
        now = time.monotonic()
        block = self.results.block(setting)
        earlier = self._before.block(setting).sessions
        mine = block.sessions[len(earlier) :]
        session = MeasuringSession(
            ended=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
            commit=self.commit,
            machine=provenance.machine(),
            versions=provenance.versions(),
            workers=self._workers,
            episodes=len(episodes) + sum(s.episodes for s in mine),
            wall_s=round(now - self._last + sum(s.wall_s for s in mine), 3),
        )
        self._last = now
        block = block.with_episodes(episodes).model_copy(update={"sessions": (*earlier, session)})
        self.results = self.results.with_block(block)
        self.results.save(self._path)
        self.on_kept(len(episodes))


def _settings(
    policy: Policy,
    plans: Sequence[paper.TablePlan],
    clearances: Sequence[float],
    part: Part | None,
    conditions: Conditions | None,
    **rest: Any,
) -> list[Setting]:
    """Return the settings to measure, each once; raise ValueError for one that no world can be built from."""
    contract = policy.contract
    own = cast(Part, contract.parts[0])
    cells: list[tuple[Part, float, Conditions]] = []
    for plan in plans:
        cells += paper.cells_of(plan, contract.mode)
    if not plans or clearances:
        drawn = paper.conditions_for(contract.mode)
        for level in clearances or DEFAULT_CLEARANCES_MM:
            cells.append((part or own, paper.metres(level), drawn))
    settings = [
        Setting(part=shape, clearance_m=clearance, conditions=conditions or drawn, **rest)
        for shape, clearance, drawn in cells
    ]
    for setting in settings:
        design.check_conditions(contract.mode, setting.conditions)
        Task(setting.first_seed, setting.part, setting.clearance_m, setting.conditions).check()
        evaluation.with_lock(contract, setting)
    return list(dict.fromkeys(settings))


def _check_recordable(policy: Policy, settings: Sequence[Setting]) -> None:
    """Raise ValueError for settings beyond clearance and conditions, which a contract's figures cannot name."""
    usual = {
        "part": policy.contract.parts[0],
        "lock": policy.contract.dsl.mode,
        "through": "environment",
        "force_ceiling_n": FORCE_CEILING_N,
        "first_seed": evaluation.FIRST_TEST_SEED,
    }
    if any(getattr(setting, name) != value for setting in settings for name, value in usual.items()):
        raise ValueError(
            f"--record is for {usual['part']!r} under the policy's own lock in the environment, with the test's seeds "
            f"and a ceiling of {usual['force_ceiling_n']:g} N: the contract's figures name nothing of that"
        )


def _known(policy: Policy, path: Path, deployed: str | None, *, anew: bool) -> Results:
    """Return the policy's results in the file, or empty ones; `deployed` is the digest of a service about to add."""
    contract = policy.contract
    fresh = Results(
        policy=contract.name,
        sha256=policy.sha256,
        sources=provenance.sources(),
        deployed_sources=deployed,
        mode=contract.mode,
        lock=contract.dsl.mode,
        period_s=contract.period_s,
        max_steps=contract.max_steps,
        stiffness=contract.compliance.stiffness,
        press_m=contract.dsl.press_m,
        seek_step_m=contract.dsl.seek_step_m,
        provenance=contract.provenance,
    )
    if not path.exists():
        return fresh
    known = Results.load(path)
    if anew and (known.sha256, known.sources) != (fresh.sha256, fresh.sources):
        return fresh
    if known.sha256 != policy.sha256:
        raise ResultsError(
            f"{path} holds results of another file (SHA-256 {known.sha256[:12]}…, this one is {policy.sha256[:12]}…): "
            + _REMEDY
        )
    if known.sources != fresh.sources:
        raise ResultsError(
            f"{path} holds results of an earlier world, arm, lock or criterion (SHA-256 of the sources "
            f"{known.sources[:12]}…, now {fresh.sources[:12]}…), which do not go together with new ones: {_REMEDY}"
        )
    if deployed is None:
        return known
    if known.deployed_sources not in (None, deployed):
        if not anew:
            raise ResultsError(
                f"{path} holds results through an earlier service (SHA-256 of the sources "
                f"{known.deployed_sources[:12]}…, now {deployed[:12]}…), which do not go together with new ones: "
                + _REMEDY
            )
        known = known.without_service()
    return known.model_copy(update={"deployed_sources": deployed})


def _play(model: Path, policy: Policy, blocks: Sequence[Block], episodes: int, workers: int, keep: _Keeper) -> None:
    jobs = [job for block in blocks for job in evaluation.jobs_of(model, policy.sha256, block, episodes)]
    batched = [job for job in jobs if job.setting.through == "environment"]
    deployed = [job for job in jobs if job.setting.through != "environment"]
    for setting, played in evaluation.measure(batched, workers):
        keep(setting, played)
    for setting, episode in through_service.measure(deployed, workers):
        if provenance.deployed_sources() != keep.results.deployed_sources:
            raise ResultsError(
                "the service's sources changed while it was measured: the same command goes on with --anew"
            )
        keep(setting, [episode])


def _record(model: Path, results: Results, path: Path, blocks: Sequence[Block]) -> None:
    """Write figures into the model's contract, and the new digest of its file into the results."""
    try:
        from training.learning.export import record_evaluation
    except ImportError as error:
        refuse_without_extra("evaluate", error)
    policy = record_evaluation(model, [block.figure() for block in blocks])
    results.model_copy(update={"sha256": policy.sha256}).save(path)
    typer.echo(f"recorded in {model}, whose SHA-256 is now {policy.sha256}")
