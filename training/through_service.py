"""The same seeds through the deployed service: simulator and control process as processes of their own, over Zenoh.

The control process never learns the truth. It is asked of the simulator, where the tool stands when the run has ended.
"""

import asyncio
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zenoh

from service.client import CellClient, CellError, CellRefusedError
from service.messages import CellState, ResetRequest, Run, RunState, StartRequest
from service.transport import close_session, open_session, query
from sim_backend.protocol import keys
from sim_backend.protocol.task import Conditions, Part
from sim_backend.scene import NOMINAL_HOLE_M
from sim_backend.world import START_POSITION_M, START_YAW_RAD
from training.evaluate import Report, wilson
from training.insertion import LIMITS, SUCCESS_DEPTH_M

CELL, WORLD, RECIPE = "evaluation", "evaluation", "evaluated"
READY_S = 60.0
"""Host time for the processes to come up, and for a cell to be ready after a run."""
RUN_S = 300.0
"""Host time for one run; in lockstep it takes what the machine needs."""
POLL_S = 0.05
STOP_S = 5.0


class ServiceError(RuntimeError):
    """The deployed service could not be started, or did not bring a run to its end; the text says what it said."""


@dataclass(frozen=True, slots=True)
class ServiceEpisode:
    """One run through the service.

    Attributes:
        seed: of the world.
        run: the service's own account.
        depth_m: true depth of the peg's bottom below the mouth when the run had ended.
        inserted: whether the peg truly was in the hole then: `SUCCESS_DEPTH_M` deep, its axis inside.
    """

    seed: int
    run: Run
    depth_m: float
    inserted: bool

    @property
    def claimed(self) -> bool:
        """Whether the service says that it succeeded."""
        return self.run.state is RunState.SUCCEEDED


def play(
    model: Path,
    seeds: list[int],
    clearance_m: float,
    *,
    part: Part = "tr",
    conditions: Conditions = "standard",
    force_ceiling_n: float = 30.0,
    on_episode: Callable[[int], object] = lambda _: None,
) -> list[ServiceEpisode]:
    """Play seeds, one after another.

    Args:
        model: ONNX file of the policy.
        seeds: of the worlds.
        clearance_m: per face.
        part: peg and hole.
        conditions: distributions that the worlds are drawn from.
        force_ceiling_n: of the cell.
        on_episode: is told 1 after each run.

    Raises:
        ServiceError: the processes do not come up, or a run does not end.
    """
    with tempfile.TemporaryDirectory(prefix="dsl-assembly-") as directory, ExitStack() as processes:
        sim_endpoint, cell_endpoint = (f"tcp/127.0.0.1:{port}" for port in _free_ports(2))
        config = Path(directory) / "cell.toml"
        config.write_text(
            _toml(
                {
                    "cell": {"id": CELL, "endpoint": cell_endpoint, "state_dir": "state"},
                    "limits": {"force_ceiling_n": force_ceiling_n, "workspace_m": LIMITS.workspace},
                    "sim": {"world": WORLD, "endpoint": sim_endpoint, "mode": "lockstep", "autostart": False},
                    f"recipes.{RECIPE}": {
                        "part": part,
                        "clearance_m": clearance_m,
                        "policy": str(model.resolve()),
                        "start_position_m": START_POSITION_M,
                        "start_yaw_rad": START_YAW_RAD,
                        "nominal_hole_m": NOMINAL_HOLE_M,
                        "conditions": conditions,
                        "allow_lock": ["paper", "peck", "sliding", "off"],  # a measurement, not a cell at work
                        "retract": False,  # so that the end of the run can be looked at
                    },
                }
            )
        )
        simulator = ["sim_backend", "serve", "--world", WORLD, "--mode", "lockstep", "--listen", sim_endpoint]
        logs = [Path(directory) / name for name in ("simulator.log", "service.log")]
        started = [
            processes.enter_context(_process(simulator, logs[0])),
            processes.enter_context(_process(["service", "run", "--config", str(config)], logs[1])),
        ]
        try:
            return asyncio.run(_play(seeds, cell_endpoint, sim_endpoint, on_episode))
        except (CellError, TimeoutError) as error:
            said = "\n".join(log.read_text()[-2000:] for log in logs)
            ended = sum(process.poll() is not None for process in started)
            text = f"{error or 'nothing within its time'}; {ended} of 2 processes have ended; they said:\n{said}"
            raise ServiceError(text) from error


