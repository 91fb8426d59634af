"""The emulated arm controller: pose targets in, joint set-points out, 500 times a second, for n arms at once.

It evaluates the compliance law, follows it by inverse kinematics, and has limits of its own: workspace, step, speed,
force ceiling, age of the target, joint range, distance from singularities, and a protective stop. On a UR arm the
control program and the robot do the same. These limits are an inner layer below the service's limits.
"""

import numpy as np

from sim_backend.world import compiled, kinematics, quaternion
from sim_backend.world.compliance import Law, Reference, advance, limit_speed
from sim_backend.world.delays import TargetDelays
from sim_backend.world.linear import product
from sim_backend.world.servo import JointServo
from wire import extension, pose
from wire.arrays import BoolArray, CellIndices, FloatArray
from wire.law import ControlLimits
from wire.records import TICK_S, Program, StopReason

KINEMATICS_TICKS = 20
"""Ticks between exact solutions of the inverse kinematics; between them the Jacobian's inverse carries the joints."""
SINGULARITY_MARGIN = 0.05
"""Smallest `kinematics.singularity_margin` at which the arm is still driven."""
ANGLE_LIMIT_RAD = 1e6
"""Joint angle from which an arm counts as singular: its Jacobian would be a matter of rounding."""
PROTECTIVE_FORCE_N = 150.0
PROTECTIVE_ERROR_RAD = 0.05
STOP_S = 0.1
"""Time in which a stop's speed limit falls to zero, s: long enough to yield to a contact. Noise cannot prolong it."""
FOLLOW_S = 0.02
"""Time constant with which the reference of a blind stop follows the arm, s."""
FOLLOW_SHARE = 0.3
"""Share of its change that the twist of a blind stop takes in one tick; an arm cannot stop at once."""
MIN_PROTECTIVE_STOP_S = 5.0
"""Shortest protective stop, s. An earlier unlock is refused, as on a UR controller."""

_STEP = kinematics.JOINT_SPEED_RAD_S * TICK_S


