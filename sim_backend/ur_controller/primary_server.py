"""Script ports, TCP 30001 to 30003: they take programs and commands and report the robot's state.

The primary port (30001) sends the robot's state at 10 Hz and messages as they come, the secondary port (30002) only the
state, the real-time port (30003) one package of doubles per tick.
"""

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Literal

from sim_backend.ur_controller import events
from sim_backend.ur_controller.controller import Controller
from sim_backend.ur_controller.events import Event, Refused
from sim_backend.ur_controller.listener import Connection
from sim_backend.ur_controller.outputs import Outputs
from sim_backend.ur_controller.program_reader import ProgramReader, ProgramTooLongError
from sim_backend.ur_controller.safety import ASKED_BY_PROGRAM, EMERGENCIES
from sim_backend.world.kinematics import UR3E
from wire.primary import messages, realtime, state
from wire.primary.messages import ErrorCode, Message, ReportLevel, Source
from wire.primary.packages import STATE_HZ, PackageType, frame
from wire.records import TICK_S
from wire.rtde.modes import RobotMode, RuntimeState, SafetyMode

Kind = Literal["primary", "secondary", "realtime"]

BUILD_DATE = "12-03-2025, 10:00:00"
PROTECTIVE_STOP, PROTECTIVE_STOP_ASKED_FOR = 160, 209
"""Error codes of a protective stop; the second one reports a stop that a program has called for. For other stops a real
robot gives a code by cause."""

_PROGRAMS_PER_TICK = 2
_MOST_WAITING = 256
_SILENT_TICKS = 2  # for a new connection; meanwhile bytes sent before its acceptance are read
_STATE_TICKS = round(1.0 / (STATE_HZ * TICK_S))
_SLOWEST_ACCELERATION = 40.0  # rad/s², as a UR reports it
_CONFIGURATION = state.Configuration(
    joint_position_limits=tuple(
        sign * (2.0 * math.pi if math.isinf(joint.range_rad) else joint.range_rad) for joint in UR3E for sign in (-1, 1)
    ),
    joint_motion_limits=tuple(limit for joint in UR3E for limit in (joint.speed_rad_s, _SLOWEST_ACCELERATION)),
    joint_speed_default=math.radians(60.0),
    joint_acceleration_default=math.radians(80.0),
    tool_speed_default=0.25,
    tool_acceleration_default=1.2,
    equivalent_radius=0.25,
    a=tuple(joint.a_m for joint in UR3E),
    d=tuple(joint.d_m for joint in UR3E),
    alpha=tuple(joint.alpha_rad for joint in UR3E),
    theta=(0.0,) * 6,
    masterboard_version=6,
    controller_box_type=4,
    robot_type=Controller.robot_type,
    robot_sub_type=1,
)
_KINEMATICS = state.Kinematics(
    checksum=(0xFFFFFFFF,) * 6,  # the nominal parameters, not a calibration
    theta=_CONFIGURATION.theta,
    a=_CONFIGURATION.a,
    d=_CONFIGURATION.d,
    alpha=_CONFIGURATION.alpha,
)


