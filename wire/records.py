"""Fixed-layout, little-endian, versioned messages of the simulated cell.

There are three packed records: a cell sends `STATE` once per 2 ms tick, a client sends `COMMAND`, and a cell whose arm
speaks another protocol sends `CAMERA`. Every record starts with the same eight bytes (magic, version, kind), so a
reader refuses an unreadable record before it reads the rest.
A change of a layout requires a higher `VERSION`. `docs/reference/frames.md` defines frames, units and signs.
"""

from enum import IntEnum
from typing import Any

import numpy as np
import numpy.typing as npt

MAGIC = 0x4C534444  # "DDSL" in the byte order of the wire
VERSION = 2
TICK_S = 0.002
"""Period of the cell's control law and its state messages: the 500 Hz of a UR e-Series controller."""


class WireError(ValueError):
    """A message that does not follow this schema; the text says which check failed."""


class Kind(IntEnum):
    STATE = 1
    ENGAGE = 2
    """Start the control program with the law and limits in the record; the target is the pose at that moment."""
    TARGET = 3
    """A TCP pose target. Ignored unless engaged, and unless its `seq` is above every earlier one of this client."""
    STOP = 4
    """Decelerate, hold and disengage. Accepted in any state, and from anyone while no holder is heard."""
    ZERO_FT = 5
    """Take the average of the latest wrenches as the zero, as `zero_ftsensor()` does. Refused while engaged."""
    UNLOCK = 6
    """Leave the protective stop; an operator's action."""
    CAMERA = 7
    STOP_BLIND = 8
    """As STOP, without yielding to the force/torque sensor meanwhile: its reading is not believed."""


class Program(IntEnum):
    """State of the control program that runs the compliance law on the arm's controller."""

    IDLE = 0
    ENGAGED = 1
    STOPPING = 2
    PROTECTIVE_STOP = 3


class StopReason(IntEnum):
    """Why the control program last left ENGAGED."""

    NONE = 0
    COMMAND = 1
    FORCE_CEILING = 2
    TARGET_AGE = 3
    TARGET_REJECTED = 4
    """A target outside the workspace, not finite, or further from the previous one than the step limit."""
    JOINT_LIMIT = 5
    KINEMATICS = 6
    """The arm is too close to a singularity, or a joint would have to exceed its speed."""
    PROTECTIVE_FORCE = 7
    """The arm's own protection: a force far above the ceiling, or a joint that cannot follow."""
    LEASE = 8
    """Another client engaged."""
    PROGRAM_ENDED = 9
    """The control program no longer runs: somebody stopped or replaced it, or its watchdog ended it."""


_HEADER: list[Any] = [("magic", "<u4"), ("version", "<u2"), ("kind", "<u2")]

STATE = np.dtype(
    [
        *_HEADER,
        ("epoch", "<u8"),  # drawn at random when the world process starts
        ("episode", "<u8"),  # world resets since the process started
        ("seq", "<u8"),  # states since the process started; strictly increasing by one
        ("time_s", "<f8"),  # simulated time of the sample
        ("q", "<f8", 6),
        ("qd", "<f8", 6),
        ("tcp_position", "<f8", 3),  # measured by the joint encoders
        ("tcp_rotvec", "<f8", 3),
        ("tcp_velocity", "<f8", 6),
        ("target_position", "<f8", 3),  # the target in force
        ("target_rotvec", "<f8", 3),
        ("wrench", "<f8", 6),  # at the TCP, base frame, zeroed, payload-compensated, with the sensor's delay and noise
        ("ft_raw", "<f8", 6),  # sensor frame (flange), neither zeroed nor compensated
        ("hole_estimate", "<f8", 3),  # the camera's estimate of the centre of the hole's mouth; NaN without one
        ("peak_force", "<f8"),  # largest resultant of the compensated force since ENGAGE, seen by the controller, N
        ("command_seq", "<u8"),  # last command accepted
        ("client", "<u8"),  # number of the claim of the last ENGAGE
        ("program", "<u2"),
        ("stop_reason", "<u2"),
        ("robot_mode", "<i2"),  # UR numbering; 7 is running
        ("safety_mode", "<i2"),  # UR numbering; 1 normal, 3 protective stop
        ("saturated", "<u2"),  # 1 if a raw channel is at the end of the sensor's range
        ("reserved", "V6"),
        ("unzeroed", "<f8", 6),  # as wrench, but without any zero: the raw reading less the payload's weight
        ("joint_force", "<f8", 3),  # force on the tool as the joints' drives feel it, base axes, N; coarse
    ],
    align=False,
)

COMMAND = np.dtype(
    [
        *_HEADER,
        ("client", "<u8"),  # word of the sender's claim
        ("epoch", "<u8"),  # intended world; other worlds ignore the command. STOP is accepted with any epoch
        ("seq", "<u8"),
        ("position", "<f8", 3),  # TARGET
        ("rotvec", "<f8", 3),
        ("stiffness", "<f8", 6),  # ENGAGE, N/m and N·m/rad about the TCP, base axes
        ("damping", "<f8", 6),  # ENGAGE, N·s/m and N·m·s/rad
        ("inertia", "<f8", 6),  # ENGAGE, virtual mass kg and inertia kg·m²
        ("max_speed", "<f8", 2),  # ENGAGE, m/s and rad/s of the reference
        ("max_step", "<f8", 2),  # ENGAGE, largest change of target, m and rad
        ("workspace", "<f8", (2, 3)),  # ENGAGE, box for the TCP's position, lower and upper corner
        ("force_ceiling", "<f8"),  # ENGAGE, N, resultant
        ("target_age", "<f8"),  # ENGAGE, simulated time without a new target after which the program stops, s
    ],
    align=False,
)

CAMERA = np.dtype(
    [
        *_HEADER,
        ("epoch", "<u8"),  # this and the next three as in STATE
        ("episode", "<u8"),
        ("seq", "<u8"),
        ("time_s", "<f8"),  # time of the frame on the clock of the arm's own samples
        ("position", "<f8", 3),  # the camera's estimate of the centre of the hole's mouth, base frame, m
    ],
    align=False,
)


def new(dtype: np.dtype[Any], kind: Kind) -> npt.NDArray[Any]:
    """Return a zeroed record of `dtype`, shape (1,), with its header filled in."""
    record = np.zeros(1, dtype)
    record["magic"], record["version"], record["kind"] = MAGIC, VERSION, kind
    return record


def decode(payload: bytes, dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    """Read one or more records.

    Args:
        payload: one or more whole records of `dtype`.
        dtype: `STATE`, `COMMAND` or `CAMERA`.

    Returns:
        (n,) read-only array over `payload`.

    Raises:
        WireError: the length, magic or version does not follow this schema. Values are not checked here.
    """
    if not payload or len(payload) % dtype.itemsize:
        raise WireError(f"{len(payload)} bytes are not a whole number of {dtype.itemsize}-byte records")
    records = np.frombuffer(payload, dtype)
    for magic in records["magic"][records["magic"] != MAGIC]:
        raise WireError(f"wrong magic {int(magic):#x}, want {MAGIC:#x}")
    for version in records["version"][records["version"] != VERSION]:
        raise WireError(f"schema version {int(version)}, this side reads {VERSION}")
    return records
