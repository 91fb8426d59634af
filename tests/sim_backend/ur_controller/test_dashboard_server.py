import socket
from collections.abc import Iterator

import pytest

from sim_backend.ur_controller.assembly import make_controller
from sim_backend.ur_controller.controller import Controller
from sim_backend.ur_controller.dashboard_server import BANNER, LOG_CHARACTERS, NOT_REMOTE, DashboardService
from sim_backend.ur_controller.listener import Listener
from sim_backend.ur_controller.plant import Plant
from sim_backend.ur_controller.safety import UNLOCK_AFTER_S, UNLOCK_TOO_EARLY
from sim_backend.world.world import World

HOST = "127.0.0.25"
WAIT = "def wait():\n  while True:\n    sync()\n  end\nend\n"
REMOTE_ONLY = (
    *("load wait.urp", "play", "stop", "pause", "shutdown", "power on", "power off", "brake release"),
    *("unlock protective stop", "load installation default.installation", "restart safety"),
)


@pytest.fixture
def controller() -> Controller:
    controller = make_controller(Plant(World(1, "tr")))
    controller.programs["wait.urp"] = WAIT
    return controller


@pytest.fixture
def dashboard(controller: Controller) -> DashboardService:
    return DashboardService(controller)


def tick(controller: Controller, time_s: float = 1.0) -> None:
    for _ in range(round(time_s * 500)):
        controller.tick()


def test_power_goes_off_and_on_again(controller: Controller, dashboard: DashboardService) -> None:
    assert dashboard.answer("robotmode") == "Robotmode: RUNNING"
    assert dashboard.answer("power on") == "Powering on"
    assert dashboard.answer("robotmode") == "Robotmode: RUNNING"

    assert dashboard.answer("power off") == "Powering off"
    assert dashboard.answer("robotmode") == "Robotmode: POWER_OFF"
    assert dashboard.answer("power on") == "Powering on"
    tick(controller)
    assert dashboard.answer("robotmode") == "Robotmode: IDLE"
    assert dashboard.answer("brake release") == "Brake releasing"
    tick(controller)
    assert dashboard.answer("robotmode") == "Robotmode: RUNNING"


def test_releasing_the_brakes_powers_on_where_needed(controller: Controller, dashboard: DashboardService) -> None:
    dashboard.answer("power off")

    assert dashboard.answer("brake release") == "Brake releasing"
    tick(controller)
    assert dashboard.answer("robotmode") == "Robotmode: RUNNING"


def test_a_program_is_loaded_played_paused_and_stopped(controller: Controller, dashboard: DashboardService) -> None:
    assert dashboard.answer("get loaded program") == "No program loaded"
    assert dashboard.answer("programState") == "STOPPED <unnamed>"

    assert dashboard.answer("load wait.urp") == "Loading program: wait.urp"
    assert dashboard.answer("get loaded program") == "Loaded program: /programs/wait.urp"
    assert dashboard.answer("isProgramSaved") == "true wait.urp"
    assert dashboard.answer("programState") == "STOPPED wait.urp"

    assert dashboard.answer("play") == "Starting program"
    tick(controller, 0.1)
    assert dashboard.answer("running") == "Program running: true"
    assert dashboard.answer("programState") == "PLAYING wait.urp"

    assert dashboard.answer("pause") == "Pausing program"
    tick(controller, 0.5)
    assert dashboard.answer("running") == "Program running: false"
    assert dashboard.answer("programState") == "PAUSED wait.urp"
    assert dashboard.answer("play") == "Starting program"
    tick(controller, 0.5)
    assert dashboard.answer("programState") == "PLAYING wait.urp"

    assert dashboard.answer("stop") == "Stopped"
    tick(controller, 0.5)
    assert dashboard.answer("running") == "Program running: false"
    assert dashboard.answer("programState") == "STOPPED wait.urp"


def test_a_program_is_found_by_the_name_at_the_end_of_its_path(dashboard: DashboardService) -> None:
    assert dashboard.answer("load /ursim/programs/wait.urp") == "Loading program: /ursim/programs/wait.urp"
    assert dashboard.answer("programState") == "STOPPED wait.urp"


