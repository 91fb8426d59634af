"""A simulated cell as its clients meet it: a process of its own, reached over Zenoh."""

import contextlib
import itertools
import json
import os
import shutil
import signal
import subprocess
import threading
import tomllib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh

from service import program
from sim_backend.world import compiled
from wire import records
from wire.endpoints import DEFAULT_ENDPOINT, DEFAULT_WORLD
from wire.session import open_session

ROOT = Path(__file__).parents[3]
PATIENCE_S = 20.0


class Process:
    """`dsl-assembly sim serve …`, from its ready line on."""

    def __init__(self, endpoint: str, *options: str, prefix: Sequence[str] = ()) -> None:
        command = [*prefix, *program.command("sim", "serve", "--listen", endpoint, *options)]
        self.popen = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert self.popen.stdout is not None
        line = self.popen.stdout.readline()
        if not line.startswith("ready "):
            raise AssertionError(f"no ready line: {line!r} {self.popen.communicate()[1]}")
        self.ready = dict(pair.split("=", 1) for pair in line.split()[1:])

    def end(self, number: signal.Signals = signal.SIGTERM) -> tuple[int, str]:
        """Signal it; return its exit code and what it wrote on standard error."""
        self.popen.send_signal(number)
        _, errors = self.popen.communicate(timeout=PATIENCE_S)
        return self.popen.returncode, errors


class Client:
    """A peer of one world, which holds it from the first request on that needs this."""

    def __init__(self, session: zenoh.Session, world: str = "world-1", name: str = "first") -> None:
        self.session = session
        self.world = world
        self.name = name
        self.word = 0
        self.seq = 0
        self.numbers = itertools.count(1)

    def claim(self) -> int:
        """Claim the world, or renew the claim; return the word."""
        claimant = json.dumps({"cell": self.name, "host": "here", "pid": 7}).encode()
        self.word = json.loads(self.ask(f"claim?client={self.word}", claimant))["client"]
        return self.word

    def signed(self, query: str, *parameters: str) -> str:
        if not self.word:
            self.claim()
        self.seq += 1
        return f"{query}?" + ";".join((*parameters, f"client={self.word}", f"seq={self.seq}"))

    def ask(self, query: str, payload: bytes = b"") -> bytes:
        """Ask one query; an error reply raises its text."""
        replies = list(self.session.get(f"sim/{self.world}/{query}", payload=payload, timeout=PATIENCE_S))
        assert len(replies) == 1
        if replies[0].ok is None:
            raise RuntimeError(replies[0].err.payload.to_string())
        return replies[0].ok.payload.to_bytes()

    def info(self) -> dict[str, Any]:
        return json.loads(self.ask("info"))

    def advance(self, ticks: int, *commands: np.ndarray) -> np.ndarray:
        return records.decode(
            self.ask(self.signed("advance", f"ticks={ticks}"), self.written(*commands)), records.STATE
        )

    def reset(self, **task: object) -> np.ndarray:
        return records.decode(self.ask(self.signed("reset"), json.dumps(task).encode()), records.STATE)

    def written(self, *commands: np.ndarray) -> bytes:
        """The commands as they go out, under this client's word."""
        if commands and not self.word:
            self.claim()
        for record in commands:
            record["client"] = self.word
        return b"".join(record.tobytes() for record in commands)

    def send(self, *commands: np.ndarray) -> None:
        payload = self.written(*commands)
        self.session.put(
            f"sim/{self.world}/command", payload, congestion_control=zenoh.CongestionControl.BLOCK, express=True
        )


class States:
    """The publications of a world, as they come."""

    def __init__(self, session: zenoh.Session) -> None:
        self._subscriber = session.declare_subscriber("sim/world-1/state", self._take)
        self._news = threading.Condition()
        self.records: list[np.void] = []

    def _take(self, sample: zenoh.Sample) -> None:
        with self._news:
            self.records.append(records.decode(sample.payload.to_bytes(), records.STATE)[0])
            self._news.notify()

    def until(self, condition: Callable[[np.void], bool]) -> np.void:
        """Wait for a state, of all since the start, that meets a condition."""
        seen = 0

        def found() -> bool:
            nonlocal seen
            while seen < len(self.records):
                if condition(self.records[seen]):
                    return True
                seen += 1
            return False

        with self._news:
            assert self._news.wait_for(found, PATIENCE_S), "no such state came"
            return self.records[seen]

    def steps(self, first: int = 0) -> list[int]:
        """Ticks of time from each state to the next, from the state numbered `first` on; lost ones are left out."""
        pairs = itertools.pairwise(record for record in self.records if record["seq"] >= first)
        return [round((b["time_s"] - a["time_s"]) / records.TICK_S) for a, b in pairs if b["seq"] == a["seq"] + 1]


