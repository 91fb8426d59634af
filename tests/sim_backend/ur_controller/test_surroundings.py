"""Surroundings of the emulated robot, as its clients meet them over Zenoh."""

import json
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import zenoh

from sim_backend.ur_controller.assembly import make_controller
from sim_backend.ur_controller.plant import Plant
from sim_backend.ur_controller.server import ANY_PORTS, ControllerServer
from sim_backend.ur_controller.surroundings import Surroundings
from sim_backend.world.world import START_POSITION_M, World
from wire import keys, records
from wire.session import open_session

HOST = "127.0.0.22"
PATIENCE_S = 10.0


class Cell:
    """A controller with its surroundings; time passes in `step` only."""

    def __init__(self, session: zenoh.Session) -> None:
        self.session = session
        self.laid_out = 0
        self.word = self.seq = 0
        self.controller = make_controller(Plant(World(1, "tr")))
        self.server = ControllerServer(self.controller, HOST, ANY_PORTS)
        self.surroundings = Surroundings(self.controller, self.server, session, "bench", ["no SCHED_FIFO"])

    def step(self, ticks: int) -> None:
        for _ in range(ticks):
            self.server.step()
            self.laid_out += self.surroundings.step()

    def ask(self, query: str, payload: bytes = b"") -> bytes:
        """Ask one query and step until the answer is there; an error reply raises its text."""
        replies = self.session.get(f"sim/bench/{query}", zenoh.handlers.FifoChannel(4), payload=payload)
        end_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < end_s:
            self.step(1)
            reply = replies.try_recv()
            if reply is None:
                time.sleep(0.001)
            elif reply.ok is None:
                raise RuntimeError(reply.err.payload.to_string())
            else:
                return reply.ok.payload.to_bytes()
        raise AssertionError("no answer")

    def reset(self, **task: object) -> Any:
        return records.decode(self.ask(self.signed("reset"), json.dumps(task).encode()), records.CAMERA)[0]

    def signed(self, query: str) -> str:
        if not self.word:
            self.word = json.loads(self.ask("claim", b'{"cell": "first", "host": "here", "pid": 7}'))["client"]
        self.seq += 1
        return f"{query}?client={self.word};seq={self.seq}"

    def press(self, name: str) -> dict[str, Any]:
        return json.loads(self.ask("panel", json.dumps({"press": name}).encode()))


@pytest.fixture
def cell(free_endpoint: str) -> Iterator[Cell]:
    with open_session([free_endpoint]) as session:
        cell = Cell(session)
        yield cell
        cell.surroundings.close()
        cell.server.close()


def test_a_reset_lays_out_an_episode_and_gives_its_first_camera_frame(cell: Cell) -> None:
    cell.controller.plant.place((0.30, 0.10, 0.25))
    cell.step(30)
    before_s = cell.controller.time_s
    frame = cell.reset(seed=7, clearance_m=0.00033)
    assert frame["kind"] == records.Kind.CAMERA
    assert (frame["epoch"], frame["episode"]) == (cell.surroundings.epoch, 1)
    assert before_s < frame["time_s"] <= cell.controller.time_s
    np.testing.assert_allclose(cell.controller.plant.tcp_pose()[:3], START_POSITION_M, atol=1e-3)
    truth = json.loads(cell.ask("truth"))
    assert (truth["task"]["seed"], truth["task"]["clearance_m"]) == (7, 0.00033)
    estimated, true = frame["position"], np.array(truth["hole_position"])
    assert 0 < np.linalg.norm(estimated - true) < 0.02
    assert cell.laid_out == 1, "only a reset takes longer than a tick"
    assert cell.reset(seed=8)["episode"] == 2


def test_a_reset_may_change_the_part(cell: Cell) -> None:
    cell.reset(seed=1, part="cir")
    assert json.loads(cell.ask("info"))["part"] == "cir"
    assert json.loads(cell.ask("truth"))["task"]["part"] == "cir"


@pytest.mark.parametrize(
    ("query", "payload", "named"),
    [
        ("reset", b"{", "reset: the payload is not JSON"),
        ("reset", b"[1]", "JSON object"),
        ("reset", b'{"seed": 1, "colour": "red"}', "colour"),
        ("reset", b'{"seed": 1, "part": "hexagon"}', "part"),
        ("advance", b"", "ask one of reset, claim, release, truth, info, panel"),
        ("*", b"", "ask one of reset, claim, release, truth, info, panel"),
        ("panel", b"", "not JSON"),
        ("panel", b'{"press": "everything"}', "takes one of emergency_stop"),
        ("panel", b'{"press": ["local"]}', "takes one of"),
        ("panel", b'{"press": "local", "hold": true}', "takes one of"),
        ("panel", b" " * 5000, "at most 4096"),
    ],
)
def test_a_query_that_cannot_be_read_is_refused_and_changes_nothing(
    cell: Cell, query: str, payload: bytes, named: str
) -> None:
    before = cell.ask("truth")
    with pytest.raises(RuntimeError, match=named):
        cell.ask(query, payload)
    assert json.loads(cell.ask("truth"))["task"] == json.loads(before)["task"]
    assert cell.controller.remote_control