@pytest.mark.parametrize(
    ("command", "reply"),
    [
        ("load none.urp", "File not found: none.urp"),
        ("load installation none.installation", "File not found: none.installation"),
        ("play", "Failed to execute: play"),
        ("stop", "Failed to execute: stop"),
        ("pause", "Failed to execute: pause"),
        ("addToLog", "No log message to add"),
        ("set operational mode sideways", "Failed setting operational mode: sideways"),
        ("dance", "could not understand: 'dance'"),
        ("powers", "could not understand: 'powers'"),
    ],
)
def test_what_cannot_be_done_is_refused_in_the_controller_s_words(
    dashboard: DashboardService, command: str, reply: str
) -> None:
    assert dashboard.answer(command) == reply


def test_a_program_that_runs_keeps_another_from_being_loaded(
    controller: Controller, dashboard: DashboardService
) -> None:
    controller.programs["other.urp"] = WAIT
    dashboard.answer("load wait.urp")
    dashboard.answer("play")

    assert dashboard.answer("load other.urp") == "Error while loading program: other.urp"
    assert dashboard.answer("get loaded program") == "Loaded program: /programs/wait.urp"


def test_a_program_does_not_start_without_power(dashboard: DashboardService) -> None:
    dashboard.answer("load wait.urp")
    dashboard.answer("power off")

    assert dashboard.answer("play") == "Failed to execute: play"


def test_a_protective_stop_is_unlocked_after_5_s(controller: Controller, dashboard: DashboardService) -> None:
    controller.protective_stop("test")
    assert dashboard.answer("safetymode") == "Safetymode: PROTECTIVE_STOP"
    assert dashboard.answer("safetystatus") == "Safetystatus: PROTECTIVE_STOP"

    tick(controller, UNLOCK_AFTER_S - 0.1)
    assert dashboard.answer("unlock protective stop") == UNLOCK_TOO_EARLY
    assert dashboard.answer("safetystatus") == "Safetystatus: PROTECTIVE_STOP"

    tick(controller, 0.2)
    assert dashboard.answer("unlock protective stop") == "Protective stop releasing"
    assert dashboard.answer("safetystatus") == "Safetystatus: NORMAL"
    assert dashboard.answer("close safety popup") == "closing safety popup"


def test_a_fault_ends_with_a_restart_of_the_safety_system(controller: Controller, dashboard: DashboardService) -> None:
    controller.fault("test")
    assert dashboard.answer("safetystatus") == "Safetystatus: FAULT"

    assert dashboard.answer("restart safety") == "Restarting safety"
    tick(controller)
    assert dashboard.answer("safetystatus") == "Safetystatus: NORMAL"
    assert dashboard.answer("robotmode") == "Robotmode: POWER_OFF"


def test_it_says_who_it_is(dashboard: DashboardService) -> None:
    assert dashboard.answer("PolyscopeVersion").startswith("URSoftware 5.21.")
    assert dashboard.answer("version").count(".") == 3
    assert dashboard.answer("get robot model") == "UR3"
    assert dashboard.answer("get serial number").isdigit()
    assert dashboard.answer("get serial number").startswith("20")


def test_names_of_commands_are_not_case_sensitive(dashboard: DashboardService) -> None:
    assert dashboard.answer("ROBOTMODE") == dashboard.answer("Robotmode") == "Robotmode: RUNNING"
    assert dashboard.answer("polyscopeversion") == dashboard.answer("PolyscopeVersion")


def test_popups_and_the_log_are_kept(dashboard: DashboardService) -> None:
    assert dashboard.answer("popup Check the Gripper") == "showing popup"
    assert dashboard.popup == "Check the Gripper"
    assert dashboard.answer("close popup") == "closing popup"
    assert dashboard.popup is None

    assert dashboard.answer("addToLog Batch 7") == "Added log message"
    assert list(dashboard.log) == ["Batch 7"]
    dashboard.answer(f"addToLog {'x' * 60_000}")
    assert len(dashboard.log[-1]) == LOG_CHARACTERS
    assert dashboard.answer("saveLog") == "Log saved to disk"


def test_closing_the_popup_lets_a_program_go_on(controller: Controller, dashboard: DashboardService) -> None:
    controller.run_script('def ask():\n  popup("ready?", blocking=True)\n  textmsg("go")\nend\n')
    tick(controller, 0.1)
    assert dashboard.answer("running") == "Program running: true"

    dashboard.answer("close popup")
    tick(controller, 0.1)
    assert dashboard.answer("running") == "Program running: false"