def table(report: Report, played: list[ServiceEpisode]) -> str:
    """Compare the batched environment with the service on the same seeds, in Markdown."""
    batched = {episode.seed: episode for episode in report.episodes}
    same = [batched[episode.seed] for episode in played]
    rows = [
        ("batched environment", [e.success for e in same], [e.steps for e in same], [e.peak_force_n for e in same]),
        *(
            (name, verdict, [e.run.steps for e in played], [e.run.peak_force_n for e in played])
            for name, verdict in (
                ("through the service, its own outcome", [e.claimed for e in played]),
                ("through the service, true state", [e.inserted for e in played]),
            )
        ),
    ]
    lines = [
        f"clearance {report.clearance_m * 1e3:.2f} mm, {report.conditions} conditions, "
        f"seeds {played[0].seed} to {played[-1].seed}",
        "",
        "| | success (95 % interval) | mean steps | peak force median/max, N |",
        "|---|---|---|---|",
    ]
    for name, verdict, steps, peaks in rows:
        low, high = wilson(sum(verdict), len(verdict))
        lines.append(
            f"| {name} | {sum(verdict)}/{len(verdict)} = {sum(verdict) / len(verdict):.1%} ({low:.1%} to {high:.1%}) | "
            f"{np.mean(steps):.0f} | {np.median(peaks):.1f}/{np.max(peaks):.1f} |"
        )
    wrong = [episode for episode in played if episode.claimed != episode.inserted]
    lines += ["", f"outcome and truth differ in {len(wrong)} of {len(played)} runs"]
    lines += [f"- seed {e.seed}: {e.run.state}, true depth {e.depth_m * 1e3:.2f} mm" for e in wrong]
    codes = [e.run.code for e in played if e.run.code is not None]
    lines += [f"- ended by {code}: {codes.count(code)}" for code in sorted(set(codes))]
    return "\n".join(lines)


async def _play(
    seeds: list[int], cell_endpoint: str, sim_endpoint: str, on_episode: Callable[[int], object]
) -> list[ServiceEpisode]:
    session = await asyncio.to_thread(open_session, connect=[sim_endpoint])
    try:
        async with CellClient(CELL, [cell_endpoint]) as cell:
            played: list[ServiceEpisode] = []
            for seed in seeds:
                played.append(await _play_one(seed, cell, session))
                on_episode(1)
            return played
    finally:
        await asyncio.to_thread(close_session, session)


async def _play_one(seed: int, cell: CellClient, session: zenoh.Session) -> ServiceEpisode:
    await _await_ready(cell)
    started = await cell.start(StartRequest(recipe=RECIPE, seed=seed, requested_by="python -m training evaluate"))
    async with asyncio.timeout(RUN_S):
        while (run := await cell.run(started.run.id)).state is RunState.ACTIVE:
            await asyncio.sleep(POLL_S)
    answers = await query(session, keys.TRUTH.format(world=WORLD), b"", 5.0)
    if not answers:
        raise ServiceError("the simulator does not say what is true")
    truth: dict[str, Any] = json.loads(answers[0])
    if truth["task"]["seed"] != seed:
        raise ServiceError(f"the simulator holds seed {truth['task']['seed']}, the run was with seed {seed}")
    depth = float(truth["depth"])
    return ServiceEpisode(seed, run, depth, depth > SUCCESS_DEPTH_M and bool(truth["contained"]))


async def _await_ready(cell: CellClient) -> None:
    """Wait until a run may start, and acknowledge what the last one latched."""
    refusal = "it did not become ready"
    deadline = time.monotonic() + READY_S
    while time.monotonic() < deadline:
        try:
            status = await cell.status()
            if status.can_start:
                return
            if status.state is CellState.LATCHED:
                await cell.reset(ResetRequest(requested_by="python -m training evaluate"))
            refusal = status.why_not or refusal
        except CellRefusedError as error:
            refusal = error.problem.detail
        except CellError as error:
            refusal = str(error)
        await asyncio.sleep(POLL_S)
    raise ServiceError(f"the cell cannot start a run: {refusal}")


@contextmanager
def _process(module: list[str], log: Path) -> Generator[subprocess.Popen[bytes]]:
    """Run `python -m module …` while the context lasts, its output in `log`."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("DSL_ASSEMBLY_")}
    with log.open("wb") as output:
        process = subprocess.Popen(
            [sys.executable, "-m", *module],
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
    """Write sections of numbers, flags, plain strings and lists: there JSON and TOML agree."""
    return "\n".join(
        f"[{name}]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in section.items())
        for name, section in sections.items()
    )
