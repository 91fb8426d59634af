import socket
from collections.abc import Iterator

import pytest

from sim_backend.ur_controller.assembly import make_controller
from sim_backend.ur_controller.controller import Controller
from sim_backend.ur_controller.outputs import Outputs
from sim_backend.ur_controller.plant import Plant
from sim_backend.ur_controller.server import ANY_PORTS, ControllerServer
from sim_backend.world.world import World
from wire.primary import realtime, state
from wire.primary.messages import (
    PROGRAM_STARTED,
    PROGRAM_STOPPED,
    ErrorCode,
    Key,
    Message,
    Popup,
    ReportLevel,
    RuntimeException,
    SafetyMode,
    Text,
    Version,
    decode_message,
)
from wire.primary.packages import PackageReader, PackageType
from wire.rtde import modes

HOST = "127.0.0.25"
WAIT = b"def wait():\n  while True:\n    sync()\n  end\nend\n"


@pytest.fixture
def controller() -> Controller:
    return make_controller(Plant(World(1, "tr")))


@pytest.fixture
def server(controller: Controller) -> Iterator[ControllerServer]:
    server = ControllerServer(controller, HOST, ANY_PORTS)
    yield server
    server.close()


class Client:
    """Sends script lines and keeps what comes back."""

    def __init__(self, server: ControllerServer, port: int) -> None:
        self.server = server
        self.socket = socket.create_connection((HOST, port))
        self.socket.setblocking(False)
        self.packages = PackageReader()
        self.messages: list[Message] = []
        self.states: list[dict[type, state.SubPackage]] = []

    def send(self, *pieces: bytes) -> None:
        for piece in pieces:
            self.socket.sendall(piece)
            self.step(1)

    def step(self, ticks: int) -> None:
        for _ in range(ticks):
            self.server.step()
            self.read()

    def run(self, time_s: float) -> None:
        self.step(round(500 * time_s))

    def read(self) -> None:
        try:
            data = self.socket.recv(1 << 20)
        except BlockingIOError:
            return
        for kind, content in self.packages.feed(data):
            if kind == PackageType.ROBOT_STATE:
                self.states.append({type(part): part for part in state.decode_state(content)})
            else:
                message = decode_message(content).message
                assert message is not None
                self.messages.append(message)

    def said(self, kind: type[Message]) -> list[Message]:
        return [message for message in self.messages if isinstance(message, kind)]

    @property
    def mode(self) -> state.RobotMode:
        part = self.states[-1][state.RobotMode]
        assert isinstance(part, state.RobotMode)
        return part


@pytest.fixture
def primary(server: ControllerServer) -> Iterator[Client]:
    client = Client(server, server.ports.primary)
    with client.socket:
        client.step(3)
        yield client


@pytest.fixture
def secondary(server: ControllerServer) -> Iterator[Client]:
    client = Client(server, server.ports.secondary)
    with client.socket:
        client.step(3)
        yield client


def is_closed(peer: socket.socket) -> bool:
    """Return whether the end of what was sent to a peer comes within its patience."""
    peer.settimeout(5.0)
    try:
        while peer.recv(1 << 20):
            pass
    except ConnectionResetError:
        return True
    except TimeoutError:
        return False
    return True


def test_a_connection_begins_with_the_version_and_a_whole_state(primary: Client, controller: Controller) -> None:
    version = primary.messages[0]
    configuration = primary.states[0][state.Configuration]
    kinematics = primary.states[0][state.Kinematics]

    assert isinstance(version, Version)
    assert (version.project, version.major, version.minor) == ("URControl", *controller.versions[:2])
    assert isinstance(configuration, state.Configuration)
    assert configuration.robot_type == 3
    assert configuration.joint_motion_limits[0] == pytest.approx(3.1416, abs=1e-4)
    assert isinstance(kinematics, state.Kinematics)
    assert kinematics.a[1] == -0.24355


def test_the_state_is_the_arm_s_and_comes_at_10_hz(primary: Client, controller: Controller) -> None:
    before = len(primary.states)
    primary.run(1.0)
    joints = primary.states[-1][state.Joints]
    cartesian = primary.states[-1][state.Cartesian]

    assert len(primary.states) - before == 10
    assert isinstance(joints, state.Joints)
    assert [joint.q for joint in joints.joints] == pytest.approx(controller.plant.q, abs=1e-5)
    assert isinstance(cartesian, state.Cartesian)
    assert cartesian.tcp_pose == pytest.approx(controller.plant.tcp_pose(), abs=1e-5)
    assert primary.mode.robot_mode == 7
    assert primary.mode.is_power_on


def test_a_program_is_announced_when_it_starts_and_when_it_ends(primary: Client) -> None:
    primary.send(b'def test_fun():\n  textmsg("still running")\n  sleep(0.1)\n  sync()\nend\n')
    primary.run(0.5)

    assert primary.messages[1:] == [
        Key(PROGRAM_STARTED, "test_fun"),
        Text("still running"),
        Key(PROGRAM_STOPPED, "test_fun"),
    ]


