"""Episodes through the deployed service: world and control process run as processes of their own.

The arm is the simulated one over Zenoh, in lockstep, or an emulated UR controller over RTDE, in real time. The control
process never learns the truth. After the run the simulator is asked for the true state of the peg.
"""

import asyncio
import json
import math
import os
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import zenoh

from service.client import CellClient, CellError, CellRefusedError
from service.messages import CellState, RefusalReason, ResetRequest, Run, RunState, StartRequest
from service.program import PROGRAM, command
from sim_backend.world.scene import NOMINAL_HOLE_M, PAYLOAD_COM_M, PAYLOAD_KG, TCP_OFFSET_M
from sim_backend.world.world import START_POSITION_M, START_YAW_RAD
from training.environment.insertion import LIMITS, SUCCESS_DEPTH_M
from training.evaluation.evaluate import Job
from training.evaluation.results import EpisodeResult, Setting
from wire import keys
from wire.session import close_session, open_session, query
from wire.task import Task

CELL, WORLD, RECIPE = "evaluation", "evaluation", "evaluated"
HOST = "127.0.0.1"
REQUESTED_BY = f"{PROGRAM} evaluate"
READY_S = 60.0
"""Host time allowed for the processes to come up, and for a cell to be ready after a run."""
RUN_S = 300.0
"""Host time allowed for one run; in lockstep its duration depends on the machine."""
SAMPLE_AGE_S = 0.08
"""Age of a sample at which the cell of a general-purpose host stops, as in the shipped configurations."""
POLL_S = 0.05
PASSING_REFUSALS = frozenset({RefusalReason.WRONG_STATE, RefusalReason.NO_MEASUREMENT, RefusalReason.LATCHED})
"""Why a ready cell may refuse a start after all: a busy host's measurement was late. No run has begun then."""
STOP_S = 5.0


class ServiceError(RuntimeError):
    """The deployed service could not be started or did not end a run; the text holds its output."""


class LostRunError(ServiceError):
    """A run began and its end was not seen; it counts as a failure.

    Attributes:
        episode: the run, neither inserted nor claimed.
    """

    def __init__(self, episode: "ServiceEpisode") -> None:
        super().__init__(f"the run of seed {episode.seed} was not seen to end; it counts as a failure")
        self.episode = episode


@dataclass(frozen=True, slots=True)
class ServiceEpisode:
    """One run through the service.

    Attributes:
        seed: seed of the world.
        run: the service's own account.
        depth_m: true depth of the peg's bottom below the mouth after the run.
        inserted: the peg was truly in the hole then: `SUCCESS_DEPTH_M` deep, its axis inside, and no fault had latched
            the cell.
    """

    seed: int
    run: Run
    depth_m: float
    inserted: bool

    @property
    def claimed(self) -> bool:
        """True if the service reports success."""
        return self.run.state is RunState.SUCCEEDED

    @property
    def result(self) -> EpisodeResult:
        """Result to keep, with success by the truth."""
        return EpisodeResult(
            seed=self.seed,
            success=self.inserted,
            fault=self.run.state is RunState.LATCHED,
            steps=self.run.steps,
            peak_force_n=self.run.peak_force_n,
            claimed=self.claimed,
            code=self.run.code,
        )


def play(
    model: Path,
    seeds: list[int],
    setting: Setting,
    *,
    sha256: str | None = None,
    on_episode: Callable[[ServiceEpisode], object] = lambda _: None,
) -> list[ServiceEpisode]:
    """Play seeds one after another.

    Args:
        model: ONNX file of the policy.
        seeds: seeds of the worlds.
        setting: part, clearance, conditions, ceiling and arm; its lock must be the policy's own.
        sha256: digest that the file must have, or the service refuses it; None: any.
        on_episode: called with each run when it has ended.

    Raises:
        ServiceError: the processes do not come up, or a run does not end.
    """
    with tempfile.TemporaryDirectory(prefix="dsl-assembly-") as directory, ExitStack() as processes:
        sim_endpoint, cell_endpoint = (f"tcp/{HOST}:{port}" for port in _free_ports(2))
        world = ["sim", *_arm(setting), "--world", WORLD, "--listen", sim_endpoint]
        logs = [Path(directory) / name for name in ("simulator.log", "control-process.log")]
        simulator = processes.enter_context(_process(world, logs[0]))
        ready = _await_line(simulator, logs[0])
        config = Path(directory) / "cell.toml"
        config.write_text(_toml(_configuration(model, sha256, setting, cell_endpoint, sim_endpoint, ready)))
        service = processes.enter_context(_process(["control", "--config", str(config)], logs[1]))
        try:
            return asyncio.run(_play(seeds, setting, cell_endpoint, sim_endpoint, on_episode))
        except (CellError, LostRunError, ServiceError, TimeoutError) as error:
            said = "\n".join(log.read_text()[-2000:] for log in logs)
            ended = sum(process.poll() is not None for process in (simulator, service))
            text = f"{error or 'nothing within its time'}; {ended} of 2 processes have ended; they said:\n{said}"
            raise ServiceError(text) from error


