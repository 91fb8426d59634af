"""In real time, each in its own process: an emulated controller, its control process, the operator's commands."""

import asyncio
import json
import os
import re
import subprocess
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from itertools import cycle
from pathlib import Path
from typing import NamedTuple

import pytest

from service.client import CellClient
from service.drivers.ur.rtde import RtdeClient
from service.drivers.ur.script_upload import upload
from service.messages import CellState, StartRequest
from service.program import command
from tests.service.drivers.ur.attitudes import movej, targets
from tests.service.drivers.ur.cells import UR
from tests.service.sim_server import free_endpoint
from wire.rtde.modes import RuntimeState

ROOT = Path(__file__).parents[4]
HOST = UR["host"]
WORLD = "emulated"
LIMITS = """
sample_age_s = 0.4
target_age_s = 0.9
policy_deadline_s = 0.5
"""
"""Time limits of a test's cell: so wide that the lateness of a loaded test machine trips none of them."""


class Robot(NamedTuple):
    ports: dict[str, int]
    endpoint: str


@contextmanager
def served_robot() -> Iterator[Robot]:
    endpoint = free_endpoint()
    process = subprocess.Popen(
        [
            *command("sim", "ur-controller", "--host", HOST, "--any-ports"),
            *("--world", WORLD, "--listen", endpoint, "--realtime"),
        ],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        assert line.startswith("ready"), line
        said = dict(part.split("=", 1) for part in line.split()[1:])
        yield Robot({name: int(said[name]) for name in ("rtde", "dashboard", "primary", "gripper")}, endpoint)
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


@pytest.fixture(scope="module")
def robot() -> Iterator[Robot]:
    with served_robot() as robot:
        yield robot


@pytest.fixture
def config(robot: Robot, tmp_path: Path) -> Path:
    text = (ROOT / "config/ur-emulated.toml").read_text()
    for old, new in {
        "tcp/127.0.0.1:7447": free_endpoint(),
        "tcp/127.0.0.1:7448": robot.endpoint,
        "world-1": WORLD,
        'host = "127.0.0.1"\nsimulated': "\n".join(
            [
                f'host = "{HOST}"',
                *(f"{name}_port = {port}" for name, port in robot.ports.items()),
                "watchdog_hz = 4.0\nsimulated",
            ]
        ),
        "../var/cell-ur": str(tmp_path / "state"),
        "../models": str(ROOT / "models"),
        "sample_age_s = 0.08": LIMITS,
    }.items():
        assert old in text, old
        text = text.replace(old, new)
    path = tmp_path / "cell.toml"
    path.write_text(text)
    return path


def service(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command(*arguments),
        cwd=ROOT,
        env=os.environ | {"COLUMNS": "200"},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_an_operator_moves_the_gripper(config: Path) -> None:
    def ask(action: str) -> subprocess.CompletedProcess[str]:
        return service("ur", "gripper", action, "--config", str(config))

    assert "holds something" in ask("status").stdout, "the world begins with the peg in the fingers"
    assert "active, holds nothing, 85.0 mm open" in ask("open").stdout
    assert "holds something, 28." in ask("close").stdout
    assert "holds something" in ask("status").stdout


def test_an_operator_checks_switches_off_and_on_again(config: Path) -> None:
    checked = service("ur", "check", "--config", str(config))
    assert checked.returncode == 0, checked.stdout + checked.stderr
    assert checked.stdout.count("passed") == 12
    assert service("ur", "power-off", "--config", str(config)).returncode == 0
    checked = service("ur", "check", "--config", str(config))
    assert checked.returncode == 1
    assert "POWER_OFF" in checked.stdout
    assert "power-on" in checked.stdout
    unlocked = service("ur", "unlock", "--config", str(config))
    assert unlocked.returncode == 1
    assert "no protective stop" in unlocked.stderr
    assert service("ur", "power-on", "--config", str(config)).returncode == 0


def test_the_operator_s_commands_of_a_cell_without_a_ur_arm_say_so() -> None:
    refused = service("ur", "check", "--config", str(ROOT / "config/cell.toml"))
    assert refused.returncode == 2
    assert "cell.driver" in refused.stderr


class Weighed(NamedTuple):
    status: int
    out: str
    told: list[str]


async def weigh(config: Path, robot: Robot, *options: str) -> Weighed:
    """Run the command, and move the arm by programs of another client whenever it asks for another attitude."""
    process = await asyncio.create_subprocess_exec(
        *command("ur", "weigh", "--config", str(config), *options),
        cwd=ROOT,
        env=os.environ | {"COLUMNS": "200"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stdout is not None
    assert process.stderr is not None
    told: list[str] = []
    start, *others = targets()
    moves = cycle([*others, start])
    try:
        async with asyncio.timeout(120.0):
            async for line in process.stderr:
                told.append(line.decode().strip())
                if told[-1].startswith(("next:", "only")):
                    await upload(HOST, robot.ports["primary"], movej(next(moves)))
            out = (await process.stdout.read()).decode()
            return Weighed(await process.wait(), out, told)
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()


def changed(config: Path, changes: dict[str, str]) -> Path:
    """Write the configuration anew with other text."""
    text = config.read_text()
    for old, new in changes.items():
        assert old in text, old
        text = text.replace(old, new)
    config.write_text(text)
    return config


async def missing(config: Path) -> list[str]:
    """Start a control process, and return what its status says of the weighing."""
    async with control_process(config) as (_, client):
        await until(lambda: client.state is CellState.READY)
        assert client.last_status is not None
        return [line for line in client.last_status.degradations if "was not weighed" in line]


async def test_a_real_arm_s_status_asks_for_the_weighing_until_its_sensor_is_proven(config: Path, robot: Robot) -> None:
    changed(config, {"simulated = true": "simulated = false", 'driver = "ur"': 'driver = "ur"\nrealtime = false'})
    assert len(await missing(config)) == 1
    done = await weigh(config, robot, "--json")
    assert done.status == 0, done.told
    found = json.loads(done.out)
    assert found["passed"] is True
    assert found["findings"] == []
    assert found["unproven_torques"] == ["Tz"]
    assert [found["axes"][name]["proven"] for name in "xyz"] == [True] * 3
    assert max(at["off_n"] for at in found["attitudes"]) < found["limit_n"] == 2.0
    assert found["payload"]["centre_m"] == pytest.approx([0.0, 0.0, 0.0585], abs=0.02)
    assert found["payload"]["sensor_kg"] == pytest.approx(0.93, abs=0.1)
    assert await missing(config) == []
    changed(config, {"payload_kg = 0.93": "payload_kg = 1.5"})
    assert len(await missing(config)) == 1, "another payload is another weighing"


async def test_a_wrong_payload_is_weighed_and_told_with_status_1(config: Path, robot: Robot) -> None:
    note = config.parent / "state/weighed.json"
    note.parent.mkdir(exist_ok=True)
    note.write_text("of an earlier weighing")
    done = await weigh(changed(config, {"payload_kg = 0.93": "payload_kg = 1.5"}), robot)
    assert done.status == 1
    assert re.search(r"gain 0\.6\d on all axes: the sensor weighs (0\.9|1\.0)\d kg", done.out), "the sensor drifts"
    assert "weight shown, at least 4 N" in done.out
    assert "force off, limit 2 N" in done.out
    assert "by the sensor, about" in done.out
    assert "centre" not in done.out, "it is not known before the forces are right"
    assert not note.exists(), "a weighing that fails takes an earlier proof back"


def test_a_payload_that_weighs_too_little_is_refused_at_once(config: Path) -> None:
    refused = service("ur", "weigh", "--config", str(changed(config, {"payload_kg = 0.93": "payload_kg = 0.1"})))
    assert refused.returncode == 2
    assert "grip a heavier thing" in refused.stderr


@asynccontextmanager
async def control_process(config: Path) -> AsyncIterator[tuple[subprocess.Popen[bytes], CellClient]]:
    endpoint = next(line.split('"')[1] for line in config.read_text().splitlines() if line.startswith("endpoint"))
    process = subprocess.Popen(command("control", "--config", str(config)), cwd=ROOT, stderr=subprocess.DEVNULL)
    try:
        async with CellClient("cell-ur", [endpoint]) as client:
            yield process, client
    finally:
        process.kill()
        process.wait()


class Reading(NamedTuple):
    time_s: float
    qd: tuple[float, ...]
    force: tuple[float, ...]
    runtime_state: int

    @property
    def force_n(self) -> float:
        return sum(component**2 for component in self.force[:3]) ** 0.5


async def until(condition: Callable[[], object]) -> None:
    async with asyncio.timeout(60.0):
        while not condition():
            await asyncio.sleep(0.002)


@asynccontextmanager
async def onlooker(robot: Robot) -> AsyncIterator[list[Reading]]:
    """Read the controller over a connection of its own; yield the readings, to which each package adds one."""
    readings: list[Reading] = []
    client = RtdeClient(
        HOST,
        robot.ports["rtde"],
        clock=asyncio.get_running_loop().time,
        on_package=lambda values, arrival_s: readings.append(Reading._make(values)),
        on_lost=lambda error: None,
    )
    await client.connect()
    await client.setup(["timestamp", "actual_qd", "actual_TCP_force", "runtime_state"], 500.0)
    await client.start()
    try:
        yield readings
    finally:
        await client.close()


async def test_a_control_process_that_is_killed_while_it_pushes_leaves_an_arm_that_stands(
    config: Path, robot: Robot
) -> None:
    """Only the controller is left to stop the arm: its watchdog, whose period is a quarter of a second here."""

    async with onlooker(robot) as readings, control_process(config) as (process, client):
        await until(lambda: client.state is CellState.READY)
        await client.start(StartRequest(recipe="triangle-2mm", seed=5))
        await until(lambda: client.state is CellState.RUNNING)
        await until(lambda: readings[-1].force_n > 5.0)
        assert readings[-1].runtime_state == RuntimeState.PLAYING
        process.kill()
        killed_s = readings[-1].time_s
        await until(lambda: readings[-1].time_s > killed_s + 1.5)
    after = [reading for reading in readings if reading.time_s >= killed_s]
    ended_s = next(reading.time_s for reading in after if reading.runtime_state != RuntimeState.PLAYING)
    assert ended_s - killed_s < 0.25 + 0.5, "the watchdog's period, and what the onlooker may be late by"
    assert max(abs(speed) for reading in after if reading.time_s > ended_s + 0.3 for speed in reading.qd) < 2e-3
    assert max(reading.force_n for reading in after) < 30.0, "the ceiling"
