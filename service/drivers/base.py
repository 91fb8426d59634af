"""The driver interface: samples go up to the cell; pose targets and stops go down to the arm. A new arm is one class.

All methods run on the event loop's thread but `SampleSink.overloads`, and none of them blocks. A driver that has to
wait does so in a task or thread of its own and hands over what it received. Frames, units and signs are those of
`docs/reference/frames.md`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from service.faults import FaultCode
from wire.arrays import FloatArray
from wire.law import ComplianceLaw, ControlLimits
from wire.modes import TimeMode
from wire.records import Program, StopReason
from wire.rtde.modes import RobotMode as RobotMode
from wire.rtde.modes import SafetyMode as SafetyMode
from wire.task import Task


class DriverError(Exception):
    """The arm cannot be reached or cannot do what was asked. `code` names the fault; the text says what to do."""

    def __init__(self, code: FaultCode, text: str) -> None:
        super().__init__(text)
        self.code = code


class Load(NamedTuple):
    """The part of a sample that the ceilings are judged by.

    Attributes:
        epoch: identity of the source.
        wrench: six forces and torques at the TCP, N and N·m, as `Sample.wrench`.
        saturated: True if a channel of the sensor is at the end of its range.
        engaged: True if the control program drives the arm.
    """

    epoch: int
    wrench: Sequence[float]
    saturated: bool
    engaged: bool


@dataclass(frozen=True, slots=True)
class Sample:
    """One tick of the arm and its sensor, as measured.

    Attributes:
        epoch: identity of the source; another value means that the source was restarted.
        episode: number of times that the source laid out its world; 0 for a real arm.
        seq: tick of the source; increases by one.
        time_s: time on the source's clock, s.
        arrival_s: time of arrival on the host's injected monotonic clock (`Driver.clock`), s.
        q: (6,) joint angles, rad.
        qd: (6,) joint speeds, rad/s.
        tcp_position: (3,) position of the TCP, m.
        tcp_rotvec: (3,) rotation vector of the TCP, rad.
        tcp_velocity: (6,) velocity of the TCP, m/s and rad/s.
        wrench: (6,) N and N·m at the TCP, base frame, zeroed and payload-compensated.
        unzeroed: (6,) N and N·m, as `wrench`, but without any zero: the raw reading less the payload's weight.
        ft_raw: (6,) the sensor's own reading, in its own axes, N and N·m.
        joint_force: (3,) force on the tool as the joints' drives feel it, base frame, payload-compensated, N; a second
            witness beside the force/torque sensor, and a coarser one. None if the arm gives none.
        saturated: True if a channel of the sensor is at the end of its range.
        hole_estimate: (3,) the camera's estimate of the centre of the hole's mouth, m; None without one.
        program: state of the control program on the arm's controller.
        stop_reason: reason for which that program last left ENGAGED.
        robot_mode: `RobotMode`, or a number that `RobotMode` lacks.
        safety_mode: `SafetyMode`, or a number that `SafetyMode` lacks.
        command_seq: sequence number of the last command that the arm accepted.
        peak_force_n: largest resultant force since ENGAGE, as measured by the arm's controller, N.
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
    unzeroed: FloatArray
    ft_raw: FloatArray
    joint_force: FloatArray | None
    saturated: bool
    hole_estimate: FloatArray | None
    program: Program
    stop_reason: StopReason
    robot_mode: int
    safety_mode: int
    command_seq: int
    peak_force_n: float

    @property
    def load(self) -> Load:
        return Load(self.epoch, self.wrench.tolist(), self.saturated, self.program is Program.ENGAGED)


@dataclass(frozen=True, slots=True)
class PoseTarget:
    """Target pose of the TCP: `position` (3,) m and `rotvec` (3,) rad, base frame."""

    position: FloatArray
    rotvec: FloatArray


class SampleSink(Protocol):
    """Receiver of a driver's samples: the cell. Its methods do not block.

    All but `overloads` run on the event loop's thread.
    """

    def overloads(self, load: Load) -> bool:
        """Return whether a load demands a stop at once, by the ceilings of the run under way.

        A driver whose samples arrive on another thread asks here, on that thread, before it reads the rest of the
        sample and hands it over. On True it stops the arm, and lets no `engage`, `send_target` or `zero_ft` through
        until the next `prepare`.
        """
        ...

    def on_sample(self, sample: Sample) -> None: ...

    def on_link_fault(self, code: FaultCode, text: str) -> None:
        """Take note that the link is broken or not trustworthy. Samples may or may not continue."""
        ...

    def on_notice(self, text: str) -> None:
        """Take note of something that had no effect: commands of others that the arm refused, say."""
        ...


class Driver(Protocol):
    """One arm, real or simulated."""

    @property
    def name(self) -> str:
        """Kind and address of the arm, for status and logs."""
        ...

    @property
    def mode(self) -> TimeMode:
        """Time mode. In `real_time` time passes by itself; in `lockstep` only this driver advances it."""
        ...

    @property
    def simulated(self) -> bool:
        """True if a run's world is drawn from a seed. A real arm refuses a seed."""
        ...

    @property
    def tick_s(self) -> float:
        """Period of the samples, s."""
        ...

    @property
    def clock(self) -> Callable[[], float]:
        """Monotonic clock, s: the host's in real time, the world's in lockstep. The cell uses no other clock."""
        ...

    @property
    def samples_dropped(self) -> int:
        """Number of samples that a slow sink did not receive. Their largest force was checked nevertheless."""
        ...

    async def connect(self, sink: SampleSink) -> None:
        """Connect to the arm and deliver its samples to `sink`. May be called again after a link fault.

        Raises:
            DriverError: the arm cannot be reached or speaks another version.
        """
        ...

    async def prepare(self, task: Task | None) -> None:
        """Lay out the world of a run; return once its samples arrive.

        Args:
            task: episode for a simulated world; None for a real arm.

        Raises:
            DriverError: the world cannot be laid out; a real arm was given a task.
        """
        ...

    def engage(self, law: ComplianceLaw, limits: ControlLimits) -> None:
        """Start the control program with the present pose as its target."""
        ...

    def send_target(self, target: PoseTarget) -> int:
        """Send a target; return its sequence number, which samples echo once the arm has it."""
        ...

    def stop(self) -> None:
        """Decelerate, hold and disengage. It never blocks or raises and may be called at any rate in any state."""
        ...

    def stop_blind(self) -> None:
        """Stop as `stop`, without yielding to the force/torque sensor meanwhile: its reading is not believed.

        An arm that yields to a sensor with the wrong sign pushes harder while it stops.
        """
        ...

    def escalate(self) -> None:
        """Use the arm's last resort beyond `stop`, after a stop without measured standstill.

        Like `stop`, it never blocks or raises.
        """
        ...

    def zero_ft(self) -> None:
        """Take the present wrench as zero. Call it only in free air and not while engaged."""
        ...

    def unlock(self) -> None:
        """Release the arm's protective stop, as part of an operator's reset."""
        ...

    async def close(self) -> None:
        """Stop and release the arm."""
        ...
