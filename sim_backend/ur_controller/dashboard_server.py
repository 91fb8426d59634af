"""Dashboard server, TCP 29999: lines of text by which a host plays programs, powers the arm and queries its modes.

Commands, replies and the set that needs remote control follow the vendor's dashboard document for e-Series and were
checked with the vendor's own clients. The refusal outside remote control is quoted from robots in the field.
"""

import math
from collections import deque
from collections.abc import Callable

from sim_backend.ur_controller.controller import Controller
from sim_backend.ur_controller.events import Event, ProgramStopped, Refused
from sim_backend.ur_controller.listener import Connection
from wire.rtde.modes import RuntimeState

BANNER = "Connected: Universal Robots Dashboard Server"
NOT_REMOTE = (
    "Command is not allowed due to safety reasons, "
    "please switch robot to Remote Control mode and reconnect to port 29999"
)
UNNAMED = "<unnamed>"  # a program that was never saved: none is loaded, or it was sent to a script port
PROGRAM_FOLDER = "/programs/"
INSTALLATIONS = ("default.installation",)
BUILD_DATE = "Mar 12 2025"

HEARS_OF_AN_END_AFTER_S = 0.2
"""Time for which `stop` still treats a just ended program as running: PolyScope learns of the end from the 10 Hz state
messages, and clients that end their own program send `stop` immediately afterwards."""
LOG_LINES, LOG_CHARACTERS = 1000, 500
"""Limits of the log: lines, and characters of a line."""
_LINES_PER_TICK = 16  # per connection, so that the tick stays in time
_WAITING_BYTES = 1 << 16  # a peer that sends more without a line end is not a dashboard client

_MODEL_NAMES = {1: "UR5", 2: "UR10", 3: "UR3", 4: "UR16", 7: "UR20", 8: "UR30"}
_STATE_WORDS = {RuntimeState.STOPPED: "STOPPED", RuntimeState.PAUSED: "PAUSED"}
_OPERATIONAL_MODES = ("MANUAL", "AUTOMATIC")
_REPORT_KINDS = ("", "controller", "software", "system")


