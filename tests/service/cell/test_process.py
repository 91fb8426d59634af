"""Processes that are killed, frozen and ended: the simulator under a cell, and the control process itself."""

import asyncio
import json
import os
import signal
import subprocess
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh

from service.cell.cell import Cell
from service.cell.process import attended
from service.client import CellClient
from service.drivers.base import Program, StopReason
from service.drivers.zenoh_sim import ZenohSimDriver
from service.faults import FaultCode
from service.messages import CellState, RefusalReason, Refused, ResetRequest, RunResult, RunState, StartRequest
from service.program import command
from service.testing import RECIPE, cell_config
from tests.conftest import REALTIME_VARIABLE
from tests.scheduling import ORDINARY, children, schedulings
from tests.service.cell import policies
from tests.service.cell.conftest import EASY
from tests.service.sim_server import free_endpoint, sim_process
from wire import keys, realtime, records
from wire.session import open_session

ROOT = Path(__file__).parents[3]
LIMITS = {"sample_age_s": 0.25, "target_age_s": 0.6, "policy_deadline_s": 0.5}
"""Time limits in a test's configuration, s: so wide that the lateness of a loaded test machine trips none of them."""


async def until(condition: Callable[[], object], seconds: float = 30.0) -> None:
    async with asyncio.timeout(seconds):
        while not condition():
            await asyncio.sleep(0.005)


@asynccontextmanager
async def cell_over_zenoh(tmp_path: Path, endpoint: str) -> AsyncIterator[Cell]:
    config = cell_config(tmp_path / "state", policies.still(tmp_path), LIMITS, conditions="easy")
    cell = Cell(config, ZenohSimDriver("world-1", [endpoint], "real_time"))
    async with attended(cell):
        await until(lambda: cell.state in (CellState.READY, CellState.LATCHED))
        yield cell


async def started(cell: Cell) -> str:
    answer = await cell.start(StartRequest(recipe=RECIPE, seed=EASY))
    assert isinstance(answer, RunResult)
    await until(lambda: cell.state in (CellState.APPROACH, CellState.RUNNING, CellState.LATCHED))
    assert cell.journal.latch is None, cell.journal.latch
    return answer.run.id


LATENESS_S = 0.1
"""Lateness of a loop on a loaded test machine, s, beside the age limit that a stop is held to."""


async def simulator_signalled(
    cell: Cell, simulator: subprocess.Popen[str], number: signal.Signals, run_id: str
) -> None:
    """Signal the simulator under a run; assert that the stop leaves at the age limit, and what is recorded."""
    stops: list[float] = []
    stop = cell.driver.stop

    def stopped() -> None:
        stops.append(time.monotonic())
        stop()

    cell.driver.stop = stopped  # type: ignore[method-assign]
    simulator.send_signal(number)
    await until(lambda: cell.state is CellState.LATCHED)
    last = cell.newest_sample
    assert last is not None
    limit_s = cell.config.limits.sample_age_s
    assert limit_s - 1e-3 <= stops[0] - last.arrival_s <= limit_s + LATENESS_S
    run = cell.runs.find(run_id)
    assert run is not None
    assert (run.state, run.code) == (RunState.LATCHED, FaultCode.STALE)
    assert isinstance(answer := await cell.reset(ResetRequest()), Refused)
    assert answer.problem.reason is RefusalReason.NO_MEASUREMENT


