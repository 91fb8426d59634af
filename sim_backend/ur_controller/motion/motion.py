"""Commanded motion of the arm: the joint target of every tick, made by the mover that a script has started."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from sim_backend.ur_controller.geometry import multiply, rotation_of, rotvec_of, transpose
from sim_backend.ur_controller.plant import Plant
from sim_backend.world.kinematics import KinematicsError, singularity_margin
from wire.arrays import FloatArray
from wire.records import TICK_S

from .cartesian import Arc, Line, PathMover, ServoC, SpeedL, StopL, standing
from .contact import ContactMemory
from .force import DEFAULT_DAMPING, DEFAULT_GAIN, ForceMode, ForceTask
from .inverse import inverse_at
from .joint import JOINT_RAD_S2, MoveJ, ServoJ, SpeedJ, StopJ, blend_share, top_speed
from .mover import JointMover, Mover, ToolMover
from .profile import Trapezoid
from .target import CannotMove, JointTarget

HOLD_RAD_S2 = 10.0
"""Deceleration of the leading axis for a motion that is no longer commanded."""
SLIDER_STEP = TICK_S / 0.1
"""Largest change of the speed fraction per tick; the arm follows the slider without a jerk."""
STEADY_TICKS = 50
FREEDRIVE_SPEED = 0.25
"""Largest speed by hand along an axis while others are locked, m/s and rad/s."""
NEAR_SINGULARITY, TOO_NEAR_SINGULARITY = 0.2, 0.05
"""Margins, as `kinematics.singularity_margin`, at which the status of freedrive changes. An assumption."""


class Motion:
    """The joint target of one arm.

    One mover runs at a time, and force mode beside it. A mover that is started during another one takes over at the
    present speed (`speedl`, `stopj`, …), or waits for rest where the manual requires rest (`movej`, `movel`, …).

    Args:
        plant: the arm; tool motions move its configured TCP.

    Attributes:
        speed_fraction: present fraction of the programs' full speed; follows the argument of `advance`.
        fault: reason why the arm cannot continue, or None; the controller turns it into a protective stop.
        owner: thread that moves the arm, maintained by the motion builtins.
        force_damping, force_gain: settings of force mode, 0 … 1 and 0 … 2.
        memory: recent measurements, for the detection of contacts.
    """

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._target = JointTarget(plant)
        self.speed_fraction = 1.0
        self.owner: object | None = None
        self.force_damping, self.force_gain = DEFAULT_DAMPING, DEFAULT_GAIN
        self.memory = ContactMemory()
        self.freeze()

    def freeze(self) -> None:
        """Take the measured joints as the target, at rest: after a power-off, a protective stop, a new layout."""
        self._mover: Mover | None = None
        self._queued: Callable[[], Mover] | None = None
        self._force: ForceMode | None = None
        self._freedrive = False
        self._displaced = False
        self._rest_ticks = 0
        self.memory.forget()
        self.memory.record(self._plant.q, self._plant.wrench)
        self.owner = None
        self.fault: str | None = None
        self._target.take_measured()

    def hold(self) -> None:
        """Bring any motion to rest, as at the end of a program; force mode and freedrive end."""
        self.end_force()
        self.end_freedrive()
        self.owner = None
        self.abandon()

    def abandon(self) -> None:
        """Bring the running motion to rest, as when the thread that commands it is killed; force mode continues."""
        self._queued = None
        self._take(self._stop(HOLD_RAD_S2) if self.moving else None)

    @property
    def moving(self) -> bool:
        """The joint target moves."""
        return self._target.moving

    @property
    def q_target(self) -> FloatArray:
        """(6,) joint angles, rad; replaced, never changed in place, like the next two."""
        return self._target.q_array

    @property
    def qd_target(self) -> FloatArray:
        """(6,) joint speeds, rad/s."""
        return self._target.qd_array

    @property
    def qdd_target(self) -> FloatArray:
        """(6,) joint accelerations, rad/s²."""
        return self._target.qdd_array

    @property
    def ready(self) -> bool:
        """The script that started the last mover may continue."""
        return self._mover is None or (self._queued is None and self._mover.ready)

    @property
    def is_steady(self) -> bool:
        """The arm has stood still for a while, in no mode in which it may give way."""
        return self._rest_ticks >= STEADY_TICKS and bool((np.abs(self._plant.qd) < 2e-3).all())

    @property
    def in_force_mode(self) -> bool:
        return self._force is not None and not self._freedrive

    @property
    def in_freedrive(self) -> bool:
        return self._freedrive

    def target_tcp_pose(self) -> list[float]:
        """Return the pose of the configured TCP at the joint target."""
        return self._target.pose()

    def target_tcp_speed(self) -> list[float]:
        """Return the twist (6,) of the configured TCP at the joint target, base axes."""
        return self._target.twist()

    def waypoint(self) -> list[float]:
        """Return the pose at which the present move ends; without a move, the commanded pose."""
        mover = self._mover
        if isinstance(mover, MoveJ):
            return self._plant.tcp_pose_of(mover.target)
        if isinstance(mover, PathMover):
            position, rotation = mover.end
            return [*position, *rotvec_of(rotation)]
        return self.target_tcp_pose()

    def advance(self, speed_fraction: float = 1.0) -> None:
        """Compute the joint target of the next tick.

        Args:
            speed_fraction: fraction of the full speed, 0 … 1: the speed slider; 0 while a program is paused.
        """
        change = speed_fraction - self.speed_fraction
        if abs(change) > SLIDER_STEP:
            speed_fraction = self.speed_fraction + math.copysign(SLIDER_STEP, change)
        self.speed_fraction = speed_fraction
        self.memory.record(self._plant.q, self._plant.wrench)
        mover = self._mover
        if mover is None and self._force is None and not self._freedrive:
            self._rest_ticks += 1
            self._target.rest()
            return
        self._rest_ticks = 0
        try:
            self._step(mover)
            if mover is not None and mover is self._mover and mover.done:
                self._mover = None
                if self._queued is not None:
                    queued, self._queued = self._queued, None
                    self._mover = queued()
        except (CannotMove, ValueError) as error:  # ValueError: no such arc exists from the point of rest
            self._fail(str(error))

    def movej(self, target: Sequence[float], a: float, v: float, t: float, r: float) -> None:
        """Start a straight move in joint space to `target` (6,) rad; a rad/s², v rad/s, t s, blend radius r m."""

        def build(tail: MoveJ | None) -> MoveJ:
            start = self._target.q if tail is None else tail.target
            path = [goal - here for here, goal in zip(start, target, strict=True)]
            length = max(abs(d) for d in path)
            profile = Trapezoid(length, v, a, t, (top_speed(path), JOINT_RAD_S2))
            return MoveJ(start, target, profile, length * blend_share(start, target, r, self._plant), tail)

        mover = self._mover
        self._begin(build, mover if isinstance(mover, MoveJ) and mover.ready else None)

    def movel(self, target: Sequence[float], a: float, v: float, t: float, r: float) -> None:
        """Start a straight move of the TCP to the pose `target`; a m/s², v m/s, t s, blend radius r m."""
        end = standing(target)
        if not self.reachable(target):
            self._fail("the target of a linear move cannot be reached")
            return

        def build(tail: PathMover | None) -> PathMover:
            return Line(self._target.tool() if tail is None else tail.end, end, (v, a, t), r, tail)

        mover = self._mover
        self._begin(build, mover if isinstance(mover, PathMover) and mover.ready else None)

    def movec(
        self, via: Sequence[float], target: Sequence[float], a: float, v: float, r: float, *, fixed: bool
    ) -> None:
        """Start a circular move of the TCP through the position of `via` to the pose `target`; see `cartesian.Arc`.

        Raises:
            ValueError: the three points lie on one line.
        """
        if not self.reachable(target):
            self._fail("the target of a circular move cannot be reached")
            return

        def build(tail: PathMover | None) -> PathMover:
            start = self._target.tool() if tail is None else tail.end
            return Arc(start, via[:3], standing(target), (v, a), r, fixed, tail)

        mover = self._mover
        self._begin(build, mover if isinstance(mover, PathMover) and mover.ready else None)

    def speedj(self, qd: Sequence[float], a: float, t: float) -> None:
        """Turn the joints at `qd` (6,) rad/s for `t` s, or until the next command if `t` is 0."""
        self._queued = None
        mover = self._mover
        if type(mover) is not SpeedJ:
            mover = SpeedJ(self._target.q, self._unscaled(self._target.qd))
            self._take(mover)
        mover.command(qd, a, t)

    def speedl(self, twist: Sequence[float], a: float, t: float, a_rot: float) -> None:
        """Move the TCP at `twist` (6,), base axes, for `t` s, or until the next command if `t` is 0."""
        self._queued = None
        mover = self._mover
        if type(mover) is not SpeedL or self._target.retooled:
            mover = SpeedL(self._target.tool(), self._unscaled(self.target_tcp_speed()))
            self._take(mover)
        mover.command(twist, a, a_rot, t)

    def stopj(self, a: float) -> None:
        """Bring the joints to rest; `a` is the deceleration of the leading axis, rad/s²."""
        self._queued = None
        self._take(self._stop(a) if self.moving else None)

    def stopl(self, a: float, a_rot: float) -> None:
        """Bring the TCP to rest at `a` m/s² and `a_rot` rad/s²."""
        self._queued = None
        if not self.moving:
            self._take(None)
            return
        self._take(StopL(self._target.tool(), self.target_tcp_speed(), a, a_rot))

    def servoj(self, target: Sequence[float], t: float, lookahead_s: float, gain: float) -> None:
        """Follow the joint set-point `target` (6,) rad; see `joint.ServoJ`."""
        self._queued = None
        mover = self._mover
        if not isinstance(mover, ServoJ):
            mover = ServoJ(self._target.q, self._target.qd)
            self._take(mover)
        mover.command(target, t, lookahead_s, gain)

    def servoc(self, target: Sequence[float], a: float, v: float, r: float) -> None:
        """Move to the pose `target` at constant speed, from the present motion; see `cartesian.ServoC`."""
        self._queued = None
        mover = self._mover
        if not isinstance(mover, ServoC) or self._target.retooled:
            mover = ServoC(self._target.tool(), self.target_tcp_speed())
            self._take(mover)
        mover.command(standing(target), v, a, r)

    def force(self, task: ForceTask) -> None:
        """Start force mode, or change its task."""
        self.end_freedrive()
        if self._force is None:
            self._force = ForceMode(task)
            self._displaced = True
        else:
            self._force.command(task)

    def end_force(self) -> None:
        """Leave force mode; the arm stays where the force has moved it, and a move under way continues."""
        if self._force is not None:
            self._force = None
            if self._mover is None:
                self.abandon()

    def freedrive(self, axes: Sequence[bool] = (True,) * 6, frame: Sequence[float] = (0.0,) * 6) -> None:
        """Let the arm be moved by hand; if not all `axes` (6,) are free, only along the free axes of the pose
        `frame`.
        """
        self.end_force()
        self._mover = self._queued = None
        self._freedrive = True
        if not all(axes):
            speeds = [FREEDRIVE_SPEED if free else 0.0 for free in axes]
            self._force = ForceMode(ForceTask(frame, axes, [0.0] * 6, 2, speeds))
            self._displaced = True

    def end_freedrive(self) -> None:
        """Hold the arm where the hand left it."""
        if self._freedrive:
            self._freedrive = False
            self.end_force()

    def freedrive_status(self) -> int:
        """Rate the present pose for motion by hand: 0 good, 1 near a singularity, 2 too near."""
        margin = float(singularity_margin(self._target.q).min())
        return (margin < NEAR_SINGULARITY) + (margin < TOO_NEAR_SINGULARITY)

    def reachable(self, pose: Sequence[float]) -> bool:
        """Return True if the configured TCP can reach a pose."""
        try:
            self.joints_at(pose)
        except KinematicsError:
            return False
        return True

    def joints_at(self, pose: Sequence[float]) -> list[float]:
        """Return the joint angles (6,) nearest to the target that bring the configured TCP to a pose.

        Raises:
            KinematicsError: there are none.
        """
        return inverse_at(pose, self._plant.tcp_offset, self._target.q)

    def _take(self, mover: Mover | None) -> None:
        """Continue with `mover` from the present target and speed."""
        self._mover = mover
        self._displaced = self._force is not None

    def _begin(self, build: "Callable[..., Mover]", tail: Mover | None) -> None:
        """Start a move from the end of `tail`, or from rest; any other motion is brought to its end first."""
        if tail is not None and not self._displaced:
            self._queued = None
            self._mover = build(tail)
        elif self._mover is not None or (self.moving and self._force is None):
            if not isinstance(self._mover, MoveJ | PathMover) or not self._mover.ready:
                self._take(self._stop(HOLD_RAD_S2))
            self._queued = lambda: self._start(build)
        else:
            self._mover = self._start(build)

    def _start(self, build: "Callable[..., Mover]") -> Mover:
        self._displaced = self._force is not None
        return build(None)

    def _stop(self, a: float) -> StopJ:
        return StopJ(self._target.q, self._target.qd, a)

    def _unscaled(self, speeds: Sequence[float]) -> list[float]:
        """Return present speeds (6,) scaled to full speed of the slider."""
        fraction = self.speed_fraction or 1.0
        return [v / fraction for v in speeds]

    def _step(self, mover: Mover | None) -> None:
        target = self._target
        if self._freedrive and self._force is None:
            target.set_joints(self._plant.q.tolist(), [0.0] * 6)
        elif isinstance(mover, ToolMover) and target.retooled:
            self.hold()  # the script has configured another TCP, so a motion of the old one ends
        elif self._displaced:
            self._displace(mover)
        elif isinstance(mover, JointMover):
            target.set_joints(*mover.step(self.speed_fraction))
        elif isinstance(mover, PathMover):
            position, rotation, twist = mover.step(self.speed_fraction)
            share = target.share_possible(position, rotation)
            if share < 1.0:  # a path is slowed down to the joints' limits, a speed is not
                mover.rewind()
                position, rotation, twist = mover.step(share * self.speed_fraction)
            target.set_tool(position, rotation, twist)
        elif isinstance(mover, ToolMover):
            target.set_tool(*mover.step(self.speed_fraction))

    def _displace(self, mover: Mover | None) -> None:
        """Advance one tick by speeds: the program's and, in force mode, their modification by the force."""
        target = self._target
        if isinstance(mover, JointMover):
            twist = target.twist_of(*mover.step(self.speed_fraction))
        elif isinstance(mover, ToolMover):
            twist = mover.step(self.speed_fraction)[2]
        else:
            twist = [0.0] * 6
        position, rotation = target.tool()
        if self._force is not None:
            x, y, z, *turn = self._plant.tcp_pose()
            off = rotvec_of(multiply(rotation_of(turn[0], turn[1], turn[2]), transpose(rotation)))
            if self._force.exceeded((x - position[0], y - position[1], z - position[2], *off)):
                raise CannotMove("the tool deviates too far from its path in force mode")
            twist = self._force.step(
                twist,
                position,
                self._plant.wrench.tolist(),
                saturated=self._plant.saturated,
                damping=self.force_damping,
                gain=self.force_gain,
                fraction=self.speed_fraction,
            )
        vx, vy, vz, wx, wy, wz = twist
        target.set_tool(
            (position[0] + TICK_S * vx, position[1] + TICK_S * vy, position[2] + TICK_S * vz),
            multiply(rotation_of(TICK_S * wx, TICK_S * wy, TICK_S * wz), rotation),
            twist,
        )

    def _fail(self, why: str) -> None:
        self.fault = why
        self._mover = self._queued = self._force = None
        self._target.rest()
