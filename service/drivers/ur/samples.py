"""Samples of the cell from RTDE's data packages: the state of the arm and of the control program."""

from collections.abc import Sequence
from math import cos, hypot, sin
from typing import NamedTuple, cast

import numpy as np

from service.config import UrSection
from service.drivers.base import Sample
from service.drivers.ur import registers
from service.safety.weighing import Payload
from wire import pose
from wire.arrays import FloatArray
from wire.records import TICK_S, Program, StopReason
from wire.rtde.codec import Decoded
from wire.rtde.modes import RuntimeState, SafetyMode

ALIVE_S = 0.1
"""Time without a change of its counter after which a program does not run. Zeroing the sensor may take some steps."""
WINDOW_S = 0.5
"""Window over which the minimum delay is tracked, s; the minimum covers one to two windows."""

Numbers = tuple[float, ...]


class Package(NamedTuple):
    """One data package, in the order of `OUTPUTS`.

    Units and frames are RTDE's: SI, base axes, poses with rotation vectors.
    """

    time_s: float
    q: Numbers
    qd: Numbers
    tcp_pose: Numbers
    tcp_speed: Numbers
    tcp_force: Numbers
    ft_raw: Numbers
    felt: Numbers
    robot_mode: int
    safety_mode: int
    runtime_state: int
    speed_fraction: float
    payload_kg: float
    payload_com: Numbers
    tcp_offset: Numbers
    accepted: int
    program: int
    reason: int
    crc: int
    counter: int
    handled: int
    peak_force_n: float

    @classmethod
    def of(cls, values: Sequence[Decoded]) -> "Package":
        """Name the values of the recipe `OUTPUTS`."""
        return cls._make(cast("Sequence[float]", values))

    @property
    def tick(self) -> int:
        """Number of the controller's step, from its time stamp."""
        return round(self.time_s / TICK_S)


OUTPUTS: tuple[str, ...] = (
    "timestamp",
    "actual_q",
    "actual_qd",
    "actual_TCP_pose",
    "actual_TCP_speed",
    "actual_TCP_force",
    "ft_raw_wrench",
    "wrench_calc_from_currents",
    "robot_mode",
    "safety_mode",
    "runtime_state",
    "target_speed_fraction",
    "payload",
    "payload_cog",
    "tcp_offset",
    *registers.OUTPUT_NAMES,
)
"""The driver's output recipe."""


class ProgramWatch:
    """Tells whether the control program with a checksum runs, from the controller's state and the program's own
    counter.

    Output registers keep their values after a program ends, so they alone prove nothing.

    Args:
        crc: checksum of the program.
    """

    def __init__(self, crc: int) -> None:
        self._crc = crc
        self._counter: int | None = None
        self._counted_s = -1.0
        self.running = False

    def forget(self) -> None:
        """Discard earlier observations, after a new connection or a newly sent program."""
        self._counter = None
        self.running = False

    def observe(self, package: Package) -> bool:
        """Record a package; return True if the program runs."""
        playing = package.runtime_state == RuntimeState.PLAYING and package.crc == self._crc
        if not playing:
            self._counter = None
            self.running = False
        elif self._counter is None:
            self._counter = package.counter
            self._counted_s = package.time_s
        elif package.counter != self._counter:
            self._counter = package.counter
            self._counted_s = package.time_s
            self.running = True
        elif package.time_s - self._counted_s > ALIVE_S:
            self.running = False
        return self.running


class ArrivalClock:
    """Estimates arrival times on the host's clock without the event loop's delays.

    Packages that wait in the socket while the loop is busy are all read at once and would look fresh. The smallest
    recent delay between the robot's stamp and the host's reading is the link's own; any excess is waiting time. Only
    recent delays count, because clocks drift and an emulated controller loses time on a busy host.
    """

    def __init__(self) -> None:
        self._offset_s = self._before_s = float("inf")
        self._since_s = float("-inf")

    def arrival(self, stamp_s: float, read_s: float) -> float:
        """Return the arrival on the host's clock, never later than `read_s`.

        Args:
            stamp_s: time stamp of the robot.
            read_s: time at which the host read the package.
        """
        if read_s - self._since_s > WINDOW_S:
            self._before_s, self._offset_s = self._offset_s, float("inf")
            self._since_s = read_s
        self._offset_s = min(self._offset_s, read_s - stamp_s)
        return stamp_s + min(self._offset_s, self._before_s)