class PrimaryService:
    """One of the script ports.

    A connection opened in local control cannot command, even after the switch is turned: it must connect again. The
    primary port tells the client so.
    """

    def __init__(self, controller: Controller, outputs: Outputs, kind: Kind) -> None:
        self._controller = controller
        self._kind: Kind = kind
        self._readers: dict[Connection, ProgramReader] = {}
        self._writable: dict[Connection, bool] = {}
        self._silent: dict[Connection, int] = {}
        self._waiting: deque[tuple[Connection, str]] = deque()
        self._left = _PROGRAMS_PER_TICK
        self._ticks = 0
        self._commands: dict[str, Callable[[], None]] = {
            "power on": controller.power_on,
            "power off": controller.power_off,
            "set robotmode run": controller.brake_release,
            "set unlock protective stop": self._unlock,
            "stop program": controller.stop_program,
            "pause program": controller.pause,
            "resume program": controller.play,
        }
        self._package = {"primary": self._state, "secondary": self._state, "realtime": self._realtime}[kind]
        self._period = 1 if kind == "realtime" else _STATE_TICKS
        self._realtime_getters = [(outputs.getters[name] if name else None, count) for name, count in realtime.FIELDS]
        self._get = {name: outputs.getters[name] for name in _STATE_OUTPUTS}
        if kind == "primary":
            controller.events.append(self._on_event)

    def on_connect(self, connection: Connection) -> None:
        """Read before sending: a client may leave after its program, and sending to it would lose the program."""
        connection.patient = True  # a client that only uploads scripts may never read
        self._readers[connection] = ProgramReader()
        self._writable[connection] = self._controller.takes_commands
        self._silent[connection] = _SILENT_TICKS

    def on_data(self, connection: Connection, data: bytes) -> None:
        """Run every complete program."""
        try:
            for program in self._readers[connection].feed(data):
                self._take(connection, program)
        except ProgramTooLongError:
            connection.close()

    def on_close(self, connection: Connection) -> None:
        """Run the last complete program of a client, then discard the state of the peer."""
        for program in self._readers[connection].finish():
            self._take(connection, program)
        del self._readers[connection], self._writable[connection]
        self._silent.pop(connection, None)

    def publish(self) -> None:
        """Send due packages to peers that have read the earlier ones."""
        self._left = _PROGRAMS_PER_TICK
        self._run_waiting()
        for connection, ticks in list(self._silent.items()):
            if ticks > 1:
                self._silent[connection] = ticks - 1
            else:
                self._greet(connection)
        self._ticks += 1
        if self._ticks % self._period == 0:
            self._send_to_all(self._package)

    def _greet(self, connection: Connection) -> None:
        """Introduce the controller and send its state."""
        del self._silent[connection]
        if self._kind != "realtime":
            version = messages.Version("URControl", *self._controller.versions, BUILD_DATE)
            connection.send(self._framed(version))
            connection.send(self._package())

    def _send_to_all(self, package: Callable[[], bytes]) -> None:
        reading = [one for one in self._readers if one not in self._silent and not one.pending]
        if reading:
            data = package()
            for connection in reading:
                connection.send(data)

    # --- commands ---------------------------------------------------------------------------------------------------

    def _take(self, connection: Connection, program: str) -> None:
        """Run a program, or queue it so that the tick stays in time."""
        if not (self._controller.takes_commands and self._writable[connection]):
            text = "The connection is read-only: it was opened, or the robot is, in local control"
            self._complain(connection, ErrorCode(ErrorCode.READ_ONLY, 0, ReportLevel.VIOLATION, text))
        elif len(self._waiting) >= _MOST_WAITING:
            connection.close()
        else:
            self._waiting.append((connection, program))
            self._run_waiting()

    def _run_waiting(self) -> None:
        while self._waiting and self._left > 0:
            self._left -= 1
            self._run(*self._waiting.popleft())

    def _run(self, connection: Connection, program: str) -> None:
        command = self._commands.get(" ".join(program.lower().split()))
        try:
            if command is not None:
                command()
            else:
                self._controller.run_script(program)
        except Refused as refused:
            self._complain(connection, ErrorCode(0, 0, ReportLevel.WARNING, str(refused)))

    def _complain(self, connection: Connection, error: ErrorCode) -> None:
        if self._kind == "primary":  # the other ports have no messages
            self._tell(connection, self._framed(error))

    def _unlock(self) -> None:
        """Unlock a protective stop of any age; only the dashboard and the pendant wait for 5 s."""
        self._controller.unlock_protective_stop(at_once=True)

    # --- messages ---------------------------------------------------------------------------------------------------

    def _on_event(self, event: Event) -> None:
        if isinstance(event, events.SafetyChanged):
            # A client that waits for the mode must not read an older one after this message.
            self._send_to_all(self._state)
        for source, message in _messages(event):
            data = self._framed(message, source)
            for connection in self._readers:
                self._tell(connection, data)

    def _tell(self, connection: Connection, message: bytes) -> None:
        if connection in self._silent:
            self._greet(connection)
        connection.send(message)

    def _framed(self, message: Message, source: int = Source.ROBOT_INTERFACE) -> bytes:
        return frame(PackageType.ROBOT_MESSAGE, messages.encode_message(message, self._time_us, source))

    @property
    def _time_us(self) -> int:
        return round(self._controller.time_s * 1e6)

    # --- states -----------------------------------------------------------------------------------------------------

    def _state(self) -> bytes:
        controller, terminals, get = self._controller, self._controller.terminals, self._get
        vectors: list[Sequence[Any]] = [get[name]() for name in _JOINT_OUTPUTS]
        mode = state.RobotMode(
            timestamp_us=self._time_us,
            is_real_robot_connected=True,
            is_real_robot_enabled=True,
            is_power_on=controller.robot_mode >= RobotMode.POWER_ON,
            is_emergency_stopped=controller.safety_mode in EMERGENCIES,
            is_protective_stopped=controller.safety_mode is SafetyMode.PROTECTIVE_STOP,
            is_program_running=controller.runtime_state in (RuntimeState.PLAYING, RuntimeState.RESUMING),
            is_program_paused=controller.runtime_state in (RuntimeState.PAUSING, RuntimeState.PAUSED),
            robot_mode=controller.robot_mode,
            target_speed_fraction=get["target_speed_fraction"](),
            speed_scaling=get["speed_scaling"](),
        )
        joints = state.Joints(tuple(state.Joint(*values) for values in zip(*vectors, strict=True)))
        masterboard = state.Masterboard(
            digital_inputs=get["actual_digital_input_bits"]() & 0xFFFFFFFF,
            digital_outputs=get["actual_digital_output_bits"]() & 0xFFFFFFFF,
            analog_input_range_0=terminals.analog_input_domains[0],
            analog_input_range_1=terminals.analog_input_domains[1],
            analog_input_0=get["standard_analog_input0"](),
            analog_input_1=get["standard_analog_input1"](),
            analog_output_domain_0=terminals.analog_output_domains[0],
            analog_output_domain_1=terminals.analog_output_domains[1],
            analog_output_0=get["standard_analog_output0"](),
            analog_output_1=get["standard_analog_output1"](),
            temperature=controller.temperature_c,
            robot_voltage=get["actual_robot_voltage"](),
            robot_current=get["actual_robot_current"](),
            io_current=get["io_current"](),
            safety_mode=controller.safety_mode,
            is_reduced=controller.safety_mode is SafetyMode.REDUCED,
        )
        cartesian = state.Cartesian(tuple(get["actual_TCP_pose"]()), tuple(get["tcp_offset"]()))
        tool = state.Tool(
            analog_range_2=terminals.analog_input_domains[2],
            analog_range_3=terminals.analog_input_domains[3],
            analog_2=terminals.analog_inputs[2],
            analog_3=terminals.analog_inputs[3],
            output_voltage=terminals.tool_voltage,
            temperature=controller.temperature_c,
        )
        force = state.ForceMode(tuple(get["actual_TCP_force"]()))
        parts = (
            *(mode, joints, cartesian, _KINEMATICS, masterboard, tool, _CONFIGURATION, force),
            *(state.Additional(), state.ToolCommunication(), state.ToolMode()),
        )
        return frame(PackageType.ROBOT_STATE, state.encode_state(parts))

    def _realtime(self) -> bytes:
        values: list[float] = []
        for getter, count in self._realtime_getters:
            if getter is None:
                values += (0.0,) * count
            elif count == 1:
                values.append(getter())
            else:
                values.extend(getter())
        return realtime.encode(values)


