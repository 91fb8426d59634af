"""Evaluation of a deterministic policy by independent episodes on seeds that no training uses."""

from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, replace
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Protocol

import numpy as np

from service.policy.contract import PolicyContract
from service.policy.model import Policy
from training.environment.insertion import Insertions
from training.environment.reward import RewardName
from training.evaluation.results import Block, EpisodeResult, Setting
from wire.arrays import Float32Array
from wire.limits import FORCE_CEILING_N
from wire.task import Conditions, Part, Task

FIRST_TEST_SEED = 2_000_000
"""First of the test's seeds. Seeds below choose between models; seeds of training are above 2³²."""
AUTHOR_DEPTH_M = 10e-3
"""Depth that the paper's author's code calls success."""
CELLS = 25
"""Largest number of episodes of one job; the environment steps them together, the service one after another."""


class Actor(Protocol):
    """A chooser of actions: `service.policy.model.Policy`, or a network in training."""

    def initial_hidden(self, shape: tuple[int, ...] = ()) -> Float32Array | None: ...
    def act(
        self, observation: Float32Array, hidden: Float32Array | None = None
    ) -> tuple[Float32Array, Float32Array | None]: ...


@dataclass(frozen=True, slots=True)
class Job:
    """Seeds of one setting for one process."""

    model: Path
    sha256: str
    setting: Setting
    seeds: tuple[int, ...]


def evaluate(
    policy: Policy,
    clearance_m: float,
    episodes: int = 500,
    *,
    part: Part = "tr",
    conditions: Conditions = "standard",
    first_seed: int = FIRST_TEST_SEED,
    cells: int = 100,
    threads: int = 0,
    force_ceiling_n: float = FORCE_CEILING_N,
    reward_name: RewardName = "potential",
) -> Block:
    """Play `episodes` episodes, with seeds from `first_seed` up, one after another in each of `cells` cells.

    Every cell plays the same number of episodes: a window of time would count fast successes more often.

    Raises:
        ValueError: the episodes do not divide evenly over the cells.
    """
    cells = min(cells, episodes)
    if episodes % cells:
        raise ValueError(f"{episodes} episodes do not divide evenly over {cells} cells")
    insertions = Insertions(policy.contract, cells, part, threads, force_ceiling_n, reward_name)
    results: list[EpisodeResult] = []
    for begin in range(first_seed, first_seed + episodes, cells):
        tasks = [Task(begin + i, part, clearance_m, conditions) for i in range(cells)]
        results += play(policy, insertions, tasks)
    setting = Setting(
        part=part,
        clearance_m=clearance_m,
        conditions=conditions,
        lock=policy.contract.dsl.mode,
        reward=reward_name,
        force_ceiling_n=force_ceiling_n,
        first_seed=first_seed,
    )
    return Block(setting=setting, episodes=tuple(results))


def play(
    actor: Actor, insertions: Insertions, tasks: Sequence[Task], *, to_author_depth: bool = False
) -> list[EpisodeResult]:
    """Play one episode in every cell; a cell that has finished idles until the others have.

    Args:
        actor: chooser of the actions.
        insertions: as many cells as tasks.
        tasks: tasks of the episodes.
        to_author_depth: leave the policy on after an episode's end until the peg is `AUTHOR_DEPTH_M` deep or the time
            is up; all other figures are those of the end.
    """
    n = insertions.n
    observation = insertions.reset(np.arange(n), tasks)
    hidden = actor.initial_hidden((n,))
    moving = np.ones(n, np.bool_)
    results: dict[int, EpisodeResult] = {}
    returns = np.zeros(n)
    while moving.any():
        action, hidden = actor.act(observation, hidden)
        outcome = insertions.step(np.where(moving[:, None], action, 0.0))
        observation = outcome.observation
        returns += outcome.reward
        ended = outcome.terminated | outcome.truncated
        for cell in np.flatnonzero(ended).tolist():
            if cell not in results:
                results[cell] = EpisodeResult(
                    seed=tasks[cell].seed,
                    success=bool(outcome.success[cell]),
                    fault=bool(outcome.fault[cell]),
                    steps=int(insertions.steps[cell]),
                    peak_force_n=float(outcome.peak_force[cell]),
                    episode_return=float(returns[cell]),
                    success_10mm=False if to_author_depth else None,
                )
        stopped = ended
        if to_author_depth:
            deep = (outcome.depth >= AUTHOR_DEPTH_M) & insertions.world.contained & ~outcome.fault
            for cell in np.flatnonzero(deep & moving).tolist():
                results[cell] = replace(results[cell], success_10mm=True)
            stopped = deep | outcome.fault | (insertions.steps >= insertions.contract.max_steps)
        insertions.world.stop(np.flatnonzero(moving & stopped))
        moving &= ~stopped
    return [results[cell] for cell in range(n)]


def measure(jobs: Sequence[Job], workers: int) -> Iterator[tuple[Setting, list[EpisodeResult]]]:
    """Play jobs in `workers` processes and yield the episodes of each job as it ends."""
    if workers == 1:
        for job in jobs:
            yield job.setting, _run(job)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        waiting: set[Future[list[EpisodeResult]]] = set()
        settings: dict[Future[list[EpisodeResult]], Setting] = {}
        try:
            for job in jobs:
                future = pool.submit(_run, job)
                settings[future] = job.setting
                waiting.add(future)
            while waiting:
                done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                for future in done:
                    yield settings[future], future.result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def jobs_of(model: Path, sha256: str, block: Block, episodes: int) -> list[Job]:
    """Return jobs for the missing ones of a block's first `episodes` episodes, in shares of `CELLS`."""
    seeds = block.missing(episodes)
    return [
        Job(model, sha256, block.setting, tuple(seeds[begin : begin + CELLS])) for begin in range(0, len(seeds), CELLS)
    ]


def with_lock(contract: PolicyContract, setting: Setting) -> PolicyContract:
    """Return the contract under the setting's lock, for which the policy may not have been trained.

    Raises:
        ValueError: the contract does not go together with the lock, as mode VM with any but `off`.
    """
    if setting.lock == contract.dsl.mode:
        return contract
    document = contract.model_dump() | {"dsl": replace(contract.dsl, mode=setting.lock)}
    return PolicyContract.model_validate(document)


@lru_cache(maxsize=1)
def _policy(model: Path, sha256: str) -> Policy:
    return Policy.load(model, expected_sha256=sha256)


@lru_cache(maxsize=1)
def _insertions(model: Path, sha256: str, setting: Setting, cells: int) -> Insertions:
    contract = with_lock(_policy(model, sha256).contract, setting)
    return Insertions(contract, cells, setting.part, 1, setting.force_ceiling_n, setting.reward)


def _run(job: Job) -> list[EpisodeResult]:
    setting = job.setting
    tasks = [
        Task(seed, setting.part, setting.clearance_m, setting.conditions, plant=setting.plant) for seed in job.seeds
    ]
    insertions = _insertions(job.model, job.sha256, setting, len(tasks))
    return play(_policy(job.model, job.sha256), insertions, tasks, to_author_depth=True)
