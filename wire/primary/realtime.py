"""Real-time interface, TCP 30003: one package of doubles per control tick, in the e-Series layout of 5.11 and newer.

Every e-Series controller sends it. It is older than RTDE, which replaces it; clients that only upload scripts connect
here too. A robot newer than its client appends values at the end of the package.
"""

import struct
from collections.abc import Mapping, Sequence

PORT = 30003

FIELDS: tuple[tuple[str, int], ...] = (
    ("timestamp", 1),
    ("target_q", 6),
    ("target_qd", 6),
    ("target_qdd", 6),
    ("target_current", 6),
    ("target_moment", 6),
    ("actual_q", 6),
    ("actual_qd", 6),
    ("actual_current", 6),
    ("joint_control_output", 6),
    ("actual_TCP_pose", 6),
    ("actual_TCP_speed", 6),
    ("actual_TCP_force", 6),
    ("target_TCP_pose", 6),
    ("target_TCP_speed", 6),
    ("actual_digital_input_bits", 1),
    ("joint_temperatures", 6),
    ("actual_execution_time", 1),
    ("", 1),
    ("robot_mode", 1),
    ("joint_mode", 6),
    ("safety_mode", 1),
    ("", 6),
    ("actual_tool_accelerometer", 3),
    ("", 6),
    ("speed_scaling", 1),
    ("actual_momentum", 1),
    ("", 2),
    ("actual_main_voltage", 1),
    ("actual_robot_voltage", 1),
    ("actual_robot_current", 1),
    ("actual_joint_voltage", 6),
    ("actual_digital_output_bits", 1),
    ("runtime_state", 1),
    ("elbow_position", 3),
    ("elbow_velocity", 3),
    ("safety_status", 1),
    ("", 3),
    ("payload", 1),
    ("payload_cog", 3),
    ("payload_inertia", 6),
)
"""Content of the package: RTDE's name of each field and its number of values. Reserved fields have no name."""

_DOUBLES = struct.Struct(f">i{sum(count for _, count in FIELDS)}d")
SIZE = _DOUBLES.size
"""1220 bytes."""


def encode(values: Sequence[float]) -> bytes:
    """Return a package.

    Args:
        values: every value in the order of `FIELDS`, vectors laid out flat, 0 where reserved.
    """
    return _DOUBLES.pack(SIZE, *values)


def decode(package: bytes) -> Mapping[str, float | tuple[float, ...]]:
    """Read a package of at least `SIZE` bytes; return scalars and vectors by name.

    Raises:
        ValueError: the package is shorter.
    """
    if len(package) < SIZE:
        raise ValueError(f"a real-time package has {len(package)} bytes, it needs {SIZE}")
    flat = _DOUBLES.unpack_from(package)
    values: dict[str, float | tuple[float, ...]] = {}
    at = 1
    for name, count in FIELDS:
        if name:
            values[name] = flat[at] if count == 1 else flat[at : at + count]
        at += count
    return values