class DashboardService:
    """Answers each line with one line.

    Attributes:
        popup: text of the message on the screen; None without one.
        log: newest lines of the log, written by `addToLog`.
        operational_mode: mode set by the dashboard; None while the dashboard does not control it.
        shutdown_requested: a client has asked the controller to shut down.
    """

    def __init__(self, controller: Controller) -> None:
        self.popup: str | None = None
        self.log: deque[str] = deque(maxlen=LOG_LINES)
        self.operational_mode: str | None = None
        self.shutdown_requested = False
        self._controller = controller
        self._ended_s = -math.inf
        controller.events.append(self._on_event)
        self._lines: dict[Connection, bytearray] = {}
        self._was_remote: dict[Connection, bool] = {}
        self._remote_only: dict[str, Callable[[str], str]] = {
            "load installation": self._load_installation,
            "load": self._load,
            "play": self._play,
            "stop": self._stop,
            "pause": self._pause,
            "shutdown": self._shutdown,
            "power on": self._doing(controller.power_on, "Powering on"),
            "power off": self._doing(controller.power_off, "Powering off"),
            "brake release": self._doing(controller.brake_release, "Brake releasing"),
            "unlock protective stop": self._doing(controller.unlock_protective_stop, "Protective stop releasing"),
            "restart safety": self._doing(controller.restart_safety, "Restarting safety"),
        }
        self._always: dict[str, Callable[[str], str]] = {
            "close safety popup": self._doing(controller.close_safety_popup, "closing safety popup"),
            "running": lambda _: f"Program running: {self._word(self._is_running)}",
            "robotmode": lambda _: f"Robotmode: {controller.robot_mode.name}",
            "safetymode": lambda _: f"Safetymode: {controller.safety_mode.name}",
            "safetystatus": lambda _: f"Safetystatus: {controller.safety_mode.name}",
            "programstate": self._program_state,
            "get loaded program": self._loaded_program,
            "isprogramsaved": self._is_program_saved,
            "popup": self._show_popup,
            "close popup": self._close_popup,
            "addtolog": self._add_to_log,
            "savelog": lambda _: "Log saved to disk",
            "polyscopeversion": lambda _: f"URSoftware {self._version} ({BUILD_DATE})",
            "version": lambda _: self._version,
            "get robot model": lambda _: _MODEL_NAMES[controller.robot_type],
            "get serial number": lambda _: controller.serial,
            "is in remote control": lambda _: self._word(
                controller.remote_control_enabled and controller.remote_control
            ),
            "set operational mode": self._set_operational_mode,
            "get operational mode": lambda _: self.operational_mode or "NONE",
            "clear operational mode": self._clear_operational_mode,
            "generate flight report": self._flight_report,
            "generate support file": self._support_file,
        }
        # Longest first: `load` is also the beginning of `load installation`.
        self._names = sorted((*self._remote_only, *self._always), key=len, reverse=True)

    def on_connect(self, connection: Connection) -> None:
        """Send the greeting."""
        self._lines[connection] = bytearray()
        self._was_remote[connection] = self._controller.takes_commands
        _reply(connection, BANNER)

    def on_data(self, connection: Connection, data: bytes) -> None:
        """Answer complete lines; keep an incomplete one until its end arrives."""
        self._lines[connection] += data
        self._answer_lines(connection)
        if len(self._lines[connection]) > _WAITING_BYTES:
            connection.close()

    def on_close(self, connection: Connection) -> None:
        """Discard the state of the peer."""
        del self._lines[connection], self._was_remote[connection]

    def publish(self) -> None:
        """Answer lines left over from earlier ticks; nothing is sent unasked."""
        for connection, waiting in self._lines.items():
            if waiting:
                self._answer_lines(connection)

    def _answer_lines(self, connection: Connection) -> None:
        *lines, rest = self._lines[connection].split(b"\n", _LINES_PER_TICK)
        self._lines[connection] = rest
        for line in lines:
            command = line.decode("utf-8", "replace").strip()
            if command.lower() == "quit":
                _reply(connection, "Disconnected")
                connection.close()
                return
            if command:
                may_command = self._was_remote[connection] and self._controller.takes_commands
                _reply(connection, self.answer(command, may_command=may_command))

    def answer(self, command: str, *, may_command: bool = True) -> str:
        """Carry out one command.

        Args:
            command: the line without its end; names are not case-sensitive.
            may_command: the peer may use commands that need remote control. A connection opened in local control may
                not, even after the switch is turned: it must connect again.

        Returns:
            The reply, one line.
        """
        folded = command.lower()
        for name in self._names:
            if folded == name or folded.startswith(name + " "):
                argument = command[len(name) :].strip()
                if name in self._always:
                    return self._always[name](argument)
                return self._remote_only[name](argument) if may_command else NOT_REMOTE
        return f"could not understand: '{command}'"

    # --- programs ---------------------------------------------------------------------------------------------------

    def _load(self, argument: str) -> str:
        name = _file_name(argument)
        if name not in self._controller.programs:
            return f"File not found: {argument}"
        try:
            self._controller.load(name)
        except Refused:
            return f"Error while loading program: {argument}"
        return f"Loading program: {argument}"

    def _play(self, _: str) -> str:
        try:
            self._controller.play()
        except Refused:
            return "Failed to execute: play"
        return "Starting program"

    def _on_event(self, event: Event) -> None:
        if isinstance(event, ProgramStopped):
            self._ended_s = self._controller.time_s

    def _stop(self, _: str) -> str:
        recently = self._controller.time_s - self._ended_s < HEARS_OF_AN_END_AFTER_S
        if self._controller.runtime_state is RuntimeState.STOPPED and not recently:
            return "Failed to execute: stop"
        self._controller.stop_program()
        return "Stopped"

    def _pause(self, _: str) -> str:
        try:
            self._controller.pause()
        except Refused:
            return "Failed to execute: pause"
        return "Pausing program"

    def _load_installation(self, argument: str) -> str:
        if _file_name(argument) not in INSTALLATIONS:
            return f"File not found: {argument}"
        return f"Loading installation: {argument}"

    @property
    def _program(self) -> str:
        return self._controller.loaded_program or UNNAMED

    @property
    def _is_running(self) -> bool:
        return self._controller.runtime_state not in (RuntimeState.STOPPED, RuntimeState.PAUSED)

    def _program_state(self, _: str) -> str:
        return f"{_STATE_WORDS.get(self._controller.runtime_state, 'PLAYING')} {self._program}"

    def _loaded_program(self, _: str) -> str:
        name = self._controller.loaded_program
        return f"Loaded program: {PROGRAM_FOLDER}{name}" if name else "No program loaded"

    def _is_program_saved(self, _: str) -> str:
        return f"{self._word(self._controller.loaded_program is not None)} {self._program}"

    # --- messages and reports ---------------------------------------------------------------------------------------

    def _show_popup(self, text: str) -> str:
        self.popup = text
        return "showing popup"

    def _close_popup(self, _: str) -> str:
        self.popup = None
        self._controller.close_popup()
        return "closing popup"

    def _add_to_log(self, text: str) -> str:
        if not text:
            return "No log message to add"
        self.log.append(text[:LOG_CHARACTERS])
        return "Added log message"

    def _flight_report(self, kind: str) -> str:
        if kind.lower() not in _REPORT_KINDS:
            return f"Unknown flight report type: {kind}. Supported types: controller, software, system"
        return f"Flight Report generated with id: {self._report(kind.lower() or 'system')}"

    def _support_file(self, _: str) -> str:
        return f"Completed successfully: {self._report(f'ur_{self._controller.serial}')}.zip"

    def _report(self, prefix: str) -> str:
        """Return the name of a report that a real robot would write to its disk; nothing is written here."""
        return f"{prefix}_{self._controller.time_s:.3f}"

    # --- modes ------------------------------------------------------------------------------------------------------

    def _set_operational_mode(self, argument: str) -> str:
        mode = argument.upper()
        if mode not in _OPERATIONAL_MODES:
            return f"Failed setting operational mode: {argument}"
        self.operational_mode = mode
        return f"Operational mode {mode} is set"

    def _clear_operational_mode(self, _: str) -> str:
        self.operational_mode = None
        return "No longer controlling the operational mode. Current operational mode: 'NONE'."

    def _shutdown(self, _: str) -> str:
        self._controller.power_off()
        self.shutdown_requested = True
        return "Shutting down"

    @property
    def _version(self) -> str:
        return ".".join(str(part) for part in self._controller.versions)

    def _doing(self, action: Callable[[], None], reply: str) -> Callable[[str], str]:
        def run(_: str) -> str:
            try:
                action()
            except Refused as refused:
                return str(refused)
            return reply

        return run

    def _word(self, value: bool) -> str:
        return "true" if value else "false"


def _file_name(path: str) -> str:
    return path.rsplit("/", 1)[-1]


def _reply(connection: Connection, line: str) -> None:
    connection.send(line.encode() + b"\n")
