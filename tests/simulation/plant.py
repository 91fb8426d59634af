"""A light plant behind the wire schema: one arm's tip, a block with a square hole, a force/torque sensor. 10 µs a tick.

It has the dynamics that matter to a stop and to a ceiling: the admittance law, a servo that lags, a stiff contact, a
sensor with delay and noise. Its commands and states are those of `sim_backend.zenoh_cell.cell.SimulatedCell`.
"""

import math
import random
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from wire.arrays import RecordArray
from wire.records import STATE, TICK_S, Kind, Program, StopReason, new
from wire.task import Task

START = (0.300, -0.110, 0.110)
TOOL_DOWN = (math.pi, 0.0, 0.0)
SERVO_S = 0.008
JOINT_ERROR_N = (1.0, -1.0, 1.5)
"""Error of the force that the joints feel: the gears' friction."""
STOP_S = 0.1
PROTECTIVE_N = 150.0
HOLE_DEPTH_M = 0.024
NOISE = np.random.default_rng(15).normal(size=(4096, 6)) * ([0.15] * 3 + [0.01] * 3)
JOINTS = (-0.2, -1.9, -1.7, -1.1, 1.57, 0.0)
SLOPES = np.random.default_rng(16).normal(size=(6, 3)).tolist()
_FIELDS: Any = STATE.fields
FIRST, END = _FIELDS["time_s"][1], _FIELDS["command_seq"][1]
"""Bytes of a state between which every field is a double; they are written at once."""
PLACES = {name: (offset - FIRST) // 8 for name, (_, offset) in _FIELDS.items() if FIRST <= offset < END}


@dataclass
class Surroundings:
    """The true surroundings of one episode, drawn from the universe's seed.

    Attributes:
        hole: centre of the mouth, base frame, m.
        half_m: half the width of the hole less that of the peg: the clearance.
        block_m: half the width of the block; beyond it there is nothing down to the table.
        camera_m: the camera's estimate less the truth.
        stiffness: of the contact, N/m.
        delay_ticks: of the sensor.
    """

    hole: tuple[float, float, float] = (0.300, -0.110, 0.080)
    half_m: float = 2e-3
    block_m: float = 0.05
    camera_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    stiffness: float = 3e4
    delay_ticks: int = 2


class Lie:
    """A sensor that lies: makes of the true wrench what the sensor says."""

    name = "honest"

    def __call__(self, wrench: list[float], tick: int) -> list[float]:
        return wrench


@dataclass
class LightCell:
    """Stands in for `SimulatedCell`. Rotations are left out: the tool points down."""

    epoch: int
    surroundings: Surroundings
    chance: random.Random
    lie: Lie = field(default_factory=Lie)
    part: str = "tr"

    def __post_init__(self) -> None:
        self.seq = 0
        self.ticks = 0
        self.episode = 0
        self.truth_force_n = 0.0
        self.client = self.command_seq = 0
        self._record = new(STATE, Kind.STATE)
        self._doubles = self._record.view(np.uint8)[FIRST:END].view(np.float64)
        self._numbers = [0.0] * len(self._doubles)
        for name in ("tcp_rotvec", "target_rotvec"):
            self._numbers[PLACES[name] : PLACES[name] + 3] = TOOL_DOWN
        self._noise = self.chance.randrange(4096)
        self._place()

    def _place(self) -> None:
        self.position = list(START)
        self.velocity = [0.0, 0.0, 0.0]
        self.reference = list(START)
        self.speed = [0.0, 0.0, 0.0]
        self.target = list(START)
        self.program = Program.IDLE
        self.stop_reason = StopReason.NONE
        self.halted = 0
        self.blind = False
        self.age = 0
        self.max_age = 1 << 40
        self.ceiling = math.inf
        self.peak = 0.0
        self.zero = [0.0] * 6
        self.history = [[0.0] * 6] * 8
        self.said = [0.0] * 6
        self.felt = [0.0] * 3
        self.wrench = [0.0] * 6
        self.law = (1.0, 1.0, 1.0)
        self.max_speed = 1.0

    # --- commands

    def reset(self, task: Task) -> RecordArray:
        task.check()
        self._place()
        self.episode += 1
        self.client = self.command_seq = 0
        return self.state()

    def apply(self, command: RecordArray) -> None:
        kind, client = int(command["kind"]), int(command["client"])
        if kind in (Kind.STOP, Kind.STOP_BLIND):
            self.blind |= kind == Kind.STOP_BLIND
            self.stop(StopReason.COMMAND)
        elif int(command["epoch"]) != self.epoch:
            return
        elif kind == Kind.ENGAGE:
            self._engage(command, client)
        elif kind == Kind.TARGET:
            self._set_target(command, client)
        elif kind == Kind.ZERO_FT and self.program == Program.IDLE:
            self.zero = [a + b for a, b in zip(self.zero, self.wrench, strict=True)]
        elif kind == Kind.UNLOCK and self.program == Program.PROTECTIVE_STOP and self.halted * TICK_S >= 5.0:
            self.program = Program.IDLE

    def stop(self, reason: StopReason) -> None:
        if self.program == Program.ENGAGED:
            self.program, self.stop_reason, self.halted = Program.STOPPING, reason, 0
            self.target = list(self.position)

    def _engage(self, command: RecordArray, client: int) -> None:
        if self.program == Program.ENGAGED and client != self.client:
            self.stop(StopReason.LEASE)
        if self.program != Program.IDLE:
            return
        self.law = tuple(float(command[name][2]) for name in ("stiffness", "damping", "inertia"))
        self.max_speed = float(command["max_speed"][0])
        self.max_step = float(command["max_step"][0])
        self.workspace = command["workspace"].tolist()
        self.ceiling = float(command["force_ceiling"])
        self.max_age = round(float(command["target_age"]) / TICK_S)
        self.client, self.command_seq = client, int(command["seq"])
        self.age, self.peak, self.blind = 0, 0.0, False
        self.target = list(self.reference)
        self.program, self.stop_reason = Program.ENGAGED, StopReason.NONE

    def _set_target(self, command: RecordArray, client: int) -> None:
        seq = int(command["seq"])
        if client != self.client or seq <= self.command_seq or self.program != Program.ENGAGED:
            return
        target = command["position"].tolist()
        lower, upper = self.workspace
        inside = all(low <= x <= high for low, x, high in zip(lower, target, upper, strict=True))
        if not inside or math.dist(target, self.target) > self.max_step:
            self.stop(StopReason.TARGET_REJECTED)
            return
        self.target, self.age, self.command_seq = target, 0, seq

    # --- time

    def tick(self, ticks: int = 1) -> RecordArray:
        self.pass_tick(ticks)
        return self.state()

    def pass_tick(self, ticks: int = 1) -> None:
        """Let a tick pass of which nothing is told."""
        self.seq += 1
        self.ticks += ticks
        self.age += 1
        self.halted += 1
        force = self._contact()
        self._sense(force)
        self._control()
        for i in range(3):
            before = self.position[i]
            self.position[i] = before + (self.reference[i] - before) * (TICK_S / SERVO_S)
            self.velocity[i] = (self.position[i] - before) / TICK_S

    def _contact(self) -> list[float]:
        """Return the true force on the tip, N."""
        s, (x, y, z) = self.surroundings, self.position
        dx, dy, depth = x - s.hole[0], y - s.hole[1], s.hole[2] - z
        fx = fy = fz = 0.0
        if depth > 0.0 and abs(dx) < s.block_m and abs(dy) < s.block_m:
            if self.in_hole:
                fx = -s.stiffness * (dx - math.copysign(s.half_m, dx)) if abs(dx) > s.half_m else 0.0
                fy = -s.stiffness * (dy - math.copysign(s.half_m, dy)) if abs(dy) > s.half_m else 0.0
                fz = s.stiffness * (depth - HOLE_DEPTH_M) if depth > HOLE_DEPTH_M else 0.0
            else:
                fz = s.stiffness * depth - 40.0 * self.velocity[2]
                fz = max(fz, 0.0)
        if z < s.hole[2] - 0.03:  # the table
            fz += s.stiffness * (s.hole[2] - 0.03 - z)
        self.truth_force_n = math.sqrt(fx * fx + fy * fy + fz * fz)
        return [fx, fy, fz]

    @property
    def in_hole(self) -> bool:
        """True if the peg's axis is inside the hole's outline; a tip that has sunk in stays inside its walls."""
        s, (x, y, z) = self.surroundings, self.position
        reach = s.half_m + (1e-3 if z < s.hole[2] - 1e-3 else 0.0)
        return abs(x - s.hole[0]) <= reach and abs(y - s.hole[1]) <= reach

    @property
    def depth(self) -> float:
        """True depth of the tip below the mouth, where it is in the hole; else negative."""
        return self.surroundings.hole[2] - self.position[2] if self.in_hole else -1.0

    def _sense(self, force: list[float]) -> None:
        noise = NOISE[(self._noise + self.seq) & 4095].tolist()
        history = self.history
        history[self.seq & 7] = force
        fx, fy, fz = history[(self.seq - self.surroundings.delay_ticks) & 7][:3]
        true = [fx, fy, fz, -0.02 * fy, 0.02 * fx, 0.0]
        said = self.lie([a + b for a, b in zip(true, noise, strict=True)], self.seq)
        self.said = said
        self.felt = [force[i] + JOINT_ERROR_N[i] + 3.0 * noise[i] for i in range(3)]
        self.wrench = [a - b for a, b in zip(said, self.zero, strict=True)]

    def _control(self) -> None:
        fx, fy, fz = self.wrench[:3]
        resultant = math.sqrt(fx * fx + fy * fy + fz * fz)
        self.peak = max(self.peak, resultant)
        if not resultant < self.ceiling:
            self.stop(StopReason.FORCE_CEILING)
        if self.age > self.max_age:
            self.stop(StopReason.TARGET_AGE)
        if self.truth_force_n >= PROTECTIVE_N and self.program != Program.PROTECTIVE_STOP:
            self.program, self.stop_reason, self.halted = Program.PROTECTIVE_STOP, StopReason.PROTECTIVE_FORCE, 0
        if self.program in (Program.IDLE, Program.PROTECTIVE_STOP):
            self.speed = [0.0, 0.0, 0.0]
            return
        limit = self.max_speed
        if self.program == Program.STOPPING:
            left = max(1.0 - self.halted * TICK_S / STOP_S, 0.0)
            limit *= left
            if left == 0.0:
                self.program, self.speed = Program.IDLE, [0.0, 0.0, 0.0]
                return
        stiffness, damping, inertia = self.law
        below = inertia + TICK_S * (damping + TICK_S * stiffness)
        push = (fx, fy, fz) if math.isfinite(resultant) and not self.blind else (0.0, 0.0, 0.0)
        speed = [
            (inertia * self.speed[i] + TICK_S * (stiffness * (self.target[i] - self.reference[i]) + push[i])) / below
            for i in range(3)
        ]
        norm = math.sqrt(sum(v * v for v in speed))
        if norm > limit:
            speed = [v * limit / norm for v in speed]
        self.speed = speed
        for i in range(3):
            self.reference[i] += TICK_S * speed[i]

    # --- what is told

    def state(self) -> RecordArray:
        record, s, numbers = self._record, self.surroundings, self._numbers
        row = record[0]
        row["epoch"], row["episode"], row["seq"] = self.epoch, self.episode, self.seq
        row["command_seq"], row["client"] = self.command_seq, self.client
        row["program"], row["stop_reason"] = self.program, self.stop_reason
        row["robot_mode"], row["safety_mode"] = 7, 3 if self.program is Program.PROTECTIVE_STOP else 1
        row["unzeroed"], row["joint_force"] = self.said, self.felt
        x, y, z = (now - then for now, then in zip(self.position, START, strict=True))
        u, v, w = self.velocity
        told = {
            "time_s": (self.ticks * TICK_S,),
            "q": [joint + a * x + b * y + c * z for joint, (a, b, c) in zip(JOINTS, SLOPES, strict=True)],
            "qd": [a * u + b * v + c * w for a, b, c in SLOPES],
            "tcp_position": self.position,
            "tcp_velocity": self.velocity,
            "target_position": self.target,
            "wrench": self.wrench,
            "ft_raw": self.said,
            "hole_estimate": [a + b for a, b in zip(s.hole, s.camera_m, strict=True)],
            "peak_force": (self.peak,),
        }
        for name, values in told.items():
            at = PLACES[name]
            numbers[at : at + len(values)] = values
        self._doubles[:] = numbers
        return record

    def truth(self) -> dict[str, Any]:
        return {"depth": self.depth, "force": self.truth_force_n, "contained": self.in_hole}
