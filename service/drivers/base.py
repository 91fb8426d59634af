"""What a driver is to the cell: samples up, pose targets and stop down. A new arm is one class with these methods.

Everything here runs on the event loop's thread, and nothing in it waits: a driver that needs to wait has a task or a
thread of its own and hands over what it received. Frames, units and signs are those of `docs/reference/frames.md`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

from service.faults import FaultCode
from wire.arrays import FloatArray
from wire.law import ComplianceLaw, ControlLimits
from wire.records import Program, StopReason
from wire.rtde.modes import RobotMode as RobotMode
from wire.rtde.modes import SafetyMode as SafetyMode
from wire.task import Task


class DriverError(Exception):
    """The arm cannot be reached, or cannot do what was asked; `code` says which, the text what to do."""

    def __init__(self, code: FaultCode, text: str) -> None:
        super().__init__(text)
        self.code = code


@dataclass(frozen=True, slots=True)
class Sample:
    """One tick of the arm and its sensor, as measured.

    Attributes:
        epoch: identity of the source; another value means that the source was restarted.
        episode: how often that source laid out its world; 0 for a real arm.
        seq: tick of the source; increases by one.
        time_s: the source's clock.
        arrival_s: the host's injected monotonic clock (`Driver.clock`) when the sample arrived.
        q: (6,) joint angles, rad.
        qd: (6,) joint speeds, rad/s.
        tcp_position: (3,) m.
        tcp_rotvec: (3,) rad.
        tcp_velocity: (6,) m/s and rad/s.
        wrench: (6,) N and N·m at the TCP, base frame, zeroed and payload-compensated.
        saturated: a channel of the sensor is at the end of its range.
        hole_estimate: (3,) centre of the hole's mouth by the camera, m; None without one.
        program: state of the control program on the arm's controller.
        stop_reason: why that program last left ENGAGED.
        robot_mode: `RobotMode`, or a number that it does not know.
        safety_mode: `SafetyMode`, likewise.
        command_seq: last command that the arm accepted.
        peak_force_n: largest resultant since ENGAGE, as the arm's controller itself saw it.
    """

    epoch: int
    episode: int
    seq: int
    time_s: float
    arrival_s: float
    q: FloatArray
    qd: FloatArray
    tcp_position: FloatArray
    tcp_rotvec: FloatArray
    tcp_velocity: FloatArray
    wrench: FloatArray
    saturated: bool
    hole_estimate: FloatArray | None
    program: Program
    stop_reason: StopReason
    robot_mode: int
    safety_mode: int
    command_seq: int
    peak_force_n: float


@dataclass(frozen=True, slots=True)
class PoseTarget:
    """Where the TCP shall go: `position` (3,) m and `rotvec` (3,) rad, base frame."""

    position: FloatArray
    rotvec: FloatArray


class SampleSink(Protocol):
    """The cell, as its driver sees it. Called on the event loop's thread; returns before the next sample."""

    def on_sample(self, sample: Sample) -> None: ...

    def on_link_fault(self, code: FaultCode, text: str) -> None:
        """The link is broken or not to be believed; samples may or may not go on."""
        ...


class Driver(Protocol):
    """One arm."""

    @property
    def name(self) -> str:
        """For status and logs: kind and address."""
        ...

    @property
    def mode(self) -> Literal["real_time", "lockstep"]:
        """Whether time passes by itself, or only as far as this driver lets it."""
        ...

    @property
    def simulated(self) -> bool:
        """Whether a run's world is drawn from a seed; a real arm refuses one."""
        ...

    @property
    def tick_s(self) -> float:
        """Period of the samples."""
        ...

    @property
    def clock(self) -> Callable[[], float]:
        """Monotonic seconds: the host's in real time, the world's in lockstep. The cell knows no other clock."""
        ...

    @property
    def samples_dropped(self) -> int:
        """Samples that never reached the sink because it was too slow; their force was checked all the same."""
        ...

    async def connect(self, sink: SampleSink) -> None:
        """Reach the arm and let samples flow into `sink`. May be called again after a link fault.

        Raises:
            DriverError: the arm cannot be reached or speaks another version.
        """
        ...

    async def prepare(self, task: Task | None) -> None:
        """Lay out the world of a run; return once samples of it flow.

        Args:
            task: the episode that a simulated world draws; None on a real arm.

        Raises:
            DriverError: the world cannot be laid out; a real arm was given a task.
        """
        ...

    def engage(self, law: ComplianceLaw, limits: ControlLimits) -> None:
        """Start the control program; its target is the present pose."""
        ...

    def send_target(self, target: PoseTarget) -> int:
        """Send a target; return its sequence number, which samples echo once the arm has it."""
        ...

    def stop(self) -> None:
        """Decelerate, hold and disengage. Never blocks, never raises, may be called at any rate in any state."""
        ...

    def escalate(self) -> None:
        """Last resort after a stop that no standstill was measured for: whatever the arm has beyond `stop`.

        Like it, this never blocks and never raises.
        """
        ...

    def zero_ft(self) -> None:
        """Take the present wrench as zero. Only in free air, and not while engaged."""
        ...

    def unlock(self) -> None:
        """Leave the arm's protective stop: part of an operator's reset."""
        ...

    async def close(self) -> None:
        """Stop and release the arm."""
        ...