class SampleReader:
    """Makes samples from one controller's packages.

    Args:
        ur: section of the configuration with the payload on the flange and the range of the sensor.
    """

    def __init__(self, ur: UrSection) -> None:
        rotation = pose.rotation_from_rotvec(ur.tcp_m[3:])
        lever: list[float] = (rotation.T @ np.array(ur.tcp_m[:3])).tolist()
        self._lever = lever if ur.torque_about == "flange" else [0.0, 0.0, 0.0]
        self._tcp_m = ur.tcp_m[:3]
        self._payload = Payload(ur.payload_kg, ur.payload_com_m)
        self._ranges = (ur.force_range_n,) * 3 + (ur.torque_range_nm,) * 3
        self._time_s = 0.0
        self._epoch = 1

    def read(
        self, package: Package, arrival_s: float, *, running: bool, episode: int, hole_estimate: FloatArray | None
    ) -> Sample:
        """Convert a package into a sample.

        Args:
            package: package; if its time stamp goes back, the sample has a new epoch.
            arrival_s: arrival by the driver's clock.
            running: the control program runs.
            episode: episode of a simulated world; 0 for a real arm.
            hole_estimate: (3,) m, if there is one.

        Raises:
            ValueError: a register holds a state or a reason that the control program does not have.
        """
        if package.time_s < self._time_s:
            self._epoch += 1
        self._time_s = package.time_s
        program, reason = self._state(package, running)
        return Sample(
            epoch=self._epoch,
            episode=episode,
            seq=package.tick,
            time_s=package.time_s,
            arrival_s=arrival_s,
            q=np.array(package.q),
            qd=np.array(package.qd),
            tcp_position=np.array(package.tcp_pose[:3]),
            tcp_rotvec=np.array(package.tcp_pose[3:]),
            tcp_velocity=np.array(package.tcp_speed),
            wrench=self.wrench(package),
            unzeroed=self.unzeroed(package),
            ft_raw=np.array(package.ft_raw),
            joint_force=np.array(package.felt[:3]),
            saturated=any(not abs(felt) < end for felt, end in zip(package.ft_raw, self._ranges, strict=True)),
            hole_estimate=hole_estimate,
            program=program,
            stop_reason=reason,
            robot_mode=package.robot_mode,
            safety_mode=package.safety_mode,
            command_seq=package.accepted,
            peak_force_n=package.peak_force_n,
        )

    def wrench(self, package: Package) -> FloatArray:
        """Return the wrench at the TCP (6,), N and N·m, base axes; the package's torque may be about the flange."""
        fx, fy, fz, tx, ty, tz = package.tcp_force
        x, y, z = _turned(self._lever, package.tcp_pose[3:])
        return np.array([fx, fy, fz, tx - (y * fz - z * fy), ty - (z * fx - x * fz), tz - (x * fy - y * fx)])

    def unzeroed(self, package: Package) -> FloatArray:
        """Return the raw reading less the configured payload's weight, at the configured TCP (6,), base axes.

        A controller zeroes its sensor whenever a program starts and whenever the payload is set, in contact too. The
        raw reading does not change then, and depends neither on payload nor on TCP that the controller has at present.
        """
        flange = flange_rotation(package)
        weight, moment = self._payload.load(-flange[2])
        force = np.array(package.ft_raw[:3]) - weight
        torque = np.array(package.ft_raw[3:]) - moment - np.cross(self._tcp_m, force)
        return np.concatenate((flange @ force, flange @ torque))

    @staticmethod
    def _state(package: Package, running: bool) -> tuple[Program, StopReason]:
        if package.safety_mode == SafetyMode.PROTECTIVE_STOP:
            return Program.PROTECTIVE_STOP, StopReason.PROTECTIVE_FORCE
        if not running:
            return Program.IDLE, StopReason.PROGRAM_ENDED
        return Program(package.program), StopReason(package.reason)


def flange_rotation(package: Package) -> FloatArray:
    """Return the rotation (3, 3) of the flange, base frame; the package's pose is that of the controller's TCP."""
    tool = pose.rotation_from_rotvec(np.array(package.tcp_pose[3:]))
    return tool @ pose.rotation_from_rotvec(np.array(package.tcp_offset[3:])).T


def _turned(vector: Sequence[float], rotvec: Sequence[float]) -> tuple[float, float, float]:
    """Turn `vector` (3,) by a rotation vector (3,), rad, in plain floats (Rodrigues)."""
    x, y, z = vector
    rx, ry, rz = rotvec
    angle = hypot(rx, ry, rz)
    if angle < 1e-12:
        return x, y, z
    kx, ky, kz = rx / angle, ry / angle, rz / angle
    cosine, sine = cos(angle), sin(angle)
    along = (kx * x + ky * y + kz * z) * (1.0 - cosine)
    return (
        cosine * x + sine * (ky * z - kz * y) + along * kx,
        cosine * y + sine * (kz * x - kx * z) + along * ky,
        cosine * z + sine * (kx * y - ky * x) + along * kz,
    )