def take_frames(cell: Cell) -> Callable[[int, int], Any]:
    """Subscribe; what is returned waits for `count` frames of an episode since, and steps the cell while it waits."""
    subscriber = cell.session.declare_subscriber(keys.CAMERA.format(world="bench"), zenoh.handlers.FifoChannel(256))

    def taken(episode: int, count: int) -> Any:
        frames: list[Any] = []
        end_s = time.monotonic() + PATIENCE_S
        while len(frames) < count and time.monotonic() < end_s:
            sample = subscriber.try_recv()
            if sample is None:
                cell.step(1)
                continue
            frames += [
                frame
                for frame in records.decode(sample.payload.to_bytes(), records.CAMERA)
                if frame["episode"] == episode
            ]
        return np.array(frames)

    return taken


def test_the_frame_after_a_resets_own_comes_40_ms_later(cell: Cell) -> None:
    taken = take_frames(cell)
    cell.reset(seed=1)
    cell.step(7)
    first = cell.reset(seed=2)
    (second,) = taken(2, 1)
    assert second["time_s"] - first["time_s"] == pytest.approx(0.040, abs=1e-9)


def test_the_camera_gives_a_frame_every_40_ms_on_the_clock_of_the_arm(cell: Cell) -> None:
    taken = take_frames(cell)
    first_s = cell.controller.time_s
    positions: dict[float, list[float]] = {}
    for _ in range(100):
        cell.step(1)
        positions[cell.controller.time_s] = cell.controller.plant.estimate.tolist()
    records = taken(0, 5)
    np.testing.assert_allclose(records["time_s"], first_s + 0.002 + np.arange(5) * 0.040, atol=1e-9)
    np.testing.assert_array_equal(np.diff(records["seq"].astype(int)), [20] * 4)
    for record in records:
        assert positions[float(record["time_s"])] == record["position"].tolist()
    assert len({tuple(record["position"]) for record in records}) > 1, "a camera without noise"


def test_info_says_what_this_is(cell: Cell) -> None:
    info = json.loads(cell.ask("info"))
    assert (info["mode"], info["version"], info["epoch"]) == ("ur-controller", records.VERSION, cell.surroundings.epoch)
    assert info["ports"]["rtde"] == cell.server.ports.rtde
    assert info["controller"].startswith("5.21.")
    assert info["degraded"] == ["no SCHED_FIFO"]
    assert info["state"] == {
        "robot_mode": "RUNNING", "safety_mode": "NORMAL", "runtime_state": "STOPPED", "remote_control": True,
    }  # fmt: skip
    assert info["counters"]["ticks"] > 0


def test_the_emergency_stop_of_the_panel_takes_the_power_and_the_way_back_is_a_persons(cell: Cell) -> None:
    assert cell.press("emergency_stop")["safety_mode"] == "ROBOT_EMERGENCY_STOP"
    assert cell.press("power_on")["robot_mode"] == "POWER_OFF"
    assert cell.press("release_emergency_stop")["safety_mode"] == "NORMAL"
    cell.press("power_on")
    cell.step(500)
    assert cell.controller.robot_mode.name == "IDLE"
    cell.press("brake_release")
    cell.step(500)
    assert cell.controller.robot_mode.name == "RUNNING"


def test_the_safeguard_pauses_a_program_and_its_closing_lets_it_go_on(cell: Cell) -> None:
    cell.controller.run_script("def p():\n  while True:\n    sync()\n  end\nend\n")
    cell.step(2)
    assert cell.press("open_safeguard")["safety_mode"] == "SAFEGUARD_STOP"
    cell.step(500)
    assert cell.controller.runtime_state.name == "PAUSED"
    assert cell.press("close_safeguard")["safety_mode"] == "NORMAL"
    cell.step(500)
    assert cell.press("stop")["runtime_state"] in ("STOPPING", "STOPPED")


def test_a_protective_stop_is_not_unlocked_at_once(cell: Cell) -> None:
    cell.controller.protective_stop("a drill")
    with pytest.raises(RuntimeError, match="Cannot unlock protective stop until 5s after occurrence"):
        cell.press("unlock_protective_stop")
    cell.step(2600)
    assert cell.press("unlock_protective_stop")["safety_mode"] == "NORMAL"


def test_the_key_switch_chooses_who_commands(cell: Cell) -> None:
    assert cell.press("local")["remote_control"] is False
    assert cell.press("remote")["remote_control"] is True
