"""The emulated controller's ports and its tick, in one process."""

import socket
from collections.abc import Iterator
from dataclasses import asdict

import pytest

from sim_backend.ur_controller.assembly import make_controller
from sim_backend.ur_controller.controller import Controller
from sim_backend.ur_controller.listener import ListenError
from sim_backend.ur_controller.plant import Plant
from sim_backend.ur_controller.server import ANY_PORTS, ControllerServer, Ports
from sim_backend.world.world import World
from tests.sim_backend.ur_controller.rtde_peer import PATIENCE, Peer

HOST = "127.0.0.22"


@pytest.fixture
def controller() -> Controller:
    return make_controller(Plant(World(1, "tr")))


@pytest.fixture
def server(controller: Controller) -> Iterator[ControllerServer]:
    server = ControllerServer(controller, HOST, ANY_PORTS)
    yield server
    server.close()


def ask(server: ControllerServer, peer: socket.socket, line: bytes = b"") -> bytes:
    """Send a line; return the next line that comes."""
    peer.setblocking(False)
    if line:
        peer.sendall(line)
    answer = b""
    for _ in range(PATIENCE):
        server.poll()
        try:
            answer += peer.recv(4096)
        except BlockingIOError:
            continue
        if answer.endswith(b"\n"):
            return answer
    raise AssertionError(f"no line, only {answer!r}")


def test_the_ports_are_those_of_an_e_series_unless_others_are_wanted() -> None:
    assert asdict(Ports()) == {
        "rtde": 30004, "dashboard": 29999, "primary": 30001, "secondary": 30002, "realtime": 30003, "gripper": 63352,
    }  # fmt: skip


def test_every_port_is_open_until_the_server_closes(controller: Controller) -> None:
    server = ControllerServer(controller, HOST, ANY_PORTS)
    ports = list(asdict(server.ports).values())
    assert len(set(ports)) == len(ports) == 6
    for port in ports:
        socket.create_connection((HOST, port)).close()
    server.close()
    for port in ports:
        with socket.socket() as peer, pytest.raises(ConnectionRefusedError):
            peer.connect((HOST, port))


def test_closing_ends_the_program(controller: Controller) -> None:
    server = ControllerServer(controller, HOST, ANY_PORTS)
    controller.run_script("def p():\n  while True:\n    sync()\n  end\nend\n")
    server.step()
    assert controller.runtime_state.name == "PLAYING"
    server.close()
    assert controller.runtime_state.name != "PLAYING"


def test_one_taken_port_is_named_and_none_is_kept(controller: Controller) -> None:
    with socket.socket() as other, socket.socket() as probe:
        for taken in (other, probe):
            taken.bind((HOST, 0))
        other.listen()
        free = probe.getsockname()[1]
        probe.close()
        ports = Ports(rtde=free, dashboard=0, primary=0, secondary=0, realtime=0, gripper=other.getsockname()[1])
        with pytest.raises(ListenError, match=f"{HOST}:{ports.gripper}: Address already in use"):
            ControllerServer(controller, HOST, ports)
        with socket.socket() as peer, pytest.raises(ConnectionRefusedError):
            peer.connect((HOST, free))


def test_a_step_is_one_tick_and_a_poll_is_none(controller: Controller, server: ControllerServer) -> None:
    peer = Peer((HOST, server.ports.rtde), server.poll)
    with peer.socket:
        peer.begin("timestamp")
        start_s = controller.time_s
        for _ in range(5):
            server.poll()
        assert controller.time_s == start_s
        for ticks in range(1, 4):
            server.step()
            assert peer.data("d")[0] == controller.time_s == pytest.approx(start_s + ticks * 0.002, abs=1e-9)
        assert server.counters.ticks == 3


def test_what_one_port_does_another_shows(controller: Controller, server: ControllerServer) -> None:
    rtde = Peer((HOST, server.ports.rtde), server.poll)
    with rtde.socket, socket.create_connection((HOST, server.ports.dashboard)) as dashboard:
        assert ask(server, dashboard).startswith(b"Connected: Universal Robots Dashboard Server")
        rtde.begin("robot_mode")
        server.step()
        assert rtde.data("i") == (7,)
        assert ask(server, dashboard, b"power off\n") == b"Powering off\n"
        server.step()
        assert rtde.data("i") == (3,)


def test_a_script_by_the_secondary_port_writes_a_register_that_rtde_reads(server: ControllerServer) -> None:
    rtde = Peer((HOST, server.ports.rtde), server.poll)
    with rtde.socket, socket.create_connection((HOST, server.ports.secondary)) as script:
        rtde.begin("output_int_register_24,runtime_state")
        script.sendall(b"def p():\n  write_output_integer_register(24, 4711)\n  while True:\n    sync()\n  end\nend\n")
        for _ in range(100):
            server.step()
            if rtde.data("iI") == (4711, 2):
                break
        else:
            pytest.fail("the register was never written")


def test_a_gripper_answers_on_its_port(server: ControllerServer) -> None:
    with socket.create_connection((HOST, server.ports.gripper)) as peer:
        peer.setblocking(False)
        peer.sendall(b"GET STA\n")
        answer = b""
        for _ in range(PATIENCE):
            server.poll()
            try:
                answer = peer.recv(64)
                break
            except BlockingIOError:
                continue
        assert answer.startswith(b"STA ")


def test_it_runs_until_the_dashboard_shuts_it_down(server: ControllerServer) -> None:
    with socket.create_connection((HOST, server.ports.dashboard)) as dashboard:
        dashboard.sendall(b"shutdown\n")
        server.run()
        assert b"Shutting down" in dashboard.recv(4096)
    assert server.counters.ticks >= 1


def test_whatever_surrounds_the_arm_is_stepped_after_every_tick(server: ControllerServer) -> None:
    class ThreeTicks:
        def __init__(self) -> None:
            self.seen: list[int] = []

        def step(self) -> bool:
            self.seen.append(server.counters.ticks)
            if len(self.seen) == 3:
                raise SystemExit
            return True

    companion = ThreeTicks()
    with pytest.raises(SystemExit):
        server.run(companion)
    assert companion.seen == [1, 2, 3]