def measure(jobs: Sequence[Job], workers: int) -> Iterator[tuple[Setting, EpisodeResult]]:
    """Play jobs through `workers` services at once and yield each episode as it ends.

    Raises:
        ServiceError: as `play`; episodes that ended before were yielded.
    """
    told: SimpleQueue[tuple[Setting, EpisodeResult] | Future[None]] = SimpleQueue()
    enough = threading.Event()

    def run(job: Job) -> None:
        def tell(episode: ServiceEpisode) -> None:
            if enough.is_set():
                raise CancelledError
            told.put((job.setting, episode.result))

        play(job.model, list(job.seeds), job.setting, sha256=job.sha256, on_episode=tell)

    with ThreadPoolExecutor(workers) as pool:
        try:
            for job in jobs:
                pool.submit(run, job).add_done_callback(told.put)
            left = len(jobs)
            while left:
                item = told.get()
                if isinstance(item, Future):
                    item.result()
                    left -= 1
                else:
                    yield item
        finally:
            enough.set()
            pool.shutdown(wait=True, cancel_futures=True)


def _arm(setting: Setting) -> list[str]:
    if setting.through == "rtde":
        return ["ur-controller", "--any-ports", "--host", HOST, "--part", setting.part, "--realtime"]
    return ["serve", "--mode", "lockstep"]


def _configuration(
    model: Path, sha256: str | None, setting: Setting, cell_endpoint: str, sim_endpoint: str, ready: dict[str, str]
) -> dict[str, dict[str, Any]]:
    """Return the sections of the cell's TOML; `ready` holds the simulator's ports."""
    over_rtde = setting.through == "rtde"
    limits = {
        "force_ceiling_n": setting.force_ceiling_n,
        "workspace_m": LIMITS.workspace,
        "max_contact_share": 0.8,  # the largest: a measurement, not a cell at work, as `allow_lock`
    }
    sections: dict[str, dict[str, Any]] = {
        "cell": {
            "id": CELL,
            "endpoint": cell_endpoint,
            "state_dir": "state",
            "driver": "ur" if over_rtde else "zenoh_sim",
            "realtime": over_rtde,  # a late host would be counted against the policy
        },
        "limits": limits | ({"sample_age_s": SAMPLE_AGE_S} if over_rtde else {}),
        "sim": {"world": WORLD, "endpoint": sim_endpoint, "mode": "lockstep", "autostart": False},
        f"recipes.{RECIPE}": {
            "part": setting.part,
            "clearance_m": setting.clearance_m,
            "policy": str(model.resolve()),
            "start_position_m": START_POSITION_M,
            "start_yaw_rad": START_YAW_RAD,
            "nominal_hole_m": NOMINAL_HOLE_M,
            "conditions": setting.conditions,
            "allow_lock": ["paper", "sliding", "off"],  # a measurement, not a cell at work
            "retract": False,  # so that the end of the run can be looked at
        }
        | ({} if sha256 is None else {"policy_sha256": sha256}),
    }
    if setting.plant is not None:
        sections[f"recipes.{RECIPE}.plant"] = setting.plant.to_json()
    if over_rtde:
        sections["ur"] = {
            "host": HOST,
            "rtde_port": int(ready["rtde"]),
            "dashboard_port": int(ready["dashboard"]),
            "primary_port": int(ready["primary"]),
            "simulated": True,
            "payload_kg": PAYLOAD_KG,
            "payload_com_m": [0.0, 0.0, PAYLOAD_COM_M],
            "tcp_m": [0.0, 0.0, TCP_OFFSET_M, 0.0, 0.0, 0.0],
        }
        sections["camera"] = {"endpoint": sim_endpoint, "key": keys.CAMERA.format(world=WORLD)}
    return sections


async def _play(
    seeds: list[int],
    setting: Setting,
    cell_endpoint: str,
    sim_endpoint: str,
    on_episode: Callable[[ServiceEpisode], object],
) -> list[ServiceEpisode]:
    session = await asyncio.to_thread(open_session, connect=[sim_endpoint])
    try:
        async with CellClient(CELL, [cell_endpoint]) as cell:
            played: list[ServiceEpisode] = []
            for seed in seeds:
                try:
                    played.append(await _play_one(seed, setting, cell, session))
                except LostRunError as lost:
                    on_episode(lost.episode)  # it is kept; otherwise it would be played again until it ends well
                    raise
                on_episode(played[-1])
            return played
    finally:
        await asyncio.to_thread(close_session, session)