def test_a_program_may_arrive_in_pieces_and_joined_to_the_next(primary: Client, controller: Controller) -> None:
    second = b"def second():\n  while True:\n    sync()\n  end\nend\n"
    stream = WAIT + second

    primary.send(*(stream[at : at + 7] for at in range(0, len(stream), 7)))
    primary.run(0.2)

    assert primary.said(Key) == [
        Key(PROGRAM_STARTED, "wait"),
        Key(PROGRAM_STOPPED, "wait"),
        Key(PROGRAM_STARTED, "second"),
    ]
    assert controller.runtime_state is modes.RuntimeState.PLAYING


@pytest.mark.parametrize("port", ["primary", "secondary", "realtime"])
def test_a_client_may_close_after_sending(server: ControllerServer, primary: Client, port: str) -> None:
    sender = socket.create_connection((HOST, getattr(server.ports, port)))
    sender.sendall(WAIT.rstrip())
    sender.close()
    primary.run(0.1)

    assert primary.said(Key) == [Key(PROGRAM_STARTED, "wait")]


def test_a_program_moves_the_arm(primary: Client, controller: Controller) -> None:
    before = controller.plant.q.copy()
    primary.send(b"speedj([0.1, 0, 0, 0, 0, 0], 2.0, 0.5)\n")
    primary.run(0.4)

    assert controller.plant.q[0] - before[0] > 0.02


def test_a_secondary_program_runs_beside_the_main_one(primary: Client, controller: Controller) -> None:
    primary.send(WAIT, b"sec io():\n  set_standard_digital_out(2, True)\nend\n")
    primary.run(0.2)

    assert Outputs(controller).getters["actual_digital_output_bits"]() & 0b100
    assert primary.mode.is_program_running
    masterboard = primary.states[-1][state.Masterboard]
    assert isinstance(masterboard, state.Masterboard)
    assert masterboard.digital_outputs & 0b100


def test_a_state_tells_what_the_terminals_are_set_to(primary: Client, controller: Controller) -> None:
    primary.send(b"set_analog_outputdomain(1, 1)\n", b"set_standard_analog_out(1, 0.5)\n", b"set_tool_voltage(24)\n")
    primary.run(0.3)

    masterboard, tool = primary.states[-1][state.Masterboard], primary.states[-1][state.Tool]
    assert isinstance(masterboard, state.Masterboard)
    assert isinstance(tool, state.Tool)
    assert (masterboard.analog_output_domain_0, masterboard.analog_output_domain_1) == (0, 1)
    assert masterboard.analog_output_1 == 5.0
    assert tool.output_voltage == 24


def test_an_unknown_name_is_reported_with_its_place(primary: Client) -> None:
    primary.send(b"def illegal_fun():\n  calldoesntexist()\nend\n")
    primary.run(0.1)

    assert primary.said(RuntimeException) == [RuntimeException(2, 3, "compile_error_name_not_found:calldoesntexist:")]


def test_a_failure_at_run_time_is_reported_before_the_program_ends(primary: Client) -> None:
    primary.send(b"def reach():\n  movej(p[10, 0, 0, 0, 0, 0])\nend\n")
    primary.run(0.2)

    started, failed, stopped = primary.messages[1:]
    assert started == Key(PROGRAM_STARTED, "reach")
    assert isinstance(failed, RuntimeException)
    assert failed.line == 2
    assert stopped == Key(PROGRAM_STOPPED, "reach")


def test_a_protective_stop_is_a_safety_mode_and_a_warning_and_the_program_is_paused(primary: Client) -> None:
    primary.send(b"def halt_now():\n  protective_stop()\nend\n")
    primary.run(0.2)

    assert [type(message) for message in primary.messages[1:]] == [Key, SafetyMode, ErrorCode]
    assert primary.said(SafetyMode) == [SafetyMode(3)]
    [error] = primary.said(ErrorCode)
    assert isinstance(error, ErrorCode)
    assert error.level == ReportLevel.WARNING
    assert primary.mode.is_protective_stopped


def test_the_state_that_follows_a_change_of_safety_is_never_older(primary: Client, controller: Controller) -> None:
    controller.protective_stop("test")
    primary.read()

    assert primary.mode.is_protective_stopped


def test_a_protective_stop_is_unlocked_by_a_line_at_any_age(primary: Client, controller: Controller) -> None:
    controller.protective_stop("test")
    primary.run(0.1)
    assert primary.mode.is_protective_stopped

    primary.send(b"set unlock protective stop\n")
    primary.run(0.1)
    assert not primary.mode.is_protective_stopped
    assert controller.safety_mode is modes.SafetyMode.NORMAL


