"""A control loop that is late, hangs or is killed: the watchdog apart from it, systemd, and the loop's own count.

Rows 47 and 50. The faults come from underneath: the kernel stops the control process and lets it go on.
"""

import asyncio
import os
import signal
import socket
import subprocess
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import zenoh

from service.cell.lateness import Lateness
from service.client import CellClient
from service.commands.drivers import brake_of
from service.drivers.base import Program, Sample
from service.drivers.sim_wire import read_sample
from service.drivers.watchdog import UNREAD_BEATS, Watchdog
from service.faults import FaultCode
from service.messages import CellState, Counters, Latch, StartRequest
from service.notify import Notifier
from tests.service.cell.conftest import EASY
from tests.service.cell.test_process import configured, control_process, until
from tests.service.drivers.ur.emulated import emulated, ur_cell_config
from tests.service.sim_server import free_endpoint, sim_process
from wire import keys
from wire.records import StopReason
from wire.rtde.modes import RuntimeState
from wire.session import close_session, open_session
from wire.task import Task

SAMPLE_AGE_S = 0.25
"""Age limit of a sample in a test's cell, s. It is the watchdog's limit, too."""


class Witness:
    """Keeps what the simulator says to a session of its own."""

    def __init__(self) -> None:
        self.samples: list[Sample] = []

    def keep(self, state: zenoh.Sample) -> None:
        self.samples.append(read_sample(state.payload.to_bytes(), time.monotonic()))

    def engaged(self) -> bool:
        return bool(self.samples) and self.samples[-1].program is Program.ENGAGED


@dataclass
class Stand:
    """A control process in a run, and a witness of the arm."""

    process: subprocess.Popen[bytes]
    client: CellClient
    witness: Witness

    @property
    def counters(self) -> Counters:
        status = self.client.last_status
        assert status is not None
        return status.counters

    @property
    def latch(self) -> Latch | None:
        status = self.client.last_status
        assert status is not None
        return status.latch

    async def stands(self) -> StopReason:
        """Wait until the arm stands; return why its own controller stopped."""
        await until(lambda: not self.witness.engaged())
        reason = self.witness.samples[-1].stop_reason
        await until(lambda: np.linalg.norm(self.witness.samples[-1].tcp_velocity[:3]) < 2e-3)
        return reason


@asynccontextmanager
async def running(tmp_path: Path) -> AsyncIterator[Stand]:
    """Yield a cell in a run whose arm would go on by itself for a second without a word."""
    sim = free_endpoint()
    path, endpoint = configured(
        tmp_path,
        **{
            "tcp/127.0.0.1:7448": sim,
            "sample_age_s = 0.08": f"sample_age_s = {SAMPLE_AGE_S}\ntarget_age_s = 1.0\npolicy_deadline_s = 0.5",
        },
    )
    with sim_process(sim):
        async with control_process(path, endpoint) as (process, client):
            session, witness = await asyncio.to_thread(open_session, (), [sim]), Witness()
            session.declare_subscriber(keys.STATE.format(world="world-1"), witness.keep)
            try:
                await client.start(StartRequest(recipe="triangle-2mm", seed=EASY))
                await until(lambda: client.state is CellState.RUNNING and witness.engaged())
                yield Stand(process, client, witness)
            finally:
                process.send_signal(signal.SIGCONT)
                await asyncio.to_thread(close_session, session)


def run_time_s(pid: int) -> float:
    """Return the time for which a process's main thread has run."""
    return int(Path(f"/proc/{pid}/schedstat").read_text().split()[0]) * 1e-9


async def test_50_a_loop_that_hangs_in_a_run_is_stopped_from_outside(tmp_path: Path) -> None:
    async with running(tmp_path) as stand:
        stand.process.send_signal(signal.SIGSTOP)
        reason = await stand.stands()
        assert reason is StopReason.COMMAND, "by a command, not by the arm's own watchdog"
        stand.process.send_signal(signal.SIGCONT)
        await until(lambda: stand.client.state is CellState.LATCHED)
        assert stand.latch is not None
        assert stand.latch.code in (FaultCode.STALE, FaultCode.OVERRUN, FaultCode.AUTHORITY)
        assert stand.counters.loop_late_max_s > SAMPLE_AGE_S


async def test_47_a_killed_control_process_is_stopped_for_before_the_arm_notices(tmp_path: Path) -> None:
    async with running(tmp_path) as stand:
        stand.process.kill()
        assert await stand.stands() is StopReason.COMMAND


async def test_50_one_burst_is_counted_and_the_run_goes_on(tmp_path: Path) -> None:
    async with running(tmp_path) as stand:
        before = stand.counters
        stand.process.send_signal(signal.SIGSTOP)
        await asyncio.sleep(0.08)
        stand.process.send_signal(signal.SIGCONT)
        await until(lambda: stand.counters.loop_overruns > before.loop_overruns)
        assert stand.counters.loop_late_max_s >= 0.06
        assert stand.latch is None
        assert stand.witness.engaged()


async def test_50_a_hog_that_delays_every_turn_latches_overrun(tmp_path: Path) -> None:
    async with running(tmp_path) as stand:
        while stand.witness.engaged():
            stand.process.send_signal(signal.SIGSTOP)
            await asyncio.sleep(0.05)
            ran = run_time_s(stand.process.pid)
            stand.process.send_signal(signal.SIGCONT)
            # Long enough for one turn, on a loaded machine too, and too short for two
            while stand.witness.engaged() and run_time_s(stand.process.pid) - ran < 1e-3:
                await asyncio.sleep(0.001)
        stand.process.send_signal(signal.SIGCONT)
        await until(lambda: stand.client.state is CellState.LATCHED)
        assert stand.latch is not None
        assert stand.latch.code is FaultCode.OVERRUN, stand.latch.text
        assert await stand.stands() is StopReason.COMMAND


