"""The policy's process: what it answers, and what becomes of one that hangs, dies or lies. Rows 24, 26, 28 and 72."""

import asyncio
import errno
import os
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, closing
from pathlib import Path

import numpy as np
import pytest

from service.cell import policy_process
from service.cell.cell import Cell
from service.cell.policies import PolicyRefusedError, PolicyShelf
from service.cell.policy_process import PolicyProcess
from service.cell.process import attended
from service.cell.tick_record import TickRecord
from service.client import CellRefusedError
from service.drivers.base import Program
from service.drivers.zenoh_sim import ZenohSimDriver
from service.faults import FaultCode
from service.messages import CellState, Event, ResetRequest, RunState, StartRequest, StatusResult, Telemetry
from service.policy.model import Policy, PolicyError
from service.policy.worker import RECEIVED_AT_ONCE_BYTES
from service.testing import RECIPE, cell_config, lockstep_cell
from tests.service.cell import policies
from tests.service.cell.conftest import EASY
from tests.service.cell.faulty_driver import FaultyDriver
from tests.service.cell.test_process import LIMITS, configured, control_process, started, until
from tests.service.policy.model_files import HANGS
from tests.service.sim_server import sim_process
from wire import realtime
from wire.records import TICK_S

END_S = 2.0
LARGEST_OF_A_REFUSED_WORKER = """
import pathlib, resource, sys
from service.cell.policy_process import PolicyProcess
from service.policy.model import Policy, PolicyError
from service.policy.worker import RECEIVED_AT_ONCE_BYTES
worker = PolicyProcess(pathlib.Path(sys.argv[1]), step_limit_s=1.0)
try:
    worker.loaded()
except PolicyError:
    worker.close()
    print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""
"""Program of a process whose only child is a worker; it prints the largest memory of that child, KiB."""


def workers_of(pid: int) -> list[int]:
    """Return the living processes of policies that a process has started."""
    children = [int(child) for task in Path(f"/proc/{pid}/task").iterdir() for child in _children(task)]
    return [child for child in children if b"service.policy.worker" in _command(child)]


def _children(task: Path) -> list[str]:
    try:
        return (task / "children").read_text().split()
    except OSError:
        return []


def _command(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


async def no_workers_of(pid: int, seconds: float = 30.0) -> None:
    async with asyncio.timeout(seconds):
        while workers_of(pid):
            await asyncio.sleep(0.01)


class Records:
    """Keeps the records of policy steps."""

    def __init__(self) -> None:
        self.records: list[TickRecord] = []

    def on_tick(self, record: TickRecord) -> None:
        self.records.append(record)

    def on_event(self, event: Event) -> None: ...

    def on_telemetry(self, point: Telemetry) -> None: ...


@asynccontextmanager
async def real_cell(tmp_path: Path, endpoint: str, policy: Path) -> AsyncIterator[tuple[Cell, FaultyDriver]]:
    """A cell as its control process makes it, on a simulator in real time; the driver notes the orders."""
    with sim_process(endpoint):
        driver = FaultyDriver(ZenohSimDriver("world-1", [endpoint], "real_time"))
        driver.real_time = True
        cell = Cell(cell_config(tmp_path / "state", policy, LIMITS | {"sample_age_s": 0.45}, conditions="easy"), driver)
        cell.lateness.limit_s = 0.45  # a loaded test machine is late, which these tests are not about
        async with attended(cell):
            await until(lambda: cell.state is CellState.READY)
            yield cell, driver


async def latched(cell: Cell, driver: FaultyDriver, run_id: str, code: FaultCode) -> None:
    """Assert the latch in the record and in the motion."""
    await until(lambda: cell.state is CellState.LATCHED)
    run, latch = cell.runs.find(run_id), cell.journal.latch
    assert run is not None
    assert latch is not None
    assert (run.state, run.code, latch.code) == (RunState.LATCHED, code, code), run.text
    first_stop = min(at for at in driver.said("stop") if at >= driver.said("engage")[-1])
    assert [at for at in driver.said("target") if at > first_stop] == []
    await until(lambda: driver.truth is not None and driver.truth.program is Program.IDLE)
    assert driver.truth is not None
    assert np.linalg.norm(driver.truth.tcp_velocity[:3]) < 2e-3


async def reset(cell: Cell) -> None:
    async with asyncio.timeout(10.0):
        while not isinstance(await cell.reset(ResetRequest()), StatusResult):
            await asyncio.sleep(0.01)  # a loaded machine's samples are too old now and then


# --- lockstep


def test_a_contract_longer_than_one_read_of_the_socket_comes_whole(tmp_path: Path) -> None:
    path = policies.still(tmp_path, provenance={"log": "x" * 5 * RECEIVED_AT_ONCE_BYTES})
    with closing(PolicyProcess(path, step_limit_s=1.0)) as worker:
        assert worker.loaded()[1] == Policy.load(path).contract


async def test_a_run_through_the_policys_process_is_the_same_bit_for_bit(tmp_path: Path) -> None:
    ended = []
    for inference in ({}, {"inference": None}):
        policy = policies.straight(tmp_path)
        config = cell_config(tmp_path / f"state {len(ended)}", policy, conditions="easy")
        async with lockstep_cell(config, **inference) as bench:
            run = await bench.insert(EASY)
            assert run.state is RunState.SUCCEEDED
            first = bench.records[0].sample.seq  # time passes while a run is admitted
            steps = [(r.sample.seq - first, r.action.tobytes(), r.target.position.tobytes()) for r in bench.records]
            ended.append((steps, run.steps, run.peak_force_n))
    assert ended[0] == ended[1]


@pytest.mark.parametrize("when", ["first", "later"])
async def test_72_a_model_that_hangs_in_lockstep_latches_policy_deadline(tmp_path: Path, when: str) -> None:
    config = cell_config(tmp_path / "state", policies.hanging(tmp_path, when), conditions="easy")
    async with lockstep_cell(config, inference=None) as bench:
        run = await bench.insert(EASY)
        assert (run.state, run.code) == (RunState.LATCHED, FaultCode.POLICY_DEADLINE)
        assert run.steps == (0 if when == "first" else 3)
        await no_workers_of(os.getpid())
        await reset(bench.cell)
        again = await bench.insert(EASY)
        assert again.code is FaultCode.POLICY_DEADLINE, "its process was started anew"


# --- real time


@pytest.mark.parametrize("when", ["first", "later"])
async def test_26_inference_that_hangs_is_held_for_then_latches_while_the_monitor_goes_on(
    tmp_path: Path, free_endpoint: str, when: str
) -> None:
    async with real_cell(tmp_path, free_endpoint, policies.hanging(tmp_path, when)) as (cell, driver):
        cell.journal.observers.append(kept := Records())
        run_id = await started(cell)
        steps = 0 if when == "first" else 3
        await until(
            lambda: cell.state is CellState.LATCHED or (cell.state is CellState.RUNNING and len(kept.records) >= steps)
        )
        await asyncio.sleep(0.12)
        assert cell.state is CellState.RUNNING, f"it holds: {cell.journal.latch}"
        samples, sent = cell.status().counters.samples, len(driver.said("target"))
        await latched(cell, driver, run_id, FaultCode.POLICY_DEADLINE)
        assert len(driver.said("target")) == sent
        assert cell.status().counters.samples - samples > 50
        await no_workers_of(os.getpid())


async def test_a_worker_that_is_killed_in_a_run_latches_policy_invalid_and_the_next_run_has_another(
    tmp_path: Path, free_endpoint: str
) -> None:
    async with real_cell(tmp_path, free_endpoint, policies.still(tmp_path)) as (cell, driver):
        run_id = await started(cell)
        await until(lambda: cell.state is CellState.RUNNING)
        (worker,) = workers_of(os.getpid())
        os.kill(worker, signal.SIGKILL)
        await latched(cell, driver, run_id, FaultCode.POLICY_INVALID)
        run = cell.runs.find(run_id)
        assert run is not None
        assert "the process of" in run.text
        await reset(cell)
        await started(cell)
        (other,) = workers_of(os.getpid())
        assert other != worker


async def test_24_a_graph_that_answers_nan_latches_policy_invalid_and_nothing_of_it_is_sent(
    tmp_path: Path, free_endpoint: str
) -> None:
    policy = policies.not_a_number(tmp_path)
    async with real_cell(tmp_path, free_endpoint, policy) as (cell, driver):
        run_id = await started(cell)
        await until(lambda: cell.state in (CellState.RUNNING, CellState.LATCHED))
        sent = len(driver.said("target"))
        await latched(cell, driver, run_id, FaultCode.POLICY_INVALID)
        run = cell.runs.find(run_id)
        assert run is not None
        assert "action is not finite" in run.text
        assert run.steps == 0
        assert len(driver.said("target")) - sent <= 1, "nothing of it was sent"


async def test_28_a_policy_replaced_on_disk_runs_on_and_the_next_start_is_refused(
    tmp_path: Path, free_endpoint: str
) -> None:
    policy = policies.straight(tmp_path)
    async with real_cell(tmp_path, free_endpoint, policy) as (cell, _):
        run_id = await started(cell)
        policy.write_bytes(policies.still(tmp_path).read_bytes())
        await until(lambda: cell.runs.find(run_id) is not None and cell.runs.active is None)
        run = cell.runs.find(run_id)
        assert run is not None
        assert run.state is RunState.SUCCEEDED, run.text
        answer = await cell.start(StartRequest(recipe=RECIPE, seed=EASY))
        assert "was replaced since it was admitted" in answer.problem.detail  # type: ignore[union-attr]
        os.kill(workers_of(os.getpid())[0], signal.SIGKILL)
        await no_workers_of(os.getpid())
        answer = await cell.start(StartRequest(recipe=RECIPE, seed=EASY))
        assert "was replaced since it was admitted" in answer.problem.detail, "and not loaded anew either"  # type: ignore[union-attr]


# --- admission


def test_72_a_model_that_hangs_at_load_is_refused_and_its_process_is_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(policy_process, "LOAD_S", 2.0)
    config = cell_config(tmp_path / "state", policies.hanging(tmp_path, "load"))
    with closing(PolicyShelf(config, TICK_S, PolicyProcess.opener(1.0, lockstep=False))) as shelf:
        for _ in range(2):
            with pytest.raises(PolicyRefusedError, match=r"TOO_SLOW: .*was not loaded and tried within 2 s"):
                shelf.admit(RECIPE)
        assert workers_of(os.getpid()) == []


async def test_72_an_inference_without_an_end_takes_no_core_from_the_host_though_nobody_kills_it(
    tmp_path: Path,
) -> None:
    policy = policies.hanging(tmp_path, "first")
    with closing(PolicyProcess(policy, step_limit_s=1.0, realtime=True)) as worker:
        observation = np.ones(worker.loaded()[1].observation_size, np.float32)
        if os.sched_getscheduler(worker.pid) != os.SCHED_FIFO:
            pytest.skip("this host grants no real-time scheduling")
        assert os.sched_getparam(worker.pid).sched_priority < realtime.PRIORITY, "the loop comes first"
        failures: list[Exception] = []
        worker.infer(lambda action: None, failures.append).ask(observation)
        await until(lambda: failures)
        assert "has ended" in str(failures[0])


def test_a_policy_slower_than_its_deadline_is_refused(tmp_path: Path) -> None:
    policy = policies.still(tmp_path)
    wanted = pytest.raises(PolicyError, match=r"TOO_SLOW: .* ms for one inference, limits.policy_deadline_s is")
    with closing(PolicyProcess(policy, step_limit_s=1e-7)) as worker, wanted:
        worker.loaded()


def test_29_a_model_that_wants_all_memory_is_refused(tmp_path: Path) -> None:
    script = [sys.executable, "-P", "-c", LARGEST_OF_A_REFUSED_WORKER, str(policies.greedy(tmp_path))]
    largest_kib = int(subprocess.run(script, capture_output=True, text=True, check=True).stdout)
    assert 2**15 < largest_kib < 2**20, "it loaded the libraries, and took less than 1 GiB"


def test_a_policy_for_which_there_is_no_process_is_refused_and_tried_again(tmp_path: Path) -> None:
    full = True

    def opener(path: Path, sha256: str | None) -> PolicyProcess:
        if full:
            raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        return PolicyProcess(path, sha256, step_limit_s=1.0)

    config = cell_config(tmp_path / "state", policies.still(tmp_path))
    with closing(PolicyShelf(config, TICK_S, opener)) as shelf:
        with pytest.raises(PolicyRefusedError, match=r"no process for .* can be made: Resource"):
            shelf.admit(RECIPE)
        full = False
        shelf.admit(RECIPE)


def test_recipes_with_one_policy_share_a_process(tmp_path: Path) -> None:
    config = cell_config(tmp_path / "state", policies.still(tmp_path))
    recipes = {name: next(iter(config.recipes.values())) for name in ("one", "two")}
    config = config.model_copy(update={"recipes": recipes})
    with closing(PolicyShelf(config, TICK_S, PolicyProcess.opener(1.0, lockstep=False))) as shelf:
        assert shelf.admit("one") == shelf.admit("two")
        assert len(workers_of(os.getpid())) == 1


# --- the control process


@pytest.mark.parametrize("when", HANGS)
async def test_72_the_control_process_outlives_a_model_that_hangs_burns_no_core_and_ends_on_sigterm(
    tmp_path: Path, when: str
) -> None:
    path, endpoint = configured(tmp_path)
    (tmp_path / "still.onnx").write_bytes(policies.hanging(tmp_path, when).read_bytes())
    async with control_process(path, endpoint) as (process, client):
        if when == "load":
            await no_workers_of(process.pid)
            with pytest.raises(CellRefusedError, match="TOO_SLOW"):
                await client.start(StartRequest(recipe="triangle-2mm", seed=EASY))
            assert client.state is CellState.READY
        else:
            await client.start(StartRequest(recipe="triangle-2mm", seed=EASY))
            await until(lambda: client.state is CellState.LATCHED)
            status = client.last_status
            assert status is not None
            assert status.latch is not None
            assert status.latch.code is FaultCode.POLICY_DEADLINE, status.latch.text
            await no_workers_of(process.pid, 1.0)
        process.send_signal(signal.SIGTERM)
        begun = time.monotonic()
        await asyncio.to_thread(process.wait, 20)
        assert time.monotonic() - begun <= END_S
        assert process.returncode == 0


async def test_72_sigterm_while_a_model_hangs_at_load_ends_both(tmp_path: Path) -> None:
    path, endpoint = configured(tmp_path)
    (tmp_path / "still.onnx").write_bytes(policies.hanging(tmp_path, "load").read_bytes())
    async with control_process(path, endpoint) as (process, client):
        assert client.state is CellState.READY, "the cell is up although its policy is not"
        (worker,) = workers_of(process.pid)
        process.send_signal(signal.SIGTERM)
        begun = time.monotonic()
        await asyncio.to_thread(process.wait, 20)
        assert time.monotonic() - begun <= END_S
        assert process.returncode == 0
        assert _command(worker) == b""


async def test_72_a_killed_control_process_takes_the_policys_process_along(tmp_path: Path) -> None:
    path, endpoint = configured(tmp_path)
    async with control_process(path, endpoint) as (process, _):
        (worker,) = workers_of(process.pid)
        process.kill()
        await until(lambda: _command(worker) == b"")
