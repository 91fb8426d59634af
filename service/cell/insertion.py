"""One insertion from pre-flight to retract, driven by samples: no clock, no driver, no event loop.

Every sample that the monitor has passed goes in; orders come out, in the order in which they must be carried out.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
import numpy.typing as npt

from service.cell.arm_stops import why_not_drive
from service.cell.orders import Disengage, Engage, Fail, Halt, Infer, Move, Order, Succeed, ZeroFt
from service.cell.path import Progress, StraightPath, within_step
from service.cell.plan import PATH_TICKS, PROBE_SAMPLES, Plan
from service.cell.recent import Recent
from service.cell.rest import Rest
from service.cell.stages import DRIVEN, Stage
from service.cell.tick_record import TickRecord
from service.drivers.base import PoseTarget, Program, Sample
from service.faults import FaultCode
from service.policy.compiled import rotvec_from_yaw, yaw_and_tilt
from service.policy.step import Seen
from service.safety import dsl, preflight
from service.safety.probe import Answer, Probe
from service.safety.seating import Finding, Seat, Seating
from service.safety.stop import STANDSTILL_M_S
from service.safety.witness import Witness
from wire.arrays import Float32Array, FloatArray

ZEROING_TRIES = 12
"""Largest number of zeroings: each takes one noisy reading, so a bias may need another; contact gets none."""
SETTLE_TICKS = 25
"""Samples after zeroing that may still show the old zero: command, sensor and transport delay."""
STANDSTILL_TICKS = 1000
"""Samples in which the arm must come to rest, its program idle, before the sensor is zeroed."""
ENGAGE_TICKS = 250
"""Samples in which the arm must engage."""
SAFE_RISE_M = 0.01
"""Height of the crossing above the higher of start and hover, m."""
OUTRAGEOUS_ACTION = 10.0
"""Multiple of an action's limit that counts towards `clamped_steps`; trained policies stay within a few times."""
OUTRAGEOUS_CHANGE = 3.0
"""Multiple of the allowed change of target that counts as well."""
NO_ESTIMATE = np.full(3, np.nan)


@dataclass(frozen=True, slots=True)
class Asked:
    """The question to the policy that is not answered yet.

    Attributes:
        sample: the newest one when it was asked.
        seen: the measurements of that moment.
        observation: (n,) float32, as the policy got it.
    """

    sample: Sample
    seen: Seen
    observation: Float32Array