@contextlib.contextmanager
def served(endpoint: str, *options: str, prefix: Sequence[str] = ()) -> Iterator[tuple[Process, Client]]:
    process = Process(endpoint, *options, prefix=prefix)
    try:
        with open_session([], [endpoint]) as session:
            yield process, Client(session)
    finally:
        if process.popen.poll() is None:
            process.popen.kill()
        process.popen.communicate()


@pytest.fixture
def lockstep(free_endpoint: str) -> Iterator[Client]:
    with served(free_endpoint, "--mode", "lockstep") as (_, client):
        yield client


@pytest.fixture
def real_time(free_endpoint: str) -> Iterator[Client]:
    with served(free_endpoint, "--mode", "real-time") as (_, client):
        yield client


def command(kind: records.Kind, epoch: int, seq: int, state: np.void, **fields: object) -> np.ndarray:
    """A command about the pose in `state`, under a soft law."""
    record = records.new(records.COMMAND, kind)
    record["epoch"], record["seq"] = epoch, seq
    record["position"], record["rotvec"] = state["tcp_position"], state["tcp_rotvec"]
    record["stiffness"] = [800, 800, 800, 40, 40, 40]
    record["damping"] = [120, 120, 120, 4, 4, 4]
    record["inertia"] = [2, 2, 2, 0.1, 0.1, 0.1]
    record["max_speed"], record["max_step"] = [0.1, 0.5], [0.05, 0.5]
    record["workspace"] = [[-1, -1, -1], [1, 1, 1]]
    record["force_ceiling"], record["target_age"] = 50.0, 10.0
    for name, value in fields.items():
        record[name] = value
    return record


def scripted_episode(client: Client, seed: int) -> bytes:
    """Engage, move down and aside, stop; every state but for the identity of world and episode."""
    state = client.reset(seed=seed, randomise_plant=True)[0]
    epoch = int(state["epoch"])
    states = [client.advance(10, command(records.Kind.ENGAGE, epoch, next(client.numbers), state))]
    for _ in range(10):
        target = states[-1][-1]["target_position"] + [0.001, 0.0, -0.004]
        moved = command(records.Kind.TARGET, epoch, next(client.numbers), states[-1][-1], position=target)
        states.append(client.advance(40, moved))
    states.append(client.advance(50, command(records.Kind.STOP, epoch, next(client.numbers), state)))
    together = np.concatenate(states)
    assert together["program"][0] == records.Program.ENGAGED
    assert together["tcp_position"][-1, 2] < state["tcp_position"][2] - 0.02
    together["epoch"] = together["episode"] = 0
    return together.tobytes()


def test_the_ready_line_names_the_world(free_endpoint: str) -> None:
    with served(free_endpoint, "--world", "left", "--mode", "lockstep", "--part", "cir") as (process, client):
        client.world = "left"
        info = client.info()
        assert process.ready == {
            "world": "left",
            "mode": "lockstep",
            "epoch": str(info["epoch"]),
            "listen": free_endpoint,
        }
        assert (info["version"], info["mode"], info["part"]) == (records.VERSION, "lockstep", "cir")


@pytest.mark.parametrize("mode", ["lockstep", "real-time"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_cleanly(free_endpoint: str, mode: str, number: signal.Signals) -> None:
    with served(free_endpoint, "--mode", mode) as (process, client):
        client.info()
        code, errors = process.end(number)
    assert code == 0
    assert "Traceback" not in errors


def test_a_port_in_use_is_one_line_and_exit_code_2(free_endpoint: str) -> None:
    with served(free_endpoint, "--mode", "lockstep"):
        second = subprocess.run(
            program.command("sim", "serve", "--listen", free_endpoint),
            cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE_S, check=False,
        )  # fmt: skip
    assert second.returncode == 2
    assert second.stderr.splitlines() == [f"sim: {free_endpoint} is in use by another process: choose another --listen"]


def test_world_and_endpoint_that_it_serves_by_default_are_those_of_the_shipped_cell() -> None:
    sim = tomllib.loads((ROOT / "config" / "cell.toml").read_text(encoding="utf-8"))["sim"]
    assert (sim["world"], sim["endpoint"]) == (DEFAULT_WORLD, DEFAULT_ENDPOINT)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--listen", "tcp/0.0.0.0:7447"], "--allow-remote"),
        (["--connect", "tcp/10.0.0.1:7447"], "--allow-remote"),
        (["--listen", "7447"], "not of the form"),
        (["--part", "hexagon"], "task.part"),
        (["--seed", "-1"], "task.seed"),
        (["--world", "a/b"], "world 'a/b'"),
        (["--mode", "fast"], "--mode"),
    ],
)
def test_an_option_that_cannot_be_met_is_named(free_endpoint: str, options: list[str], named: str) -> None:
    listen = [] if "--listen" in options else ["--listen", free_endpoint]
    process = subprocess.run(
        program.command("sim", "serve", *listen, *options),
        cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE_S, check=False,
    )  # fmt: skip
    assert process.returncode == 2
    assert named in process.stderr
    assert "Traceback" not in process.stderr