async def test_19_a_simulator_that_is_killed_latches_stale_at_the_age_limit(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with sim_process(endpoint) as simulator:
        async with cell_over_zenoh(tmp_path, endpoint) as cell:
            await simulator_signalled(cell, simulator, signal.SIGKILL, await started(cell))


async def test_20_a_simulator_that_is_frozen_latches_stale_at_the_age_limit_and_stays_latched(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with sim_process(endpoint) as simulator:
        async with cell_over_zenoh(tmp_path, endpoint) as cell:
            await simulator_signalled(cell, simulator, signal.SIGSTOP, await started(cell))
            simulator.send_signal(signal.SIGCONT)
            await until(lambda: cell.status().measured is not None and not cell.unlinked.is_set())
            sample = cell.newest_sample
            await until(lambda: cell.newest_sample is not sample and cell.newest_sample is not None)
            await until(lambda: cell.newest_sample is not None and cell.newest_sample.program is Program.IDLE)
            assert cell.state is CellState.LATCHED, "it stays latched though samples flow again"
            assert cell.runs.active is None


async def test_21_a_simulator_that_restarts_resumes_nothing(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with sim_process(endpoint) as simulator:
        async with cell_over_zenoh(tmp_path, endpoint) as cell:
            await started(cell)
            simulator.kill()
            await until(lambda: cell.state is CellState.LATCHED)
            with sim_process(endpoint):
                await until(lambda: cell.newest_sample is not None and not cell.unlinked.is_set())
                assert cell.state is CellState.LATCHED
                assert cell.newest_sample is not None
                assert cell.newest_sample.program is Program.IDLE
                await until(lambda: cell.status().measured is not None)
                answer = await cell.reset(ResetRequest())
                assert not isinstance(answer, Refused), answer
                assert cell.state is CellState.READY


def configured(tmp_path: Path, **replaced: str) -> tuple[Path, str]:
    policies.still(tmp_path)
    cell, sim = free_endpoint(), free_endpoint()
    text = (ROOT / "config" / "cell.toml").read_text()
    for old, new in {
        "tcp/127.0.0.1:7447": cell,
        "tcp/127.0.0.1:7448": sim,
        '"../var/cell-1"': '"state"',
        "../models/vftm-dsl.onnx": "still.onnx",
        "sample_age_s = 0.08": "sample_age_s = 0.25\ntarget_age_s = 0.6\npolicy_deadline_s = 0.5",
        **replaced,
    }.items():
        assert old in text, old
        text = text.replace(old, new)
    path = tmp_path / "cell.toml"
    path.write_text(text)
    return path, cell


@contextmanager
def started_control(path: Path, **options: Any) -> Iterator[subprocess.Popen[bytes]]:
    """Run a control process while the context lasts."""
    process = subprocess.Popen(command("control", "--config", str(path)), cwd=ROOT, **options)
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


@asynccontextmanager
async def control_process(
    path: Path, endpoint: str, **options: Any
) -> AsyncIterator[tuple[subprocess.Popen[bytes], CellClient]]:
    with started_control(path, **options) as process:
        async with CellClient("cell-1", [endpoint]) as client:
            await until(lambda: client.state in (CellState.READY, CellState.LATCHED), 60.0)
            yield process, client


@pytest.mark.parametrize("asked", [False, True])
async def test_a_simulated_cell_has_ordinary_priority_unless_asked_and_its_loop_comes_first_then(
    tmp_path: Path, asked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(REALTIME_VARIABLE)
    driver = 'driver = "zenoh_sim"'
    path, endpoint = configured(tmp_path, **({driver: f"{driver}\nrealtime = true"} if asked else {}))
    async with control_process(path, endpoint) as (process, client):
        others = children(process.pid)
        assert len(others) == 3, "simulator, watchdog and policy"
        if not asked:
            assert schedulings(process.pid) == {ORDINARY}
            assert all(schedulings(pid) == {ORDINARY} for pid in others)
            return
        assert client.last_status is not None
        if client.last_status.degradations:
            pytest.skip("this host grants no real-time scheduling")
        highest = {words: max(schedulings(pid)) for pid, words in others.items()}
        assert max(schedulings(process.pid)) == (os.SCHED_FIFO, realtime.PRIORITY)
        for words, (policy, priority) in highest.items():
            assert policy == os.SCHED_FIFO, words
            assert priority < realtime.PRIORITY or "watchdog" in words, "the loop comes first"


async def test_a_cell_without_the_compiled_step_says_so_in_its_status(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "without").mkdir()
    (tmp_path / "without" / "sitecustomize.py").write_text(
        "import sys; sys.modules['service.policy.compiled._step'] = None"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "without"), prepend=os.pathsep)
    path, endpoint = configured(tmp_path)
    async with control_process(path, endpoint) as (_, client):
        assert client.last_status is not None
        assert [line for line in client.last_status.degradations if line.startswith("policy steps: numpy, slower")]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
async def test_48_sigterm_in_mid_run_stops_the_arm_and_ends_cleanly(tmp_path: Path, number: signal.Signals) -> None:
    path, endpoint = configured(tmp_path)
    async with control_process(path, endpoint) as (process, client):
        answer = await client.start(StartRequest(recipe="triangle-2mm", seed=EASY))
        await until(lambda: client.state in (CellState.APPROACH, CellState.RUNNING))
        process.send_signal(number)
        await asyncio.to_thread(process.wait, 20)
        assert process.returncode == 0
    async with control_process(path, endpoint) as (_, client):
        assert client.state is CellState.LATCHED
        status = client.last_status
        assert status is not None
        assert status.latch is not None
        assert status.latch.code is FaultCode.INTERRUPTED
        assert (await client.run(answer.run.id)).state is RunState.INTERRUPTED


async def test_47_a_control_process_that_is_killed_leaves_an_arm_that_stops_by_itself(tmp_path: Path) -> None:
    sim = free_endpoint()
    path, endpoint = configured(tmp_path, **{"tcp/127.0.0.1:7448": sim})
    states: list[np.void] = []

    def keep(sample: zenoh.Sample) -> None:
        states.append(records.decode(sample.payload.to_bytes(), records.STATE)[0])

    with sim_process(sim), open_session(connect=[sim]) as session:
        session.declare_subscriber(keys.STATE.format(world="world-1"), keep)
        async with control_process(path, endpoint) as (process, client):
            await client.start(StartRequest(recipe="triangle-2mm", seed=EASY))
            await until(lambda: client.state in (CellState.APPROACH, CellState.RUNNING))
            await until(lambda: states[-1]["program"] == Program.ENGAGED)
            process.kill()
            killed = states[-1]
            await until(lambda: client.state is CellState.UNKNOWN)
            await until(lambda: states[-1]["program"] == Program.IDLE)
            after = [state for state in states if state["seq"] > killed["seq"]]
            left = next(state for state in after if state["program"] != Program.ENGAGED)
            assert left["stop_reason"] in (StopReason.COMMAND, StopReason.TARGET_AGE), "a watchdog, or the arm's own"
            assert left["time_s"] - killed["time_s"] <= 0.6 + 2 * records.TICK_S, "the target age of this cell"
            rest = states[-1]
            await until(lambda: states[-1]["time_s"] >= rest["time_s"] + 0.3)
            assert np.abs(states[-1]["tcp_position"] - rest["tcp_position"]).max() < 2e-4, "it stands, by measurement"
            assert client.state is CellState.UNKNOWN, "nobody takes a silent cell for an idle one"


def run_service(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command(*arguments),
        cwd=ROOT, env=os.environ | environment, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip


def test_55_a_cell_with_a_ceiling_out_of_range_does_not_boot_and_says_which_field(tmp_path: Path) -> None:
    path, _ = configured(tmp_path, **{"force_ceiling_n = 30.0": "force_ceiling_n = 80.0"})
    ended = run_service("control", "--config", str(path))
    assert ended.returncode == 2
    assert "limits.force_ceiling_n" in ended.stderr
    assert "Traceback" not in ended.stderr


def test_an_endpoint_in_use_is_a_clear_error(tmp_path: Path) -> None:
    path, endpoint = configured(tmp_path)
    with sim_process(endpoint):
        ended = run_service("control", "--config", str(path), DSL_ASSEMBLY__SIM__AUTOSTART="false")
    assert ended.returncode == 3
    assert endpoint in ended.stderr
    assert "in use" in ended.stderr
    assert "Traceback" not in ended.stderr


async def test_81_a_second_cell_at_an_endpoint_is_refused_by_the_name_of_the_first(tmp_path: Path) -> None:
    path, endpoint = configured(tmp_path)
    async with control_process(path, endpoint) as (first, client):
        second = tmp_path / "second.toml"
        second.write_text(path.read_text().replace('"state"', '"second"').replace('id = "cell-1"', 'id = "cell-2"'))
        ended = await asyncio.to_thread(run_service, "control", "--config", str(second))
        assert ended.returncode == 3
        assert "is in use by another process: the control process of cell cell-1" in ended.stderr
        second.write_text(path.read_text())
        ended = await asyncio.to_thread(run_service, "control", "--config", str(second))
        assert ended.returncode == 3
        assert f"(process {first.pid} on " in ended.stderr
        assert client.state is CellState.READY
        assert client.last_status is not None
        assert client.last_status.latch is None, "the first is not disturbed"


def test_the_schema_is_printed_as_json() -> None:
    assert "limits" in json.loads(run_service("config", "schema").stdout)["properties"]
