"""Robot state of the primary interface: its sub-packages, encoded and decoded.

Each sub-package is a frozen dataclass with fields in the order of the wire. Layouts are those of the vendor's client
interface document for e-Series 5.x; recordings of a controller confirm them.
"""

import struct
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from enum import IntEnum
from types import MappingProxyType
from typing import Any, ClassVar, Self

from wire.primary.errors import PrimaryError, PrimaryErrorReason

Vector = tuple[float, ...]

_HEADER = struct.Struct(">IB")


class StateType(IntEnum):
    """Types of the sub-packages of a robot state."""

    ROBOT_MODE = 0
    JOINT = 1
    TOOL = 2
    MASTERBOARD = 3
    CARTESIAN = 4
    KINEMATICS = 5
    CONFIGURATION = 6
    FORCE_MODE = 7
    ADDITIONAL = 8
    CALIBRATION = 9
    SAFETY = 10
    TOOL_COMMUNICATION = 11
    TOOL_MODE = 12


class Layout:
    """Sequence of fields, as letters of `struct`; `6d` is a vector of six, as a tuple."""

    def __init__(self, letters: str) -> None:
        self._counts = [int(word[:-1] or 0) for word in letters.split()]
        self._struct = struct.Struct(">" + letters.replace(" ", ""))
        self.size = self._struct.size

    def pack(self, values: tuple[Any, ...]) -> bytes:
        """Encode one value per field.

        Raises:
            PrimaryError: MALFORMED, a value does not fit its field.
        """
        flat: list[Any] = []
        for value, count in zip(values, self._counts, strict=True):
            flat.extend(value if count else (value,))
        try:
            return self._struct.pack(*flat)
        except (struct.error, OverflowError) as error:
            raise PrimaryError(PrimaryErrorReason.MALFORMED, f"{values!r} cannot be encoded: {error}") from error

    def unpack(self, data: bytes, what: str) -> tuple[Any, ...]:
        """Decode one value per field; bytes after the last field are ignored.

        Raises:
            PrimaryError: MALFORMED, there are too few bytes; the text names `what`.
        """
        if len(data) < self.size:
            raise PrimaryError(PrimaryErrorReason.MALFORMED, f"{what} has {len(data)} bytes, it needs {self.size}")
        flat = self._struct.unpack_from(data)
        values: list[Any] = []
        at = 0
        for count in self._counts:
            values.append(flat[at : at + count] if count else flat[at])
            at += count or 1
        return tuple(values)


@dataclass(frozen=True, slots=True)
class SubPackage:
    """A part of a robot state. A newer controller may send more bytes than are known here; the surplus is ignored."""

    TYPE: ClassVar[StateType]
    LAYOUT: ClassVar[Layout]

    def encode(self) -> bytes:
        """Return the content, without size and type."""
        return self.LAYOUT.pack(tuple(getattr(self, one.name) for one in fields(self)))

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Read a content.

        Raises:
            PrimaryError: MALFORMED.
        """
        construct: Callable[..., Self] = cls
        return construct(*cls.LAYOUT.unpack(data, cls.__name__))


@dataclass(frozen=True, slots=True)
class RobotMode(SubPackage):
    """Modes of the arm and of its program, in UR numbering, and fractions of the set speed."""

    TYPE = StateType.ROBOT_MODE
    LAYOUT = Layout("Q ? ? ? ? ? ? ? b B d d d B")

    timestamp_us: int
    is_real_robot_connected: bool
    is_real_robot_enabled: bool
    is_power_on: bool
    is_emergency_stopped: bool
    is_protective_stopped: bool
    is_program_running: bool
    is_program_paused: bool
    robot_mode: int
    control_mode: int = 0
    target_speed_fraction: float = 1.0
    speed_scaling: float = 1.0
    target_speed_fraction_limit: float = 1.0
    reserved: int = 0


@dataclass(frozen=True, slots=True)
class Joint(SubPackage):
    """One joint: rad, rad/s, A, V and °C; mode in UR numbering, where 253 is running."""

    TYPE = StateType.JOINT
    LAYOUT = Layout("d d d f f f f B")

    q: float
    q_target: float
    qd: float
    current: float = 0.0
    voltage: float = 48.0
    motor_temperature: float = 25.0
    micro_temperature: float = 0.0
    mode: int = 253


@dataclass(frozen=True, slots=True)
class Joints(SubPackage):
    """The six joints, from the base."""

    TYPE = StateType.JOINT
    LAYOUT = Joint.LAYOUT

    joints: tuple[Joint, ...]

    def encode(self) -> bytes:
        """Return the content, without size and type."""
        return b"".join(joint.encode() for joint in self.joints)

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Read a content.

        Raises:
            PrimaryError: MALFORMED.
        """
        size = Joint.LAYOUT.size
        return cls(tuple(Joint.decode(data[at : at + size]) for at in range(0, 6 * size, size)))


