"""Carries results over a change of the sources that alters no episode, by proof.

Results name the sources that decided them by digest. Where these only moved or were renamed, `carry` plays episodes of
every block again, once with the earlier sources and once with the present ones, and compares them. Only if all agree,
it writes the present digest into the files, with a line that says what was compared.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from itertools import groupby, zip_longest
from pathlib import Path
from typing import IO, Any, Self, cast

from service.policy.model import Policy
from training.evaluation import provenance
from training.evaluation.evaluate import CELLS
from training.evaluation.results import Block, Carried, Replay, Results, exclusive, rounded

SCRIPT = Path(__file__).with_name("replay.py")
COMPARED = {
    "environment": "every step, bit for bit",
    "zenoh": "result, exactly",
    "rtde": "success, in real time",
}
"""Compared quantities by player of the episode; an episode in real time never repeats bit for bit."""
ROUNDING = 0.500001e-3
"""Largest difference between a float and its value on file, which has three decimals."""
STOP_S = 15.0
"""Host time allowed for a player to end, with the service that it may be running."""


class CarryError(RuntimeError):
    """The results cannot be carried over; the text says why. No file was changed."""


@dataclass(frozen=True, slots=True)
class Sources:
    """Digests of one tree's sources, by the tree's own rule.

    Attributes:
        sources: that decide an episode in the batched environment.
        deployed_sources: that may decide an episode through the service.
        commit: of the tree; None: not known.
    """

    sources: str
    deployed_sources: str
    commit: str | None


@dataclass(frozen=True, slots=True)
class ReplayJob:
    """Episodes of one block that are to be played in both trees.

    Attributes:
        path: of the results file.
        block: with the episodes on file, those to play and no others.
        policy: file that plays.
        stand_in: changes to that policy's contract where it stands in for another one; None: it was measured itself.
        repeatable: the episodes on file were played in the same batch on such a machine, and must come out the same.
    """

    path: Path
    block: Block
    policy: Path
    stand_in: dict[str, Any] | None
    repeatable: bool

    @property
    def request(self) -> dict[str, Any]:
        """Request to `replay.py`."""
        return {
            "play": "environment" if self.block.setting.through == "environment" else "service",
            "model": str(self.policy.resolve()),
            "setting": self.block.model_dump(mode="json", include={"setting"})["setting"],
            "seeds": [episode.seed for episode in self.block.episodes],
            "stand_in": self.stand_in,
        }

    def __str__(self) -> str:
        setting = self.block.setting
        return (
            f"{self.path}: {setting.part} {setting.clearance_m * 1e3:.2f} mm {setting.conditions} {setting.lock} "
            f"{setting.through}, played by {self.policy.name}"
        )


class Player:
    """A process that plays episodes with the code of one tree; use it as a context.

    Args:
        root: of the tree.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self._close = ExitStack()

    def __enter__(self) -> Self:
        environment = {name: value for name, value in os.environ.items() if not name.startswith("DSL_ASSEMBLY_")}
        self._log: IO[str] = self._close.enter_context(tempfile.TemporaryFile("w+"))
        self._process = subprocess.Popen(
            [sys.executable, "-P", str(SCRIPT)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            cwd=self._root,
            env=environment | {"PYTHONPATH": str(self._root)},
        )
        self._requests, self._answers = cast(IO[str], self._process.stdin), cast(IO[str], self._process.stdout)
        return self

    def __exit__(self, *_: object) -> None:
        with self._close:
            self._process.terminate()
            try:
                self._process.communicate(timeout=STOP_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.communicate()

    def ask(self, request: dict[str, Any]) -> None:
        """Send a request; `answer` waits for what comes of it."""
        try:
            self._requests.write(json.dumps(request) + "\n")
            self._requests.flush()
        except BrokenPipeError:
            raise self._ended() from None

    def answer(self) -> dict[str, Any]:
        """Return the answer to the oldest request.

        Raises:
            CarryError: the process ended instead.
        """
        line = self._answers.readline()
        if not line:
            raise self._ended()
        return json.loads(line)

    def sources(self) -> Sources:
        """Return the digests of the tree as it is now."""
        self.ask({"play": "sources"})
        return Sources(**self.answer())

    def _ended(self) -> CarryError:
        self._process.wait()
        self._log.seek(0)
        return CarryError(f"{self._root} cannot play; it said:\n{self._log.read()[-3000:]}")


@contextmanager
def checkout(revision: str) -> Generator[Path]:
    """Check a revision of this repository out beside it while the context lasts.

    Raises:
        CarryError: there is no such revision.
    """
    with tempfile.TemporaryDirectory(prefix="dsl-assembly-") as directory:
        tree = Path(directory) / "tree"
        _git("worktree", "add", "--detach", str(tree), revision)
        try:
            yield tree
        finally:
            _git("worktree", "remove", "--force", str(tree))


def jobs_of(
    paths: Sequence[Path], models: Path, episodes: int, service_episodes: int, *, service: bool = True
) -> list[ReplayJob]:
    """Return what has to be played to carry results files over.

    Args:
        paths: of the results.
        models: folder of the policies. Where the one that was measured is not there, one that observes the same stands
            in for it, under the lock and the compliance of the results: the proof is about sources, not policies.
        episodes: of each block in the batched environment, from its first seed on.
        service_episodes: of each block through the service.
        service: include blocks through the service.

    Raises:
        CarryError: no policy at hand can stand in.
        ResultsError: a file holds no results.
    """
    shipped = {path: Policy.load(path) for path in sorted(models.glob("*.onnx"))}
    jobs: list[ReplayJob] = []
    for path in paths:
        results = Results.load(path)
        measured = next((file for file, policy in shipped.items() if policy.sha256 == results.sha256), None)
        for block in results.blocks:
            through = block.setting.through
            count = episodes if through == "environment" else service_episodes
            if not block.episodes or (through != "environment" and not service):
                continue
            if measured is not None:
                jobs.append(ReplayJob(path, block.first(count), measured, None, _repeatable(block, count)))
            elif through == "environment":
                jobs.append(
                    ReplayJob(
                        path, block.first(count), _stand_in(results, shipped), _changes(results), repeatable=False
                    )
                )
            else:
                raise CarryError(f"{path} has episodes through the service, and no file in {models} is its policy")
    return jobs


def replay(jobs: Sequence[ReplayJob], before: Player, after: Player) -> Iterator[tuple[ReplayJob, Replay]]:
    """Play jobs in both trees and compare; gives each job when it has agreed.

    Raises:
        CarryError: an episode differs between the trees or from the one on file; the text says which and where.
    """
    for job in jobs:
        before.ask(job.request)
        # In real time the two would take each other's processor time
        answer = before.answer() if job.block.setting.through == "rtde" else None
        after.ask(job.request)
        yield job, compared(job, answer or before.answer(), after.answer())


def compared(job: ReplayJob, before: dict[str, Any], after: dict[str, Any]) -> Replay:
    """Compare what two trees played of a job.

    Another processor, or another batch, rounds otherwise, and contact makes more of it. So episodes that differ from
    those on file are an error only if the job is repeatable, and otherwise are counted.

    Raises:
        CarryError: the trees differ, or both differ from the file although the job is repeatable.
    """
    setting = job.block.setting
    agreed = like_file = 0
    for on_file, one, other in zip(job.block.episodes, before["episodes"], after["episodes"], strict=True):
        unlike = _unlike(other["result"], asdict(on_file))
        like_file += not unlike
        if setting.through == "rtde":
            ends = {one["result"]["success"], other["result"]["success"], on_file.success}
            if len(ends) > 1:
                raise CarryError(f"{job}: seed {on_file.seed}: success differs between the trees or from the file")
            agreed += 1
            continue
        difference = _difference(before["names"], one, other)
        if difference:
            raise CarryError(f"{job}: seed {on_file.seed}: the trees differ: {difference}")
        if job.repeatable and unlike:
            raise CarryError(f"{job}: seed {on_file.seed}: both trees agree, but not with the file: {unlike}")
        agreed += 1
    return Replay(
        through=setting.through,
        policy=job.policy.stem,
        compared=COMPARED[setting.through],
        blocks=1,
        episodes=len(job.block.episodes),
        agreed=agreed,
        as_on_file=like_file if job.stand_in is None else None,
    )


def check(paths: Sequence[Path], before: Sources, *, service: bool = True) -> None:
    """Check that results are of the sources `before`.

    Raises:
        CarryError: one of them is not.
        ResultsError: a file holds no results.
    """
    for path in paths:
        results = Results.load(path)
        of_service = results.deployed_sources if service else None
        if results.sources != before.sources or of_service not in (None, before.deployed_sources):
            raise CarryError(
                f"{path} is not of the sources of {before.commit or 'that tree'}: it names {results.sources[:12]}… and "
                f"{(of_service or 'no service')[:12]}, the tree has {before.sources[:12]}… and "
                f"{before.deployed_sources[:12]}…; name the revision that it was measured at or carried to"
            )


def write(path: Path, replays: Sequence[Replay], before: Sources, after: Sources, *, service: bool = True) -> None:
    """Write the sources `after` into a results file, with a line that says what was compared."""
    with exclusive(path):
        results = Results.load(path)
        through_service = service and results.deployed_sources is not None
        carried = Carried(
            date=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
            from_sources=before.sources,
            to_sources=after.sources,
            from_deployed_sources=before.deployed_sources if through_service else None,
            to_deployed_sources=after.deployed_sources if through_service else None,
            from_commit=before.commit,
            to_commit=after.commit,
            machine=provenance.machine(),
            versions=provenance.versions(),
            replays=_summed(replays),
        )
        changed = {"sources": after.sources, "carried": (*results.carried, carried)}
        if through_service:
            changed["deployed_sources"] = after.deployed_sources
        results.model_copy(update=changed).save(path)


def _repeatable(block: Block, count: int) -> bool:
    """Return whether the first `count` episodes were played in one batch on a machine and with versions like these."""
    if not block.sessions:
        return False
    first = block.sessions[0]
    alike = (first.machine, first.versions) == (provenance.machine(), provenance.versions())
    if block.setting.through == "environment":
        return alike and count == min(CELLS, first.episodes)
    return alike and block.setting.through == "zenoh"


def _stand_in(results: Results, shipped: dict[Path, Policy]) -> Path:
    """Choose a policy that observes the same at the same rate, a trained one with memory if there is any."""
    fitting = [
        (not policy.contract.hidden_size, file)
        for file, policy in shipped.items()
        if policy.contract.mode == results.mode and policy.contract.period_s == results.period_s
    ]
    if not fitting:
        raise CarryError(f"no policy at hand observes {results.mode} every {results.period_s:g} s, as {results.policy}")
    return min(fitting)[1]


def _changes(results: Results) -> dict[str, Any]:
    return {
        "max_steps": results.max_steps,
        "dsl": {"press_m": results.press_m, "seek_step_m": results.seek_step_m},
        "compliance": {"stiffness": results.stiffness},
    }


def _difference(names: Sequence[str], one: dict[str, Any], other: dict[str, Any]) -> str:
    """Say where two episodes differ first; empty: nowhere. Step 0 is the reset."""
    for step, (left, right) in enumerate(zip_longest(one["steps"], other["steps"], fillvalue=())):
        differing = [name for name, x, y in zip_longest(names, left, right) if x != y]
        if differing:
            return f"step {step}: {', '.join(differing)}"
    return _differing(one["result"], other["result"])


def _differing(one: dict[str, Any], other: dict[str, Any]) -> str:
    names = sorted(one.keys() | other.keys())
    return ", ".join(
        f"{name} {one.get(name)!r} and {other.get(name)!r}" for name in names if one.get(name) != other.get(name)
    )


def _unlike(played: dict[str, Any], on_file: dict[str, Any]) -> str:
    """Say where a result differs from the one on file; empty: nowhere.

    A float agrees if it can be rounded to the value on file either way: a policy rounds otherwise in batches of
    another size.
    """
    near = {
        name: value
        for name, value in on_file.items()
        if isinstance(value, float) and abs(played[name] - value) <= ROUNDING
    }
    return _differing(*({name: rounded(value) for name, value in row.items()} for row in (played | near, on_file)))


def _summed(replays: Sequence[Replay]) -> tuple[Replay, ...]:
    """Add up replays of the same kind by the same policy."""

    def kind(replay: Replay) -> tuple[str, str, bool]:
        return replay.through, replay.policy, replay.as_on_file is None

    groups = [list(group) for _, group in groupby(sorted(replays, key=kind), key=kind)]
    return tuple(
        group[0].model_copy(
            update={
                name: None if getattr(group[0], name) is None else sum(getattr(replay, name) for replay in group)
                for name in ("blocks", "episodes", "agreed", "as_on_file")
            }
        )
        for group in groups
    )


def _git(*arguments: str) -> None:
    git = shutil.which("git")
    if git is None:
        raise CarryError("git is not installed")
    done = subprocess.run([git, *arguments], cwd=provenance.ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise CarryError(f"git {' '.join(arguments[:2])} failed: {done.stderr.strip()}")