def test_lockstep_gives_the_same_bytes_for_the_same_seed_and_commands(free_endpoint: str) -> None:
    episodes: list[bytes] = []
    for seed in (5, 5, 6):
        with served(free_endpoint, "--mode", "lockstep") as (process, client):
            episodes.append(scripted_episode(client, seed))
            process.end()
    assert len(episodes[0]) == 460 * records.STATE.itemsize
    assert episodes[0] == episodes[1] != episodes[2]


def test_what_happened_before_a_reset_leaves_no_trace_after_it(lockstep: Client) -> None:
    first, second = (np.frombuffer(scripted_episode(lockstep, seed=5), records.STATE).copy() for _ in range(2))
    for states in (first, second):
        states["seq"], states["time_s"], states["command_seq"] = 0, 0, 0  # these run on
    assert first.tobytes() == second.tobytes()


def test_lockstep_publishes_nothing_and_lets_no_time_pass_by_itself(lockstep: Client) -> None:
    states = States(lockstep.session)
    before = lockstep.advance(1)["seq"][0]
    lockstep.advance(100)
    assert lockstep.advance(1)["seq"][0] == before + 101
    assert states.records == []


@pytest.mark.parametrize(
    ("query", "payload", "named"),
    [
        ("advance?ticks=0", b"", "ticks=N"),
        ("advance?ticks=1", b"half a record", "whole number"),
        ("advance", b"", "ticks=N"),
        ("reset", b"{", "not JSON"),
        ("reset", b'{"seed": 1, "colour": "red"}', "colour"),
        ("nonsense", b"", "ask one of advance, reset, claim, release, info, truth"),
        ("*", b"", "ask one of advance, reset, claim, release, info, truth"),
    ],
)
def test_a_query_that_cannot_be_read_is_refused_and_changes_nothing(
    lockstep: Client, query: str, payload: bytes, named: str
) -> None:
    before = lockstep.advance(1)
    with pytest.raises(RuntimeError, match=named):
        lockstep.ask(query, payload)
    after = lockstep.advance(1)
    assert after["seq"][0] == before["seq"][0] + 1
    assert after["episode"][0] == before["episode"][0]
    assert lockstep.info()["counters"]["queries_refused"] == 1


def test_worlds_are_found_by_a_wildcard(lockstep: Client) -> None:
    epoch = lockstep.info()["epoch"]
    (reply,) = list(lockstep.session.get("sim/*/info", timeout=PATIENCE_S))
    assert str(reply.ok.key_expr) == "sim/world-1/info"
    assert json.loads(reply.ok.payload.to_bytes())["epoch"] == epoch


def test_a_reset_starts_another_episode_with_another_part(lockstep: Client) -> None:
    first = lockstep.reset(seed=1)
    second = lockstep.reset(seed=2, part="cir", clearance_m=0.00033)
    assert second["episode"][0] == first["episode"][0] + 1
    assert lockstep.info()["part"] == "cir"
    assert json.loads(lockstep.ask("truth"))["task"]["seed"] == 2


def test_real_time_publishes_every_tick_in_order(real_time: Client) -> None:
    states = States(real_time.session)
    first = states.until(lambda _: True)
    states.until(lambda state: state["seq"] >= first["seq"] + 500)
    seqs = [int(state["seq"]) for state in states.records]
    assert seqs == sorted(set(seqs))
    assert len({int(state["epoch"]) for state in states.records}) == 1
    counters = real_time.info()["counters"]
    assert counters["ticks"] >= 500