def test_the_operational_mode_is_controlled_until_it_is_cleared(dashboard: DashboardService) -> None:
    assert dashboard.answer("get operational mode") == "NONE"
    assert dashboard.answer("set operational mode AUTOMATIC") == "Operational mode AUTOMATIC is set"
    assert dashboard.answer("get operational mode") == "AUTOMATIC"
    assert dashboard.answer("set operational mode manual") == "Operational mode MANUAL is set"
    assert dashboard.answer("clear operational mode").startswith("No longer controlling the operational mode.")
    assert dashboard.answer("get operational mode") == "NONE"


def test_reports_are_answered_with_a_name(dashboard: DashboardService) -> None:
    assert dashboard.answer("generate flight report").startswith("Flight Report generated with id: system")
    assert dashboard.answer("generate support file .").startswith("Completed successfully: ur_20")
    assert dashboard.answer("generate flight report weather").startswith("Unknown flight report type")


@pytest.mark.parametrize("command", REMOTE_ONLY)
def test_in_local_control_it_only_answers_questions(
    controller: Controller, dashboard: DashboardService, command: str
) -> None:
    controller.remote_control = False

    assert dashboard.answer("is in remote control") == "false"
    assert dashboard.answer(command, may_command=False) == NOT_REMOTE
    assert dashboard.answer("robotmode", may_command=False) == "Robotmode: RUNNING"
    assert not dashboard.shutdown_requested


def test_shutting_down_takes_the_power_and_is_told(dashboard: DashboardService) -> None:
    assert dashboard.answer("shutdown") == "Shutting down"
    assert dashboard.answer("robotmode") == "Robotmode: POWER_OFF"
    assert dashboard.shutdown_requested


class Terminal:
    """A client that types lines."""

    def __init__(self, listener: Listener, port: int) -> None:
        self.listener = listener
        self.socket = socket.create_connection((HOST, port))
        self.socket.setblocking(False)

    def type(self, data: bytes) -> None:
        self.socket.sendall(data)

    def read(self) -> bytes:
        for _ in range(1000):
            self.listener.poll()
            try:
                return self.socket.recv(65536)
            except BlockingIOError:
                continue
        return b"(silence)"


@pytest.fixture
def listener() -> Iterator[Listener]:
    listener = Listener()
    yield listener
    listener.close()


@pytest.fixture
def port(listener: Listener, dashboard: DashboardService) -> int:
    return listener.serve(dashboard, HOST, 0)


@pytest.fixture
def terminal(listener: Listener, port: int) -> Iterator[Terminal]:
    terminal = Terminal(listener, port)
    assert terminal.read() == BANNER.encode() + b"\n"
    with terminal.socket:
        yield terminal


def test_lines_may_come_in_pieces_and_joined(terminal: Terminal) -> None:
    terminal.type(b"robot")
    assert terminal.read() == b"(silence)"
    terminal.type(b"mode\r\nrunning\n")

    answers = terminal.read()
    while answers.count(b"\n") < 2:
        answers += terminal.read()
    assert answers == b"Robotmode: RUNNING\nProgram running: false\n"


def test_quit_says_goodbye_and_closes(terminal: Terminal) -> None:
    terminal.type(b"quit\n")

    assert terminal.read() == b"Disconnected\n"
    assert terminal.read() == b""


def test_many_lines_at_once_are_all_answered(dashboard: DashboardService, terminal: Terminal) -> None:
    terminal.type(b"running\n" * 500)

    answers = b""
    while len(answers) < 500 * len(b"Program running: false\n"):
        dashboard.publish()
        answers += terminal.read()
    assert answers == b"Program running: false\n" * 500


def test_a_line_without_end_closes_the_connection(terminal: Terminal) -> None:
    terminal.type(b"x" * 100_000)

    assert terminal.read() == b""


def test_a_connection_from_before_the_switch_stays_without_rights(
    controller: Controller, listener: Listener, port: int
) -> None:
    controller.remote_control = False
    early = Terminal(listener, port)
    early.read()
    controller.remote_control = True
    late = Terminal(listener, port)
    late.read()

    early.type(b"power off\n")
    assert early.read() == NOT_REMOTE.encode() + b"\n"
    late.type(b"power off\n")
    assert late.read() == b"Powering off\n"
    early.socket.close()
    late.socket.close()


def test_without_the_remote_control_function_commands_are_taken(controller: Controller, terminal: Terminal) -> None:
    controller.remote_control_enabled = False

    terminal.type(b"is in remote control\n")
    assert terminal.read() == b"false\n"
    terminal.type(b"power off\n")
    assert terminal.read() == b"Powering off\n"