def test_the_arm_is_powered_and_programs_are_stopped_by_lines(primary: Client) -> None:
    primary.send(b"power off\n")
    primary.run(0.2)
    assert primary.mode.robot_mode == 3
    primary.send(b"power on\n")
    primary.run(1.0)
    assert primary.mode.robot_mode == 5
    primary.send(b"set robotmode run\n")
    primary.run(1.0)
    assert primary.mode.robot_mode == 7

    primary.send(WAIT)
    primary.run(0.2)
    assert primary.mode.is_program_running
    primary.send(b"pause program\n")
    primary.run(0.5)
    assert primary.mode.is_program_paused
    primary.send(b"resume program\n")
    primary.run(0.5)
    assert primary.mode.is_program_running
    primary.send(b"stop program\n")
    primary.run(0.5)
    assert not primary.mode.is_program_running
    assert not primary.mode.is_program_paused


def test_a_program_for_an_arm_without_power_is_refused_with_a_reason(primary: Client) -> None:
    primary.send(b"power off\n", WAIT)
    primary.run(0.1)

    [error] = primary.said(ErrorCode)
    assert isinstance(error, ErrorCode)
    assert "POWER_OFF" in error.text
    assert primary.said(Key) == []


def test_in_local_control_the_port_is_read_only_until_it_is_opened_again(
    server: ControllerServer, controller: Controller
) -> None:
    controller.remote_control = False
    early = Client(server, server.ports.primary)
    early.step(2)
    early.send(b"power off\n")
    controller.remote_control = True
    early.send(b"power off\n")
    early.run(0.1)

    assert [error.code for error in early.said(ErrorCode) if isinstance(error, ErrorCode)] == [210, 210]
    assert early.mode.robot_mode == 7

    late = Client(server, server.ports.primary)
    late.step(2)
    late.send(b"power off\n")
    late.run(0.1)
    assert late.said(ErrorCode) == []
    assert late.mode.robot_mode == 3
    early.socket.close()
    late.socket.close()


def test_a_popup_is_shown(primary: Client) -> None:
    primary.send(b'def ask():\n  popup("ready?", title="Insert", warning=True, blocking=False)\nend\n')
    primary.run(0.1)

    assert primary.said(Popup) == [Popup("Insert", "ready?", is_warning=True)]


def test_the_secondary_port_has_states_and_no_messages(secondary: Client) -> None:
    secondary.send(b"def bad():\n  nothing_there()\nend\n", WAIT)
    secondary.run(0.3)

    assert secondary.mode.is_program_running
    assert [type(message) for message in secondary.messages] == [Version]


def test_the_real_time_port_sends_every_tick(server: ControllerServer, controller: Controller) -> None:
    with socket.create_connection((HOST, server.ports.realtime)) as client:
        client.sendall(WAIT)
        for _ in range(11):
            server.step()
        data = client.recv(1 << 16)

    count, rest = divmod(len(data), realtime.SIZE)
    assert (count, rest) == (10, 0)
    stamps = [realtime.decode(data[at:])["timestamp"] for at in range(0, len(data), realtime.SIZE)]
    last = realtime.decode(data[-realtime.SIZE :])
    assert stamps == pytest.approx([controller.time_s - 0.002 * back for back in range(9, -1, -1)])
    assert last["actual_q"] == pytest.approx(controller.plant.q, abs=1e-5)
    assert last["runtime_state"] == modes.RuntimeState.PLAYING


def test_a_client_that_never_reads_can_still_send(server: ControllerServer, controller: Controller) -> None:
    with socket.socket() as client:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        client.connect((HOST, server.ports.realtime))
        for _ in range(1000):
            server.step()
        client.sendall(WAIT)
        for _ in range(3):
            server.step()

        assert controller.runtime_state is modes.RuntimeState.PLAYING


def test_a_flood_of_programs_takes_its_turns_and_is_cut_off(server: ControllerServer, primary: Client) -> None:
    with socket.create_connection((HOST, server.ports.secondary)) as flood:
        flood.sendall(b"sync()\n" * 200)
        primary.step(10)
        assert 0 < len(primary.said(Key)) < 100
        primary.run(1.0)
        assert primary.said(Key).count(Key(PROGRAM_STARTED, "unnamed")) == 200

        flood.sendall(b"sync()\n" * 1000)
        primary.step(10)
        assert is_closed(flood)


def test_a_program_without_end_is_cut_off(server: ControllerServer, primary: Client) -> None:
    flood = socket.create_connection((HOST, server.ports.secondary))
    flood.setblocking(False)
    flood.send(b"def endless():\n")
    closed = False
    for _ in range(1000):
        try:
            flood.send(b"  x = 1\n" * 1000)
        except BlockingIOError:
            pass
        except OSError:
            closed = True
            break
        server.poll()
    flood.close()

    assert closed
    primary.run(0.1)
    assert primary.said(Key) == []