_JOINT_OUTPUTS = (
    *("actual_q", "target_q", "actual_qd", "actual_current", "actual_joint_voltage", "joint_temperatures"),
    # the temperature of a joint's electronics is modelled as its motor's
    *("joint_temperatures", "joint_mode"),
)
_STATE_OUTPUTS = (
    *_JOINT_OUTPUTS,
    *("target_speed_fraction", "speed_scaling", "actual_digital_input_bits", "actual_digital_output_bits"),
    *("standard_analog_input0", "standard_analog_input1", "standard_analog_output0", "standard_analog_output1"),
    *("actual_robot_voltage", "actual_robot_current", "io_current"),
    *("actual_TCP_pose", "tcp_offset", "actual_TCP_force"),
)


def _messages(event: Event) -> Iterable[tuple[int, Message]]:
    """Return the messages of the primary port for an event."""
    match event:
        case events.ProgramStarted(name):
            yield Source.ROBOT_INTERFACE, messages.Key(messages.PROGRAM_STARTED, name)
        case events.ProgramStopped(name):
            yield Source.ROBOT_INTERFACE, messages.Key(messages.PROGRAM_STOPPED, name)
        case events.CompileFailed(line, column, text) | events.RuntimeFailed(line, column, _, text):
            yield Source.RUNTIME, messages.RuntimeException(line, column, text)
        case events.Text(text):
            yield Source.RUNTIME, messages.Text(text)
        case events.Popup(text, title, warning, error, blocking):
            yield Source.RUNTIME, messages.Popup(title, text, warning, error, blocking)
        case events.SafetyChanged(mode, reason):
            yield Source.RUNTIME, messages.SafetyMode(mode)
            if mode is SafetyMode.PROTECTIVE_STOP:
                code = PROTECTIVE_STOP_ASKED_FOR if reason == ASKED_BY_PROGRAM else PROTECTIVE_STOP
                yield Source.RUNTIME, ErrorCode(code, 0, ReportLevel.WARNING, reason)
            elif mode in (SafetyMode.VIOLATION, SafetyMode.FAULT):
                level = ReportLevel.VIOLATION if mode is SafetyMode.VIOLATION else ReportLevel.FAULT
                yield Source.RUNTIME, ErrorCode(0, 0, level, reason)