class ArmController:
    """Controllers of n arms.

    Args:
        n: number of arms.
        tcp_offset_m: distance of the TCP along the flange's z axis, m.
        payload: mass, kg, and its centre along the flange's z axis, m, for the gravity that the joints carry.
        stiffness: (6,) stiffness of the joint servos, N·m/rad.
        damping: (6,) damping of the joint servos, N·m·s/rad.

    Attributes:
        delays: delays of the targets.
        bound: arrays and constants for the compiled tick, where it is used.
    """

    def __init__(
        self, n: int, tcp_offset_m: float, payload: tuple[float, float], stiffness: FloatArray, damping: FloatArray
    ) -> None:
        self.n = n
        self._all = np.arange(n)
        self._offset = np.array([0.0, 0.0, tcp_offset_m])
        self._servo = JointServo(n, stiffness, damping, payload[0], (0.0, 0.0, payload[1]))
        self.program = np.zeros(n, np.int64)
        self.stop_reason = np.zeros(n, np.int64)
        self.peak_force = np.zeros(n)
        self.law = Law(np.ones((n, 6)), np.ones((n, 6)), np.ones((n, 6)), np.ones((n, 2)))
        self.reference = Reference(np.zeros((n, 3)), np.tile([1.0, 0, 0, 0], (n, 1)), np.zeros((n, 6)))
        self.target_position = np.zeros((n, 3))
        self.target_quaternion = np.tile([1.0, 0, 0, 0], (n, 1))
        self.joints = np.zeros((n, 6))
        self.delays = TargetDelays(n)
        self._pending = np.full(n, -1)
        self._pending_position = np.zeros((n, 3))
        self._pending_quaternion = np.zeros((n, 4))
        self._age = np.zeros(n, np.int64)
        self._halted = np.zeros(n, np.int64)
        self._blind: BoolArray = np.zeros(n, bool)
        self._max_speed = np.ones((n, 2))
        self._max_age = np.full(n, np.iinfo(np.int64).max)
        self._max_step = np.full((n, 2), np.inf)
        self._workspace = np.tile(np.array([[-np.inf], [np.inf]]), (n, 1, 3))
        self._ceiling = np.full(n, np.inf)
        self.jacobian = np.zeros((n, 6, 6))
        self._inverse = np.zeros((n, 6, 6))
        self._phase = np.zeros(n, np.int64)
        self._trusted: BoolArray = np.zeros(n, bool)
        self._compiled = compiled.tick
        if self._compiled is not None:
            self._bind(self._compiled)

    def place(self, cells: CellIndices, joints: FloatArray, target_delay: CellIndices) -> None:
        """Put arms at rest at `joints` (k, 6), disengaged; `target_delay` is that of `TargetDelays.begin`."""
        self.joints[cells] = joints
        self.program[cells] = Program.IDLE
        self.stop_reason[cells] = StopReason.NONE
        self.peak_force[cells] = 0.0
        self.reference.twist[cells] = 0.0
        self.delays.begin(cells, target_delay)
        self._pending[cells] = -1
        self._blind[cells] = False
        position, orientation = self._tcp(*kinematics.forward(joints))
        self.reference.position[cells] = self.target_position[cells] = position
        self.reference.quaternion[cells] = self.target_quaternion[cells] = orientation
        self._phase[cells] = 0

    def engage(
        self, cells: CellIndices, stiffness: FloatArray, damping: FloatArray, inertia: FloatArray, limits: ControlLimits
    ) -> BoolArray:
        """Start the control program with the present reference as the target.

        Args:
            cells: (k,) arms.
            stiffness: (6,) or (k, 6), N/m and N·m/rad; see `compliance.Law`.
            damping: (6,) or (k, 6), N·s/m and N·m·s/rad.
            inertia: (6,) or (k, 6), kg and kg·m².
            limits: the program's own limits.

        Returns:
            (k,) True for the arms that were engaged: those that were idle.
        """
        idle = self.program[cells] == Program.IDLE
        cells = cells[idle]
        self.law.stiffness[cells] = np.broadcast_to(stiffness, (len(idle), 6))[idle]
        self.law.damping[cells] = np.broadcast_to(damping, (len(idle), 6))[idle]
        self.law.inertia[cells] = np.broadcast_to(inertia, (len(idle), 6))[idle]
        self.law.max_speed[cells] = self._max_speed[cells] = limits.max_speed
        self._max_step[cells] = limits.max_step
        self._workspace[cells] = limits.workspace
        self._ceiling[cells] = limits.force_ceiling_n
        self._max_age[cells] = round(limits.target_age_s / TICK_S)
        self._age[cells] = 0
        self._pending[cells] = -1
        self.target_position[cells] = self.reference.position[cells]
        self.target_quaternion[cells] = self.reference.quaternion[cells]
        self.peak_force[cells] = 0.0
        self.stop_reason[cells] = StopReason.NONE
        self._blind[cells] = False
        self.program[cells] = Program.ENGAGED
        return idle

    def set_target(self, cells: CellIndices, position: FloatArray, orientation: FloatArray) -> BoolArray:
        """Give arms a new target. A bad target stops the program; it is not clipped.

        Args:
            cells: (k,) arms.
            position: (k, 3) m.
            orientation: (k, 4) quaternion, scalar first.

        Returns:
            (k,) True for accepted targets: arm engaged, values finite, inside the workspace, within the step limit.
        """
        engaged = self.program[cells] == Program.ENGAGED
        finite = np.isfinite(position).all(1) & np.isfinite(orientation).all(1)
        box = self._workspace[cells]
        inside = ((position >= box[:, 0]) & (position <= box[:, 1])).all(1)
        waiting = self._pending[cells] >= 0
        last_position = np.where(waiting[:, None], self._pending_position[cells], self.target_position[cells])
        last_orientation = np.where(waiting[:, None], self._pending_quaternion[cells], self.target_quaternion[cells])
        step = np.linalg.norm(position - last_position, axis=1)
        turn = 2.0 * np.arccos(np.clip(np.abs((orientation * last_orientation).sum(1)), 0.0, 1.0))
        near = (step <= self._max_step[cells, 0]) & (turn <= self._max_step[cells, 1])
        good = engaged & finite & inside & near
        self._stop(cells[engaged & ~good], StopReason.TARGET_REJECTED)
        taken = cells[good]
        self._pending[taken] = self.delays.next(taken)
        self._pending_position[taken] = position[good]
        self._pending_quaternion[taken] = orientation[good]
        self._age[taken] = 0
        return good

    def stop(self, cells: CellIndices, reason: StopReason, *, blind: bool = False) -> None:
        """Decelerate and hold. Idle arms stay idle; a second stop changes nothing.

        Args:
            cells: (k,) arms.
            reason: why.
            blind: do not yield to the sensor meanwhile, because it is not believed; valid for a stop under way, too.
                The reference follows the arm instead, which takes the servos' push away.
        """
        if blind:
            self._blind[cells] = True
        self._stop(cells[self.program[cells] == Program.ENGAGED], reason)

    def unlock(self, cells: CellIndices) -> None:
        """Release the protective stop, if it has lasted for `MIN_PROTECTIVE_STOP_S`."""
        ready = (self.program[cells] == Program.PROTECTIVE_STOP) & (
            self._halted[cells] * TICK_S >= MIN_PROTECTIVE_STOP_S
        )
        self.program[cells[ready]] = Program.IDLE

    def update(
        self,
        joints: FloatArray,
        wrench: FloatArray,
        position: FloatArray,
        orientation: FloatArray,
        saturated: BoolArray | None = None,
        out: FloatArray | None = None,
    ) -> FloatArray:
        """Run one tick.

        Args:
            joints: (n, 6) measured joint angles, rad.
            wrench: (n, 6) compensated wrench of the sensor, at the TCP, base axes.
            position: (n, 3) measured TCP.
            orientation: (n, 4) quaternion of the measured TCP.
            saturated: (n,) True where the sensor is at the end of its range; its load then counts as above the ceiling.
                None: nowhere.
            out: (n, 6) where to write the set-points; None: into a new array.

        Returns:
            (n, 6) set-points for the joint servos, rad, with the lead and sag that make the arm follow closely.
        """
        saturated = self._trusted if saturated is None else saturated
        out = np.empty((self.n, 6)) if out is None else out
        if self._compiled is not None:
            due = self._compiled.lead(*self.bound, joints, wrench, position, orientation, saturated)
            inverses = np.asarray(np.linalg.inv(self._jacobians[:due]), np.float64) if due else self._jacobians
            self._compiled.follow(*self.bound, inverses, out)
            return out
        self._release_pending()
        wrench = self._watch(joints, wrench, position, orientation, saturated)
        engaged = self.program == Program.ENGAGED
        if engaged.all():
            advance(self.law, self.reference, self.target_position, self.target_quaternion, wrench)
        else:
            self._advance_some(wrench, position, orientation)
        # every arm has a phase of its own, so that an event of one arm does not affect another
        due = self._phase == 0
        if due.all():
            self._solve(self._all)
        elif due.any():
            self._solve(np.flatnonzero(due))
        self._phase += 1
        self._phase %= KINEMATICS_TICKS
        rates = product(self._inverse, self.reference.twist)
        racing: BoolArray = np.logical_or.reduce(np.abs(rates) > kinematics.JOINT_SPEED_RAD_S, axis=1)
        if racing.any():
            self._brake(racing, rates)
        self.joints += TICK_S * rates
        out[:] = self._servo.set_points(self.joints, rates)
        return out

    def _release_pending(self) -> None:
        due = self._pending == 0
        if due.any():
            self.target_position[due] = self._pending_position[due]
            self.target_quaternion[due] = self._pending_quaternion[due]
        self._pending -= self._pending >= 0

    def _watch(
        self,
        joints: FloatArray,
        wrench: FloatArray,
        position: FloatArray,
        orientation: FloatArray,
        saturated: BoolArray,
    ) -> FloatArray:
        """Stop arms that violate a limit; return the wrench to use, zero where it is not a number."""
        force = np.sqrt((wrench[:, :3] ** 2).sum(1))
        np.fmax(self.peak_force, force, out=self.peak_force)
        self._age += 1
        self._halted += 1
        known = np.isfinite(wrench.sum(1))
        over, old = (force >= self._ceiling) | ~known | saturated, self._age > self._max_age
        lagging = (np.abs(joints - self.joints) > PROTECTIVE_ERROR_RAD).any(1) | (force >= PROTECTIVE_FORCE_N)
        if over.any() or old.any():
            self.stop(np.flatnonzero(over), StopReason.FORCE_CEILING)
            self.stop(np.flatnonzero(old), StopReason.TARGET_AGE)
        # a stop holds the arm's position, not the reference's
        ending = np.flatnonzero((self.program == Program.STOPPING) & (self._halted == 1))
        if ending.size:
            self.target_position[ending] = position[ending]
            self.target_quaternion[ending] = orientation[ending]
        if lagging.any():
            self._protect(np.flatnonzero(lagging), StopReason.PROTECTIVE_FORCE)
            self.joints[lagging] = joints[lagging]
        return wrench if known.all() else np.where(known[:, None], wrench, 0.0)

    def _brake(self, racing: BoolArray, rates: FloatArray) -> None:
        """Stop arms with a joint rate beyond its limit, the first sign of a near singularity."""
        self.stop(np.flatnonzero(racing), StopReason.KINEMATICS)
        self.reference.twist[racing] = 0.0
        rates[racing] = 0.0

    def _stop(self, cells: CellIndices, reason: StopReason) -> None:
        self.program[cells] = Program.STOPPING
        self.stop_reason[cells] = reason
        self._halted[cells] = 0
        self._pending[cells] = -1

    def _protect(self, cells: CellIndices, reason: StopReason) -> None:
        fresh = cells[self.program[cells] != Program.PROTECTIVE_STOP]
        self.program[fresh] = Program.PROTECTIVE_STOP
        self.stop_reason[fresh] = reason
        self._halted[fresh] = 0
        self.reference.twist[fresh] = 0.0
        self._phase[fresh] = 0

    def _advance_some(self, wrench: FloatArray, position: FloatArray, orientation: FloatArray) -> None:
        """Advance the law for arms that are engaged or coming to rest. The others hold their reference."""
        held = (self.program == Program.IDLE) | (self.program == Program.PROTECTIVE_STOP)
        stopping = self.program == Program.STOPPING
        blind = np.flatnonzero(stopping & self._blind)
        before = self.reference.position[blind], self.reference.quaternion[blind], self.reference.twist[blind]
        left = np.maximum(1.0 - self._halted[stopping] * (TICK_S / STOP_S), 0.0)
        self.law.max_speed[stopping] = self._max_speed[stopping] * left[:, None]
        kept = self.reference.position[held].copy(), self.reference.quaternion[held].copy()
        advance(self.law, self.reference, self.target_position, self.target_quaternion, wrench)
        self.reference.position[held], self.reference.quaternion[held] = kept
        self.reference.twist[held] = 0.0
        if blind.size:
            self._follow(blind, *before, position[blind], orientation[blind])
        self.program[np.flatnonzero(stopping)[left == 0.0]] = Program.IDLE

    def _follow(
        self,
        cells: CellIndices,
        at: FloatArray,
        turned: FloatArray,
        twist: FloatArray,
        position: FloatArray,
        orientation: FloatArray,
    ) -> None:
        """Let the reference of `cells` (k,), which was `at` (k, 3) and `turned` (k, 4) with a `twist` (k, 6), follow
        the arm's measured `position` (k, 3) and `orientation` (k, 4).
        """
        offset = np.concatenate([position - at, quaternion.between(turned, orientation)], axis=1)
        twist += FOLLOW_SHARE * (offset / FOLLOW_S - twist)
        limit_speed(twist, self.law.max_speed[cells])
        quaternion.turn(turned, (0.5 * TICK_S) * twist[:, 3:])
        self.reference.position[cells] = at + TICK_S * twist[:, :3]
        self.reference.quaternion[cells], self.reference.twist[cells] = turned, twist

    def _solve(self, cells: CellIndices) -> None:
        """Bring the joints exactly onto the reference, and refresh the Jacobian's inverse and the payload's sag."""
        joints = self.joints[cells]
        flange, rotation, jacobian = kinematics.forward_and_jacobian(joints, self._offset)
        self.jacobian[cells] = jacobian
        position, orientation = self._tcp(flange, rotation)
        singular = (kinematics.singularity_margin(joints) < SINGULARITY_MARGIN).any(1)
        singular |= ~(np.abs(joints) <= ANGLE_LIMIT_RAD).all(1)
        outside = (np.abs(joints) > kinematics.JOINT_RANGE_RAD).any(1)
        held = self.program[cells] == Program.PROTECTIVE_STOP
        if singular.any() or outside.any():
            self.stop(cells[singular], StopReason.KINEMATICS)
            self.stop(cells[outside], StopReason.JOINT_LIMIT)
            self.reference.twist[cells[singular | outside]] = 0.0
            jacobian[singular] = np.eye(6)
            held |= singular
        inverse = np.asarray(np.linalg.inv(jacobian), np.float64)
        inverse[singular] = 0.0  # a singular arm does not move
        self._inverse[cells] = inverse
        if held.any():
            self.reference.position[cells[held]] = position[held]
            self.reference.quaternion[cells[held]] = orientation[held]
        turn = quaternion.between(orientation, self.reference.quaternion[cells])
        error = np.concatenate([self.reference.position[cells] - position, turn], axis=1)
        error -= TICK_S * self.reference.twist[cells]  # `update` adds this step afterwards
        joints += np.clip(product(inverse, error), -_STEP, _STEP)
        self.joints[cells] = joints
        self._servo.refresh(cells, joints)

    def _tcp(self, flange: FloatArray, rotation: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return position (k, 3) and quaternion (k, 4) of the TCP for a flange's pose."""
        return flange + rotation @ self._offset, quaternion.from_rotvec(pose.rotvec_from_rotation(rotation))

    def _bind(self, tick: compiled.Tick) -> None:
        """Hand the arrays and constants of this controller to the compiled tick."""
        n, law, reference = self.n, self.law, self.reference
        self._singular: BoolArray = np.zeros(n, bool)
        self._errors = np.zeros((n, 6))
        self._jacobians = np.zeros((n, 6, 6))
        nested = {
            "stiffness": law.stiffness,
            "damping": law.damping,
            "inertia": law.inertia,
            "max_speed": law.max_speed,
            "speed_limit": self._max_speed,
            "reference_position": reference.position,
            "reference_quaternion": reference.quaternion,
            "reference_twist": reference.twist,
            "sag": self._servo.sag,
        }
        constants = {
            **kinematics.LENGTHS_M,
            **self._servo.constants(),
            "tick_s": TICK_S,
            "stop_share": TICK_S / STOP_S,
            "follow_s": FOLLOW_S,
            "follow_share": FOLLOW_SHARE,
            "protective_force_n": PROTECTIVE_FORCE_N,
            "protective_error_rad": PROTECTIVE_ERROR_RAD,
            "least_margin": SINGULARITY_MARGIN,
            "angle_limit": ANGLE_LIMIT_RAD,
            "kinematics_ticks": KINEMATICS_TICKS,
            "joint_range": kinematics.JOINT_RANGE_RAD,
            "joint_speed": kinematics.JOINT_SPEED_RAD_S,
            "joint_step": _STEP,
            "tcp": self._offset,
        }
        self.bound = compiled.arrays(tick.ARM, vars(self) | nested), extension.constants(tick.ARM_CONSTANTS, constants)
