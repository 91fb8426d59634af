"""`dsl-assembly sim ur-controller` as its users meet it: a process of its own, in real time."""

import contextlib
import json
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from service.program import command
from tests.sim_backend.ur_controller.rtde_peer import Peer
from wire import records
from wire.session import open_session

ROOT = Path(__file__).parents[3]
HOST = "127.0.0.22"
PATIENCE_S = 20.0
COMMAND = command("sim", "ur-controller", "--host", HOST)


class Process:
    def __init__(self, *options: str) -> None:
        self.popen = subprocess.Popen(
            [*COMMAND, *options], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert self.popen.stdout is not None
        line = self.popen.stdout.readline()
        if not line.startswith("ready "):
            raise AssertionError(f"no ready line: {line!r} {self.popen.communicate()[1]}")
        self.ready = dict(pair.split("=", 1) for pair in line.split()[1:])

    def port(self, name: str) -> tuple[str, int]:
        return self.ready["host"], int(self.ready[name])

    def wait(self) -> tuple[int, str]:
        """Exit code, and what it wrote on standard error."""
        _, errors = self.popen.communicate(timeout=PATIENCE_S)
        return self.popen.returncode, errors


@contextlib.contextmanager
def served(*options: str) -> Iterator[Process]:
    process = Process(*options)
    try:
        yield process
    finally:
        if process.popen.poll() is None:
            process.popen.kill()
        process.popen.communicate()


def test_three_clients_are_served_in_real_time_and_a_signal_ends_it() -> None:
    with served("--any-ports") as process:
        peers = [Peer(process.port("rtde"), lambda: time.sleep(0.001)) for _ in range(3)]
        for peer in peers:
            peer.begin("timestamp,actual_q")
        for peer in peers:
            stamps = [peer.data("7d")[0] for _ in range(100)]
            assert round((stamps[-1] - stamps[0]) * 500) == 99
        process.popen.send_signal(signal.SIGTERM)
        code, errors = process.wait()
        for peer in peers:
            peer.socket.close()
    assert code == 0
    assert "Traceback" not in errors


def test_the_ready_line_names_world_and_ports_and_the_world_answers(free_endpoint: str) -> None:
    with served("--any-ports", "--world", "left", "--listen", free_endpoint, "--part", "cir", "--seed", "3") as process:
        with open_session([], [free_endpoint]) as session:
            (reply,) = list(session.get("sim/left/info", timeout=PATIENCE_S))
            info = json.loads(reply.ok.payload.to_bytes())
            assert {name: int(process.ready[name]) for name in info["ports"]} == info["ports"]
            assert (info["mode"], info["part"]) == ("ur-controller", "cir")
            assert (process.ready["world"], process.ready["epoch"]) == ("left", str(info["epoch"]))
            assert process.ready["listen"] == free_endpoint
            (reply,) = list(session.get("sim/left/truth", timeout=PATIENCE_S))
            assert json.loads(reply.ok.payload.to_bytes())["task"]["seed"] == 3
            claimant = b'{"cell": "first", "host": "here", "pid": 7}'
            (reply,) = list(session.get("sim/left/claim", payload=claimant, timeout=PATIENCE_S))
            reset = f"sim/left/reset?client={json.loads(reply.ok.payload.to_bytes())['client']};seq=1"
            (reply,) = list(session.get(reset, payload=b'{"seed": 9}', timeout=PATIENCE_S))
            frame = records.decode(reply.ok.payload.to_bytes(), records.CAMERA)[0]
            assert (int(frame["epoch"]), int(frame["episode"])) == (info["epoch"], 1)
        process.popen.send_signal(signal.SIGINT)
        assert process.wait()[0] == 0


def test_a_client_shuts_it_down() -> None:
    with served("--any-ports") as process, socket.create_connection(process.port("dashboard")) as dashboard:
        dashboard.sendall(b"shutdown\n")
        code, errors = process.wait()
    assert (code, errors.count("Traceback")) == (0, 0)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--host", "0.0.0.0"], "--allow-remote"),  # noqa: S104, it is to be refused
        (["--part", "hexagon"], "task.part"),
        (["--any-ports", "--world", "a/b", "--listen"], "world 'a/b'"),
    ],
)
def test_an_option_that_cannot_be_met_is_named(free_endpoint: str, options: list[str], named: str) -> None:
    if options[-1] == "--listen":
        options = [*options, free_endpoint]
    process = subprocess.run(
        [*COMMAND, *options], cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    assert process.returncode == 2
    assert named in process.stderr
    assert "Traceback" not in process.stderr


def test_a_port_in_use_is_one_line_and_exit_code_2() -> None:
    with socket.socket() as other:
        other.bind((HOST, 29999))
        other.listen()
        process = subprocess.run(COMMAND, cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert process.returncode == 2
    lines = [line for line in process.stderr.splitlines() if not line.startswith("degraded:")]
    assert lines == [f"sim: cannot listen at {HOST}:29999: Address already in use"]


def test_programs_of_a_folder_are_loaded_and_played_from_the_dashboard(tmp_path: Path) -> None:
    (tmp_path / "nod.script").write_text("def nod():\n  movej([0.1, -1.9, -1.7, -1.1, 1.57, 0.0])\nend\n")
    with served("--any-ports", "--programs", str(tmp_path)) as process:
        with socket.create_connection(process.port("dashboard"), PATIENCE_S) as dashboard:
            lines = dashboard.makefile("rw", newline="\n")
            lines.readline()
            said = []
            for order in ("load nod.urp", "play"):
                lines.write(order + "\n")
                lines.flush()
                said.append(lines.readline().strip())
        peer = Peer(process.port("rtde"), lambda: time.sleep(0.001))
        peer.begin("actual_q")
        moved = any(abs(peer.data("6d")[0] - 0.1) < 0.01 for _ in range(3000))
        peer.socket.close()
    assert said == ["Loading program: nod.urp", "Starting program"]
    assert moved
    process = subprocess.run([*COMMAND, "--programs", str(tmp_path / "none")], cwd=ROOT, capture_output=True, text=True)
    assert process.returncode == 2
    assert "no *.script file" in process.stderr