@dataclass(frozen=True, slots=True)
class Tool(SubPackage):
    """The connector at the flange."""

    TYPE = StateType.TOOL
    LAYOUT = Layout("B B d d f B f f B")

    analog_range_2: int = 1
    analog_range_3: int = 1
    analog_2: float = 0.0
    analog_3: float = 0.0
    voltage: float = 0.0
    output_voltage: int = 0
    current: float = 0.0
    temperature: float = 25.0
    mode: int = 253


@dataclass(frozen=True, slots=True)
class Masterboard(SubPackage):
    """Inputs and outputs of the control box, V or A, and the safety mode."""

    TYPE = StateType.MASTERBOARD
    LAYOUT = Layout("I I B B d d b b d d f f f f B ? ?")
    _IMMI: ClassVar[Layout] = Layout("I I f f")
    _END: ClassVar[Layout] = Layout("I B B B")

    digital_inputs: int
    digital_outputs: int
    analog_input_range_0: int
    analog_input_range_1: int
    analog_input_0: float
    analog_input_1: float
    analog_output_domain_0: int
    analog_output_domain_1: int
    analog_output_0: float
    analog_output_1: float
    temperature: float
    robot_voltage: float
    robot_current: float
    io_current: float
    safety_mode: int
    is_reduced: bool = False
    immi: tuple[int, int, float, float] | None = None
    operational_mode_selector: int = 1
    three_position_switch: int = 1

    def encode(self) -> bytes:
        """Return the content, without size and type."""
        names = [one.name for one in fields(self)]
        first = tuple(getattr(self, name) for name in names[: names.index("immi")])
        content = self.LAYOUT.pack((*first, self.immi is not None))
        if self.immi is not None:
            content += self._IMMI.pack(self.immi)
        return content + self._END.pack((0, self.operational_mode_selector, self.three_position_switch, 0))

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Read a content.

        Raises:
            PrimaryError: MALFORMED.
        """
        *values, has_immi = cls.LAYOUT.unpack(data, cls.__name__)
        rest = data[cls.LAYOUT.size :]
        immi = None
        if has_immi:
            immi = cls._IMMI.unpack(rest, "the IMMI part of Masterboard")
            rest = rest[cls._IMMI.size :]
        _, selector, switch, _ = cls._END.unpack(rest, "the end of Masterboard")
        values += [immi, selector, switch]
        return cls(*values)


@dataclass(frozen=True, slots=True)
class Cartesian(SubPackage):
    """TCP pose in base axes, and TCP offset from the flange: m and a rotation vector in rad."""

    TYPE = StateType.CARTESIAN
    LAYOUT = Layout("6d 6d")

    tcp_pose: Vector
    tcp_offset: Vector


@dataclass(frozen=True, slots=True)
class Kinematics(SubPackage):
    """Calibrated Denavit-Hartenberg parameters, m and rad."""

    TYPE = StateType.KINEMATICS
    LAYOUT = Layout("6I 6d 6d 6d 6d I")

    checksum: tuple[int, ...]
    theta: Vector
    a: Vector
    d: Vector
    alpha: Vector
    calibration_status: int = 0


@dataclass(frozen=True, slots=True)
class Configuration(SubPackage):
    """Limits and defaults of the joints and the tool, nominal kinematics, and the type of the robot."""

    TYPE = StateType.CONFIGURATION
    LAYOUT = Layout("12d 12d d d d d d 6d 6d 6d 6d i i i i")

    joint_position_limits: Vector
    """(12,): minimum and maximum of each joint in turn, rad."""
    joint_motion_limits: Vector
    """(12,): largest speed and acceleration of each joint in turn, rad/s and rad/s²."""
    joint_speed_default: float
    joint_acceleration_default: float
    tool_speed_default: float
    tool_acceleration_default: float
    equivalent_radius: float
    a: Vector
    d: Vector
    alpha: Vector
    theta: Vector
    masterboard_version: int
    controller_box_type: int
    robot_type: int
    robot_sub_type: int


@dataclass(frozen=True, slots=True)
class ForceMode(SubPackage):
    """Wrench at the TCP in base axes, N and N·m."""

    TYPE = StateType.FORCE_MODE
    LAYOUT = Layout("6d d")

    wrench: Vector
    dexterity: float = 0.0


@dataclass(frozen=True, slots=True)
class Additional(SubPackage):
    """The freedrive button."""

    TYPE = StateType.ADDITIONAL
    LAYOUT = Layout("? ? ? ?")

    is_freedrive_pressed: bool = False
    is_freedrive_enabled: bool = True
    is_io_freedrive_enabled: bool = False
    reserved: bool = False


@dataclass(frozen=True, slots=True)
class ToolCommunication(SubPackage):
    """Serial line at the flange."""

    TYPE = StateType.TOOL_COMMUNICATION
    LAYOUT = Layout("? i i i f f")

    is_enabled: bool = False
    baud_rate: int = 115200
    parity: int = 0
    stop_bits: int = 1
    rx_idle_chars: float = 1.5
    tx_idle_chars: float = 3.5


@dataclass(frozen=True, slots=True)
class ToolMode(SubPackage):
    """Drive modes of the outputs at the flange."""

    TYPE = StateType.TOOL_MODE
    LAYOUT = Layout("B B B")

    output_mode: int = 0
    digital_output_mode_0: int = 1
    digital_output_mode_1: int = 1


_KNOWN: Mapping[int, type[SubPackage]] = MappingProxyType(
    {
        one.TYPE: one
        for one in (
            *(RobotMode, Joints, Tool, Masterboard, Cartesian, Kinematics, Configuration, ForceMode),
            *(Additional, ToolCommunication, ToolMode),
        )
    }
)


def encode_state(parts: Iterable[SubPackage]) -> bytes:
    """Return the content of a robot state."""
    contents = ((part.TYPE, part.encode()) for part in parts)
    return b"".join(_HEADER.pack(_HEADER.size + len(content), kind) + content for kind, content in contents)


def decode_state(content: bytes) -> list[SubPackage]:
    """Read a robot state; sub-packages of unknown type are left out.

    Raises:
        PrimaryError: MALFORMED.
    """
    parts: list[SubPackage] = []
    at = 0
    while at < len(content):
        if len(content) - at < _HEADER.size:
            raise PrimaryError(PrimaryErrorReason.MALFORMED, f"a robot state ends within the header at byte {at}")
        size, kind = _HEADER.unpack_from(content, at)
        if not _HEADER.size <= size <= len(content) - at:
            raise PrimaryError(PrimaryErrorReason.MALFORMED, f"sub-package {kind} at byte {at} claims {size} bytes")
        if kind in _KNOWN:
            parts.append(_KNOWN[kind].decode(content[at + _HEADER.size : at + size]))
        at += size
    return parts