async def _play_one(seed: int, setting: Setting, cell: CellClient, session: zenoh.Session) -> ServiceEpisode:
    run = await _started(cell, seed)
    try:
        async with asyncio.timeout(RUN_S):
            while (run := await cell.run(run.id)).state is RunState.ACTIVE:
                await asyncio.sleep(POLL_S)
            while (await cell.status()).state is CellState.STOPPING:  # forces until the arm stands count
                await asyncio.sleep(POLL_S)
            run = await cell.run(run.id)
    except (CellError, TimeoutError) as error:
        interrupted = run.model_copy(update={"state": RunState.INTERRUPTED})
        raise LostRunError(ServiceEpisode(seed, interrupted, math.nan, False)) from error
    answers = await query(session, keys.TRUTH.format(world=WORLD), b"", 5.0)
    if not answers:
        raise ServiceError("the simulator does not say what is true")
    return judged(json.loads(answers[0]), seed, setting, run)


def judged(truth: dict[str, Any], seed: int, setting: Setting, run: Run) -> ServiceEpisode:
    """Judge a run by the simulator's truth.

    Args:
        truth: true state of the world after the run.
        seed: seed that was asked for.
        setting: setting that was asked for.
        run: the service's own account.

    Raises:
        ServiceError: the world was laid out for another task.
    """
    asked = Task(seed, setting.part, setting.clearance_m, setting.conditions, plant=setting.plant).to_json()
    played: dict[str, Any] = truth["task"]
    differing = [name for name in asked if played[name] != asked[name]]
    if differing:
        told = ", ".join(f"{name} {played[name]!r} where {asked[name]!r} was asked for" for name in differing)
        raise ServiceError(f"the simulator played another task: {told}")
    depth = float(truth["depth"])
    inside = depth >= SUCCESS_DEPTH_M and bool(truth["contained"])
    return ServiceEpisode(seed, run, depth, inside and run.state is not RunState.LATCHED)


async def _started(cell: CellClient, seed: int) -> Run:
    """Start a run as soon as the cell takes one."""
    deadline = time.monotonic() + READY_S
    while True:
        await _await_ready(cell, deadline)
        try:
            return (await cell.start(StartRequest(recipe=RECIPE, seed=seed, requested_by=REQUESTED_BY))).run
        except CellRefusedError as error:
            if error.problem.reason not in PASSING_REFUSALS:
                raise


async def _await_ready(cell: CellClient, deadline: float) -> None:
    """Wait until a run may start, and reset a latched cell."""
    refusal = "it did not become ready"
    while time.monotonic() < deadline:
        try:
            status = await cell.status()
            if status.can_start:
                return
            if status.state is CellState.LATCHED:
                await cell.reset(ResetRequest(requested_by=REQUESTED_BY))
            refusal = status.why_not or refusal
        except CellRefusedError as error:
            refusal = error.problem.detail
        except CellError as error:
            refusal = str(error)
        await asyncio.sleep(POLL_S)
    raise ServiceError(f"the cell cannot start a run: {refusal}")


def _await_line(process: subprocess.Popen[bytes], log: Path) -> dict[str, str]:
    """Wait for the simulator's line `ready name=value …` and return its values."""
    deadline = time.monotonic() + READY_S
    while time.monotonic() < deadline and process.poll() is None:
        for line in log.read_text().splitlines():
            word, *facts = line.split()
            if word == "ready":
                return dict(fact.split("=", 1) for fact in facts)
        time.sleep(POLL_S)
    raise ServiceError(f"the simulator did not come up; it said:\n{log.read_text()[-2000:]}")


@contextmanager
def _process(arguments: list[str], log: Path) -> Generator[subprocess.Popen[bytes]]:
    """Run this project's program while the context lasts, its output in `log`."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("DSL_ASSEMBLY_")}
    with log.open("wb") as output:
        process = subprocess.Popen(
            command(*arguments),
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            env=environment,
        )
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _free_ports(count: int) -> list[int]:
    with ExitStack() as probes:
        sockets = [probes.enter_context(socket.socket()) for _ in range(count)]
        for probe in sockets:
            probe.bind(("127.0.0.1", 0))
        return [int(probe.getsockname()[1]) for probe in sockets]


def _toml(sections: dict[str, dict[str, Any]]) -> str:
    """Write sections of numbers, flags, plain strings and lists, for which JSON and TOML agree."""
    return "\n".join(
        f"[{name}]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in section.items())
        for name, section in sections.items()
    )
