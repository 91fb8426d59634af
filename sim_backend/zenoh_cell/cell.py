"""One simulated cell behind the wire schema, used by the Zenoh server and the in-process driver."""

import secrets
from typing import Any

import mujoco
import numpy as np

from sim_backend.world import quaternion, scene
from sim_backend.world.joint_sense import JointSense
from sim_backend.world.world import World
from sim_backend.zenoh_cell.state_record import StateRecord
from wire.arrays import RecordArray
from wire.law import ControlLimits
from wire.records import TICK_S, Kind, Program, StopReason
from wire.task import Part, Task

_ENGAGE_RANGES = {
    "stiffness": (0.0, 1e6),
    "damping": (1e-6, 1e6),
    "inertia": (1e-6, 1e6),
    "max_speed": (0.0, 10.0),
    "max_step": (0.0, 10.0),
    "workspace": (-10.0, 10.0),
    "force_ceiling": (1e-6, 1e4),
    "target_age": (TICK_S, 60.0),
}
"""Values with which the control program can compute, in wire units; far wider than sane. Others make ENGAGE ignored."""

_ONLY = np.array([0])
_CENTRE = (0.0, 0.0, scene.PAYLOAD_COM_M)
_TCP = (0.0, 0.0, scene.TCP_OFFSET_M)


class SimulatedCell:
    """A world of one cell that reads commands and writes states.

    Args:
        part: peg and hole.
        epoch: identity of this world; drawn at random unless given.
    """

    def __init__(self, part: Part = "tr", epoch: int | None = None) -> None:
        self.part: Part = part
        self.epoch = epoch if epoch is not None else secrets.randbits(63)
        self._world = World(1, part)
        self._task = Task(0, part)
        self._joint_sense = JointSense()
        self._record = StateRecord()
        self._episode = 0
        self._seq = 0
        self._ticks = 0
        self._client = 0
        self._command_seq = 0

    @property
    def world(self) -> World:
        """The world behind the wire, for tests of what a client must not see; a task with another peg replaces it."""
        return self._world

    def model(self) -> mujoco.MjModel:
        """Copy the MuJoCo model of the present episode: its clearance, grasp and plant."""
        return self._world.model()

    def data(self) -> mujoco.MjData:
        """Return the present state as MuJoCo data, for rendering; it fits `model()`."""
        return self._world.data()

    def reset(self, task: Task) -> RecordArray:
        """Lay the world out anew and leave the control program idle. Return the state before the first tick.

        Raises:
            ValueError: the task's part is unknown, or a value is out of range.
        """
        task.check()
        if not self._world.holds(task):
            self._world = World(1, task.part, plant=task.plant)
            self.part = task.part
        self._world.reset(_ONLY, [task])
        self._joint_sense.begin(task.seed)
        self._task = task
        self._episode += 1
        self._client = self._command_seq = 0
        return self.state()

    def apply(self, command: RecordArray) -> None:
        """Carry out one `records.COMMAND`. Never raises: a command for another world, or not allowed, is ignored."""
        kind, client = int(command["kind"]), int(command["client"])
        arm = self._world.arm
        if kind in (Kind.STOP, Kind.STOP_BLIND):
            self._world.stop(_ONLY, blind=kind == Kind.STOP_BLIND)
            return
        if int(command["epoch"]) != self.epoch:
            return
        if kind == Kind.ENGAGE:
            self._engage(command, client)
        elif kind == Kind.TARGET:
            seq = int(command["seq"])
            if client != self._client or seq <= self._command_seq:
                return
            with np.errstate(over="ignore", invalid="ignore"):  # the arm refuses values that are not finite
                turn = quaternion.from_rotvec(np.asarray(command["rotvec"], float)[None])
                if arm.set_target(_ONLY, np.asarray(command["position"], float)[None], turn)[0]:
                    self._command_seq = seq
        elif kind == Kind.ZERO_FT and arm.program[0] == Program.IDLE:
            self._world.zero_ft(_ONLY)
        elif kind == Kind.UNLOCK:
            arm.unlock(_ONLY)

    def tick(self, ticks: int = 1) -> RecordArray:
        """Let time pass; return the new state, (1,) of `records.STATE`.

        Args:
            ticks: ticks that pass. The world is computed for the last of them alone: more than one are for an arm at
                rest that nothing drives.
        """
        self._world.tick()
        self._ticks += ticks
        self._joint_sense.read(self._world, scene.PAYLOAD_KG, _CENTRE, _TCP)
        self._seq += 1
        return self.state()

    def state(self) -> RecordArray:
        """Return the present state, (1,) of `records.STATE`."""
        own = {
            "epoch": self.epoch,
            "episode": self._episode,
            "seq": self._seq,
            "time_s": self._ticks * TICK_S,
            "command_seq": self._command_seq,
            "client": self._client,
        }
        return self._record.write(self._world, self._joint_sense, own)

    def truth(self) -> dict[str, Any]:
        """Return facts that only the simulation knows; for evaluation and tests, never for the control process."""
        return {"task": self._task.to_json(), **self._world.truth()}

    def _engage(self, command: RecordArray, client: int) -> None:
        for name, (low, high) in _ENGAGE_RANGES.items():
            if not ((command[name] >= low) & (command[name] <= high)).all():  # NaN is in no range
                return
        stiffness, damping, inertia = (np.asarray(command[name], float) for name in ("stiffness", "damping", "inertia"))
        scalars = float(command["force_ceiling"]), float(command["target_age"])
        arm = self._world.arm
        if arm.program[0] == Program.ENGAGED and client != self._client:
            arm.stop(_ONLY, StopReason.LEASE)
            return
        lower, upper = (tuple(float(x) for x in corner) for corner in command["workspace"])
        limits = ControlLimits(
            max_speed=(float(command["max_speed"][0]), float(command["max_speed"][1])),
            max_step=(float(command["max_step"][0]), float(command["max_step"][1])),
            workspace=((lower[0], lower[1], lower[2]), (upper[0], upper[1], upper[2])),
            force_ceiling_n=scalars[0],
            target_age_s=scalars[1],
        )
        if self._world.engage(_ONLY, stiffness, damping, inertia, limits)[0]:
            self._client, self._command_seq = client, int(command["seq"])