class Insertion:
    """Decides what the arm does next in one run. Used once.

    Args:
        plan: of this insertion.

    Attributes:
        witness: compares the sensor with the joints, once the sensor was zeroed; None before, and without joints.
        steps: policy steps taken.
        last: record of the last policy step; None before the first.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._stage = Stage.ZEROING
        self._stage_seq = -1
        self._ended = False
        self._zeroings = 0
        self._window = Recent(max(plan.step.ticks, plan.preflight.window_samples))
        self._rest = Rest(plan)
        self.witness: Witness | None = None
        self._estimates: list[FloatArray] = []
        self._hole = plan.nominal_hole
        self._waypoints: list[FloatArray] = []
        self._path = StraightPath(plan.start_position, plan.start_yaw, [], 0.0, np.inf)
        self._state = plan.step.begin(plan.start_position, plan.start_yaw)
        self._asked: Asked | None = None
        self._outrageous = 0
        self._seating = Seating(plan.seating)
        self._doubt: tuple[Seat, Probe] | None = None
        self._sent: tuple[FloatArray, float] | None = None
        self._started_s: float | None = None
        self._ended_s: float | None = None
        self.steps = 0
        self.last: TickRecord | None = None

    @property
    def stage(self) -> Stage:
        """Stage in which the insertion is, or in which it ended."""
        return self._stage

    @property
    def depth_m(self) -> float | None:
        """Depth of the peg's bottom below the surface at the last policy step."""
        return None if self.last is None else self.last.depth_m

    @property
    def phase(self) -> str | None:
        """Phase of the lock at the last policy step."""
        return None if self.last is None else dsl.Phase(int(self.last.dsl.phase)).name

    @property
    def z_lock_m(self) -> float | None:
        """Height of the lock at the last policy step; None without a lock."""
        lock = None if self.last is None else float(self.last.dsl.z_lock)
        return lock if lock is not None and np.isfinite(lock) else None

    def asks_at(self, sample: Sample) -> bool:
        """Return whether the policy was asked at this sample and has not answered."""
        return self._asked is not None and self._asked.sample is sample

    def duration_s(self, now_s: float) -> float:
        """Return the time since the first approach move, on the samples' clock."""
        return 0.0 if self._started_s is None else (self._ended_s or now_s) - self._started_s

    def on_sample(self, sample: Sample) -> list[Order]:
        """Take in one sample that the monitor has passed."""
        return list(self._advance(sample))

    def take_action(self, action: npt.NDArray[np.floating[Any]]) -> list[Order]:
        """Take in the policy's answer to the last `Infer`; an answer after the run's end is dropped.

        Args:
            action: (m,) as the contract has it.
        """
        if self._ended or self._stage is not Stage.INSERTING or self._asked is None:
            return []
        asked, self._asked = self._asked, None
        return list(self._act(asked, np.asarray(action, np.float64)))

    # --- stages

    def _advance(self, sample: Sample) -> Iterator[Order]:
        if self._ended:
            return
        if (halt := why_not_drive(sample, engaged=self._stage in DRIVEN)) is not None:
            yield self._halt(halt.code, halt.text)
            return
        if self.witness is not None and (verdict := self.witness.check(sample.wrench, sample.joint_force)).fault:
            yield self._halt(verdict.fault, verdict.text)
            return
        self._window.append(sample.wrench)
        if self._stage_seq < 0:
            self._stage_seq = sample.seq
        match self._stage:
            case Stage.ZEROING:
                yield from self._await_free(sample)
            case Stage.CHECKING:
                yield from self._check(sample)
            case Stage.ENGAGING:
                yield from self._await_engaged(sample)
            case Stage.APPROACHING:
                yield from self._approach(sample)
            case Stage.INSERTING:
                yield from self._insert(sample)
            case Stage.PROBING:
                yield from self._ask_walls(sample)
            case Stage.RETRACTING:
                yield from self._retract(sample)

    def _await_free(self, sample: Sample) -> Iterator[Order]:
        """Zero the sensor once the tool stands and carries nothing; zeroing in contact would hide the contact."""
        still = float(np.linalg.norm(sample.tcp_velocity[:3])) < STANDSTILL_M_S
        self._rest.add(sample)
        if sample.program is not Program.IDLE or not still:
            self._rest.clear()
            if sample.seq - self._stage_seq > STANDSTILL_TICKS:
                text = (
                    f"the arm moves, or its program is not idle ({sample.program.name}): does another client drive it?"
                )
                yield from self._fail(FaultCode.AUTHORITY, text)
        elif self._rest.is_long_enough:
            verdict = self._rest.judge_load()
            if verdict.fault is None:
                yield from self._zero(sample)
            else:
                yield from self._fail(verdict.fault, verdict.text)

    def _zero(self, sample: Sample) -> Iterator[Order]:
        self._zeroings += 1
        self._go(Stage.CHECKING, sample)
        yield ZeroFt()

    def _check(self, sample: Sample) -> Iterator[Order]:
        if sample.seq - self._stage_seq <= SETTLE_TICKS:
            self._window.clear()
            self._rest.clear()
            self._estimates.clear()
            return
        self._rest.add(sample)
        if sample.hole_estimate is not None:
            self._estimates.append(sample.hole_estimate)
        # Counted, not timed: a busy transport loses samples now and then
        if len(self._window) < self._plan.preflight.window_samples:
            return
        plan = self._plan
        verdict = preflight.check_wrench(plan.preflight, self._window.newest(len(self._window)))
        if verdict.fault is FaultCode.BIAS and self._zeroings < ZEROING_TRIES:
            yield from self._zero(sample)
            return
        if verdict.fault is None:
            verdict = self._rest.judge_load()  # a load that grows while the sensor is zeroed is zeroed away
        yaw, tilt = yaw_and_tilt(sample.tcp_rotvec)
        if verdict.fault is None:
            verdict = preflight.check_start_pose(
                plan.preflight, sample.tcp_position, float(yaw), tilt, plan.start_position, plan.start_yaw
            )
        if verdict.fault is not None:
            yield from self._fail(verdict.fault, verdict.text)
            return
        if (text := self._locate_hole(sample)) is not None:
            yield from self._fail(FaultCode.BOUNDS, text)
            return
        self.witness = self._rest.witness()
        self._started_s = sample.time_s
        self._go(Stage.ENGAGING, sample)
        yield Engage(plan.law, plan.limits)

    def _locate_hole(self, sample: Sample) -> str | None:
        """Settle the hole's position and the way above it; return the reason where that is not possible."""
        plan = self._plan
        if plan.uses_estimate:
            if not self._estimates:
                return "the policy needs the camera's estimate of the hole, and there is none: check the camera"
            self._hole = np.mean(self._estimates, axis=0)
            if (text := plan.why_not_hole(self._hole)) is not None:
                return text
        above = self._hole + np.array([0.0, 0.0, plan.hover_m])
        safe_z = max(sample.tcp_position[2], above[2]) + SAFE_RISE_M
        self._waypoints = [*(np.array([*end[:2], safe_z]) for end in (sample.tcp_position, above)), above]
        lower, upper = plan.limits.workspace
        for point in self._waypoints:
            if not ((point >= lower) & (point <= upper)).all():
                return f"the way to the hole leads to {np.round(point, 4).tolist()} m, outside the workspace"
        return None

    def _await_engaged(self, sample: Sample) -> Iterator[Order]:
        if sample.program is Program.ENGAGED:
            self._path = self._plan_path(self._waypoints, self._plan.start_yaw, sample)
            self._go(Stage.APPROACHING, sample)
        elif sample.seq - self._stage_seq > ENGAGE_TICKS:
            yield self._halt(FaultCode.LINK, "the arm did not engage: does another client hold it?")

    def _approach(self, sample: Sample) -> Iterator[Order]:
        if (sample.seq - self._stage_seq) % PATH_TICKS == 0:
            yield self._advance_path(sample)
        match self._path.progress(sample):
            case Progress.ARRIVED:
                self._go(Stage.INSERTING, sample)
                self._state = self._plan.step.begin(self._path.target, self._path.yaw)
                yield from self._observe(sample)
            case Progress.OVERDUE:
                yield from self._fail(FaultCode.BOUNDS, "the arm did not arrive above the hole: is the way clear?")
            case Progress.UNDER_WAY:
                pass

    def _insert(self, sample: Sample) -> Iterator[Order]:
        ticks = sample.seq - self._stage_seq
        if (text := self._plan.seating.why_stray(self._hole, sample.tcp_position)) is not None:
            yield from self._fail(FaultCode.BOUNDS, text, sample)
        elif self._asked is not None:
            if sample.time_s - self._asked.sample.time_s >= self._plan.policy_deadline_s:
                text = f"no action within {self._plan.policy_deadline_s * 1e3:g} ms; the last target was held"
                yield self._halt(FaultCode.POLICY_DEADLINE, text)
        elif ticks >= self._plan.step.ticks:
            # A late action does not shorten the next step
            late = ticks >= 2 * self._plan.step.ticks
            self._stage_seq = sample.seq if late else self._stage_seq + self._plan.step.ticks
            yield from self._observe(sample)

    def _ask_walls(self, sample: Sample) -> Iterator[Order]:
        if self._doubt is None or (sample.seq - self._stage_seq) % PATH_TICKS:
            return
        seat, probe = self._doubt
        force = self._window.newest(PROBE_SAMPLES)[:, :3].mean(0)
        if (answer := probe.advance(sample.tcp_position, force)) is Answer.HELD:
            yield from self._succeed(seat.depth_m, sample)
        elif answer is Answer.UNDER_WAY:
            yield self._scripted(probe.target, probe.yaw)
        else:
            yield from self._fail(FaultCode.SEARCH_LIMIT, f"{seat.text}; {probe.text}", sample)

    def _retract(self, sample: Sample) -> Iterator[Order]:
        if (sample.seq - self._stage_seq) % PATH_TICKS == 0:
            yield self._advance_path(sample)
        # A peg that sticks does not fail the run: the operator sees it, and the arm stands still in either case
        if self._path.progress(sample) is not Progress.UNDER_WAY:
            yield self._disengage(sample.time_s)

    # --- one policy step

    def _observe(self, sample: Sample) -> Iterator[Order]:
        plan, estimate = self._plan, sample.hole_estimate
        # A missing estimate is not a fault: the tool may hide the hole; the policy then uses the mean of earlier ones
        if plan.uses_estimate and estimate is not None and (text := plan.why_not_hole(estimate)) is not None:
            yield self._halt(FaultCode.BOUNDS, text)
            return
        seen = self._see(sample)
        self._state, observation = plan.step.observe(self._state, seen)
        if not isfinite(sum(observation.tolist())):  # in double precision single ones cannot overflow
            yield self._halt(FaultCode.SENSOR_INVALID, "an observation of the policy is not known: check the camera")
            return
        self._asked = Asked(sample, seen, observation)
        yield Infer(observation)

    def _see(self, sample: Sample) -> Seen:
        yaw, tilt = yaw_and_tilt(sample.tcp_rotvec)
        return Seen(
            position=sample.tcp_position,
            yaw=yaw,
            tilt=tilt,
            wrench_window=self._window.newest(self._plan.step.ticks),
            hole_estimate=NO_ESTIMATE if sample.hole_estimate is None else sample.hole_estimate,
            nominal_hole=self._plan.nominal_hole,
            start_yaw=np.asarray(self._plan.start_yaw),
            last_joint=np.asarray(sample.q[5]),
        )

    def _act(self, asked: Asked, action: FloatArray) -> Iterator[Order]:
        plan, sample = self._plan, asked.sample
        values: list[float] = action.tolist()
        if not all(map(isfinite, values)):
            yield self._halt(FaultCode.POLICY_INVALID, f"the policy answered {values}; nothing was sent")
            return
        self._state, decision = plan.step.act(self._state, asked.seen, action)
        bounded = decision.bounded
        if bool(bounded.invalid):
            text = f"the action {values} leads to no pose; nothing was sent"
            yield self._halt(FaultCode.POLICY_INVALID, text)
            return
        order = self._move(bounded.position, float(bounded.yaw))
        seat, settled = self._seating.observe(self._hole, float(self._state.lock.z_contact0), sample.tcp_position)
        self.last = TickRecord(
            step=self.steps,
            sample=sample,
            observation=asked.observation,
            action=action,
            displacement=decision.displacement,
            dsl=decision.locked,
            bounded=bounded,
            target=order.target,
            depth_m=seat.depth_m,
        )
        self.steps += 1
        if bool(bounded.tilt):
            lean = float(np.linalg.norm(asked.seen.tilt))
            text = f"the tool is tilted by {lean:.3f} rad, limit {plan.step.bounds.tilt_rad:g} rad; nothing was sent"
            yield self._halt(FaultCode.BOUNDS, text)
            return
        excess, change = max(map(abs, values)), float(bounded.excess)
        outrageous = excess > OUTRAGEOUS_ACTION or change > OUTRAGEOUS_CHANGE
        self._outrageous = self._outrageous + 1 if outrageous else 0
        if self._outrageous >= plan.clamped_steps:
            text = f"an action of {excess:.3g} times its limit, a change of {change:.3g} times the allowed one"
            yield self._halt(FaultCode.BOUNDS, f"{self._outrageous} outrageous steps in a row, the last with {text}")
            return
        yield order
        if settled:
            yield from self._conclude(seat, sample)
        elif (text := plan.why_end(decision.locked, self.steps)) is not None:
            yield from self._fail(FaultCode.SEARCH_LIMIT, text, sample)

    def _conclude(self, seat: Seat, sample: Sample) -> Iterator[Order]:
        """Act on a finding about the peg's seat."""
        if seat.finding is Finding.SEATED:
            yield from self._succeed(seat.depth_m, sample)
        elif seat.finding is Finding.CONTRADICTED:
            yield from self._fail(FaultCode.BOUNDS, seat.text, sample)
        else:
            self._doubt = seat, Probe(self._plan.probe, sample.tcp_position, float(yaw_and_tilt(sample.tcp_rotvec)[0]))
            self._go(Stage.PROBING, sample)

    # --- ends

    def _halt(self, code: FaultCode, text: str) -> Halt:
        self._ended = True
        return Halt(code, text)

    def _disengage(self, ended_s: float | None) -> Disengage:
        self._ended, self._ended_s = True, ended_s
        return Disengage()

    def _succeed(self, depth_m: float, sample: Sample) -> Iterator[Order]:
        yield Succeed(depth_m)
        yield from self._begin_retract(sample)

    def _fail(self, code: FaultCode, text: str, sample: Sample | None = None) -> Iterator[Order]:
        yield Fail(code, text)
        if self._stage in DRIVEN:
            yield from self._begin_retract(sample)
        else:
            yield self._disengage(None)

    def _begin_retract(self, sample: Sample | None) -> Iterator[Order]:
        self._stage = Stage.RETRACTING
        if sample is None or not self._plan.retract:
            yield self._disengage(None if sample is None else sample.time_s)
            return
        # From the measured pose, not from the last target: a peg that is twisted in its hole does not come out
        top = min(self._hole[2] + self._plan.hover_m, self._plan.limits.workspace[1][2])
        height = max(float(top), float(sample.tcp_position[2]))
        yaw = float(yaw_and_tilt(sample.tcp_rotvec)[0])
        self._path = self._plan_path([np.array([*sample.tcp_position[:2], height])], yaw, sample)
        self._go(Stage.RETRACTING, sample)

    # --- small parts

    def _go(self, stage: Stage, sample: Sample) -> None:
        self._stage, self._stage_seq = stage, sample.seq

    def _plan_path(self, waypoints: list[FloatArray], yaw: float, sample: Sample) -> StraightPath:
        """Lay out a path from where the arm is measured."""
        period_s, speed_m_s = PATH_TICKS * self._plan.tick_s, self._plan.approach_speed_m_s
        return StraightPath.plan(sample.tcp_position, yaw, waypoints, speed_m_s, period_s, sample.time_s)

    def _advance_path(self, sample: Sample) -> Move:
        return self._scripted(self._path.advance(sample.tcp_position, self._plan.step.bounds.leash_m), self._path.yaw)

    def _scripted(self, position: FloatArray, yaw: float) -> Move:
        """Order a scripted target; the arm refuses one that is far from the last, which may lie at its full leash."""
        if self._sent is not None:
            position, yaw = within_step(position, yaw, *self._sent, self._plan.limits.max_step)
        return self._move(position, yaw)

    def _move(self, position: FloatArray, yaw: float) -> Move:
        self._sent = position, yaw
        return Move(PoseTarget(position, rotvec_from_yaw(yaw)))