def test_scheduling_that_the_host_refuses_is_said_and_missed_by_nothing_else(free_endpoint: str) -> None:
    prefix: list[str] = []
    if os.geteuid() == 0:
        if shutil.which("setpriv") is None:
            pytest.skip("root has every permission here, and there is no setpriv to give it up")
        prefix = ["setpriv", "--bounding-set=-sys_nice,-ipc_lock"]
    with served(free_endpoint, "--realtime", prefix=prefix) as (process, client):
        states = States(client.session)
        states.until(lambda state: state["seq"] > 50)
        degraded = client.info()["degraded"]
        code, errors = process.end()
    assert code == 0
    told = [line for line in errors.splitlines() if line != compiled.describe()]
    assert [line.removeprefix("degraded: ") for line in told] == degraded
    assert all("grant" in line for line in degraded)
    assert degraded or not prefix


def test_real_time_lets_nobody_else_advance_it(real_time: Client) -> None:
    with pytest.raises(RuntimeError, match="runs in real time"):
        real_time.ask("advance?ticks=1")


def test_real_time_commands_move_the_arm_and_a_stop_ends_it(real_time: Client) -> None:
    states = States(real_time.session)
    start = real_time.reset(seed=3)[0]
    epoch = int(start["epoch"])
    real_time.send(command(records.Kind.ENGAGE, epoch, 1, start))
    engaged = states.until(lambda state: state["program"] == records.Program.ENGAGED)
    target = engaged["target_position"] + [0.0, 0.0, 0.01]
    real_time.send(command(records.Kind.TARGET, epoch, 2, engaged, position=target))
    states.until(lambda state: state["command_seq"] == 2)
    states.until(lambda state: state["tcp_position"][2] > start["tcp_position"][2] + 0.005)
    real_time.send(command(records.Kind.STOP, 0, 3, start))
    stopped = states.until(lambda state: state["stop_reason"] == records.StopReason.COMMAND)
    idle = states.until(lambda state: state["seq"] > stopped["seq"] and state["program"] == records.Program.IDLE)
    assert np.abs(idle["qd"]).max() < 0.05


def test_a_stop_discards_what_came_before_it_in_the_same_tick(real_time: Client) -> None:
    states = States(real_time.session)
    start = real_time.reset(seed=3)[0]
    epoch = int(start["epoch"])
    real_time.send(command(records.Kind.ENGAGE, epoch, 1, start), command(records.Kind.STOP, epoch, 2, start))
    real_time.send(command(records.Kind.ENGAGE, epoch, 3, start))
    engaged = states.until(lambda state: state["program"] == records.Program.ENGAGED)
    assert engaged["command_seq"] == 3
    assert real_time.info()["counters"]["commands_dropped"] == 1


def test_a_flood_of_commands_hides_no_stop_and_leaves_the_world_up(free_endpoint: str) -> None:
    with served(free_endpoint, "--mode", "real-time") as (process, client):
        states = States(client.session)
        start = client.reset(seed=3)[0]
        epoch = int(start["epoch"])
        client.send(command(records.Kind.ENGAGE, epoch, 1, start))
        states.until(lambda state: state["program"] == records.Program.ENGAGED)
        flood = [command(records.Kind.TARGET, epoch, seq, start) for seq in range(2, 2002)]
        for index, target in enumerate(flood):
            client.send(target)
            if index == 1500:
                client.send(command(records.Kind.STOP, epoch, 9999, start))
        for _ in range(200):
            # BLOCK: what a full queue drops, nobody counts
            client.session.put("sim/world-1/command", b"garbage", congestion_control=zenoh.CongestionControl.BLOCK)
        states.until(lambda state: state["stop_reason"] == records.StopReason.COMMAND)
        states.until(lambda state: state["program"] == records.Program.IDLE and state["episode"] == start["episode"])
        assert client.info()["counters"]["commands_malformed"] > 0
        code, errors = process.end()
    assert code == 0
    assert "Traceback" not in errors


def test_it_ends_while_it_is_flooded(free_endpoint: str) -> None:
    with served(free_endpoint, "--mode", "real-time") as (process, client):
        client.info()
        over = threading.Event()

        def flood() -> None:
            publisher = client.session.declare_publisher("sim/world-1/command")
            while not over.is_set():
                publisher.put(b"garbage")

        thread = threading.Thread(target=flood)
        thread.start()
        try:
            while client.info()["counters"]["commands_malformed"] < 10_000:
                pass
            code, errors = process.end()
        finally:
            over.set()
            thread.join()
    assert (code, errors.count("Traceback")) == (0, 0)