async def test_a_watchdog_that_ends_is_told_and_the_run_goes_on(tmp_path: Path) -> None:
    async with running(tmp_path) as stand:
        children = Path(f"/proc/{stand.process.pid}/task/{stand.process.pid}/children").read_text().split()
        commands = {int(pid): Path(f"/proc/{pid}/cmdline").read_bytes() for pid in children}
        (watchdog,) = (pid for pid, command in commands.items() if b"service.drivers.watchdog" in command)
        os.kill(watchdog, signal.SIGKILL)
        await until(
            lambda: (
                stand.client.last_status is not None
                and any("the watchdog has ended" in line for line in stand.client.last_status.degradations)
            )
        )
        assert stand.latch is None


async def test_a_watchdog_attends_once_it_is_ready_and_while_it_reads_the_beats(tmp_path: Path) -> None:
    with Watchdog(("dashboard", "127.0.0.1", "1"), 60.0) as watchdog:
        assert not watchdog.attends, "it has just been started"
        await until(lambda: watchdog.attends)
        os.kill(watchdog.pid, signal.SIGSTOP)
        beats = 0
        while watchdog.attends:
            assert watchdog.beat(armed=True), "it has not ended"
            beats += 1
            assert beats <= 2 * UNREAD_BEATS
        os.kill(watchdog.pid, signal.SIGCONT)
        await until(lambda: watchdog.beat(armed=True) and watchdog.attends)
        os.kill(watchdog.pid, signal.SIGKILL)
        await until(lambda: not watchdog.beat(armed=True))
        assert not watchdog.beat(armed=False), "what has ended does not come again"


async def test_50_the_watchdog_of_a_ur_ends_the_program_through_the_dashboard(tmp_path: Path) -> None:
    async with emulated(ur_cell_config(tmp_path / "state", tmp_path / "none.onnx")) as arm:
        await arm.driver.connect(arm)
        await arm.driver.prepare(Task(3, "tr", 2e-3, "easy"))
        with Watchdog(brake_of(arm.config), 0.5) as watchdog:
            watchdog.beat(armed=False)
            await asyncio.sleep(1.0)  # no word, but no run either
            for _ in range(20):
                assert watchdog.beat(armed=True)
                await asyncio.sleep(0.05)
            assert arm.controller.runtime_state is RuntimeState.PLAYING
            async with asyncio.timeout(10.0):
                while arm.controller.runtime_state is not RuntimeState.STOPPED:
                    await asyncio.sleep(0.01)


async def test_an_idle_loop_wakes_its_watchdog_seldom_and_disarms_it_at_once(tmp_path: Path) -> None:
    async with emulated(ur_cell_config(tmp_path / "state", tmp_path / "none.onnx")) as arm:
        await arm.driver.connect(arm)
        await arm.driver.prepare(Task(3, "tr", 2e-3, "easy"))
        with Watchdog(brake_of(arm.config), 0.5) as watchdog:
            for armed in (False, True, False):
                assert watchdog.beat(armed=armed)
            await asyncio.sleep(1.0)  # the last beat was of an idle loop
            assert arm.controller.runtime_state is RuntimeState.PLAYING
            woken = wakings(watchdog.pid)
            for _ in range(200):
                assert watchdog.beat(armed=False)
                await asyncio.sleep(0.002)
            assert wakings(watchdog.pid) - woken <= 20
            os.kill(watchdog.pid, signal.SIGKILL)
            await until(lambda: not watchdog.beat(armed=False))


def wakings(pid: int) -> int:
    """Return how often the main thread of a process has gone to sleep."""
    status = Path(f"/proc/{pid}/task/{pid}/status").read_text()
    return int(status.partition("\nvoluntary_ctxt_switches:")[2].split()[0])


# --- systemd


def test_systemd_is_told_that_the_cell_is_ready_and_alive_and_ends(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(5.0)
        environment = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "200000"}
        with Notifier(environment) as notifier:
            notifier.send("READY=1")
            assert systemd.recv(100) == b"READY=1"
            begun = time.monotonic()
            beats = 0
            while time.monotonic() - begun < 0.5:
                notifier.beat()
                time.sleep(0.002)
            systemd.setblocking(False)
            while True:
                try:
                    assert systemd.recv(100) == b"WATCHDOG=1"
                except BlockingIOError:
                    break
                beats += 1
            assert 5 <= beats <= 12, "one every 50 ms"


@pytest.mark.parametrize("environment", [{}, {"NOTIFY_SOCKET": "/nowhere/at/all", "WATCHDOG_USEC": "1000"}])
def test_without_systemd_nothing_is_sent_and_nothing_is_raised(environment: dict[str, str]) -> None:
    with Notifier(environment) as notifier:
        notifier.send("READY=1")
        notifier.beat()


# --- the count


def test_lateness_has_its_largest_its_percentile_and_its_overruns() -> None:
    lateness = Lateness(0.02)
    assert (lateness.p99_s, lateness.max_s) == (0.0, 0.0)
    for _ in range(990):
        lateness.note(0.001)
    for _ in range(10):
        lateness.note(0.03)
    assert 0.001 <= lateness.p99_s <= 0.03
    lateness.note(-0.001)
    assert (lateness.overruns, lateness.in_a_row, lateness.max_s) == (10, 0, 0.03)
    for _ in range(2000):
        lateness.note(0.05)
    assert lateness.p99_s == 0.05
