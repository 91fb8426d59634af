"""One simulated arm with its tool, seen by its controller: the joints it drives and the values it can measure."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from sim_backend.ur_controller.geometry import (
    Rotation,
    Vector,
    cross,
    flange_of,
    jacobian_of,
    multiply,
    rotate,
    rotation_of,
    rotvec_of,
    transpose,
)
from sim_backend.world import kinematics, scene
from sim_backend.world.arm import KINEMATICS_TICKS
from sim_backend.world.joint_sense import JointSense
from sim_backend.world.kinematics import UR3E
from sim_backend.world.servo import JointServo, gains
from sim_backend.world.world import World
from wire.arrays import FloatArray
from wire.records import TICK_S
from wire.task import Part, Task

_ONLY = np.array([0])


class Plant:
    """The arm of a world of one cell.

    Measured values belong to the last tick; arrays are replaced, never changed in place. Poses are `[x, y, z, rx, ry,
    rz]`, m and rad, base frame.

    Two methods move the arm elsewhere at once and leave it at rest: `lay_out` begins an episode anew, `place` moves the
    arm alone. Both notify the arm's driver through `on_placed`; the driver must then take the measured joints as its
    target. Running programs continue.

    Args:
        world: world of one cell; it is replaced when an episode asks for another peg.

    Attributes:
        world: simulated world.
        q: (6,) measured joint angles, rad.
        qd: (6,) measured joint speeds, rad/s.
        set_points: (6,) last set-points of the joint servos, rad.
        wrench: (6,) wrench of the environment on the tool at the configured TCP, base axes, N and N·m, zeroed and
            without the weight of the configured payload.
        ft_raw: (6,) reading of the sensor at the flange, flange axes; neither zeroed nor compensated.
        saturated: a channel of the sensor is at the end of its range.
        tcp_offset: pose of the configured TCP in the flange's frame; initially the scene's.
        payload_kg: configured payload; initially the scene's, like the next two.
        payload_cog: (3,) centre of the payload in the flange's frame, m.
        payload_inertia: (6,) Ixx Iyy Izz Ixy Ixz Iyz, kg·m²; reported, but without effect.
        external_wrench: (6,) wrench of an external sensor about the flange, flange axes, zeroed by its owner; if set,
            `wrench` is derived from it.
        input_delay: ticks from a command's arrival to its effect in this episode, without jitter.
        on_placed: functions called after the arm was moved elsewhere.
    """

    def __init__(self, world: World) -> None:
        if world.n != 1:
            raise ValueError(f"a plant is one arm, this world holds {world.n}; make it with World(1, part)")
        self.world = world
        self.on_placed: list[Callable[[], None]] = []
        self.tcp_offset: tuple[float, ...] = (0.0, 0.0, scene.TCP_OFFSET_M, 0.0, 0.0, 0.0)
        self.payload_kg = scene.PAYLOAD_KG
        self.payload_cog: tuple[float, ...] = (0.0, 0.0, scene.PAYLOAD_COM_M)
        self.payload_inertia: tuple[float, ...] = (0.0,) * 6
        self.external_wrench: Sequence[float] | None = None
        self._tool_rotation = rotation_of(0.0, 0.0, 0.0)
        self._joint_sense = JointSense()
        self._servo = JointServo(1, *gains(world.model()), self.payload_kg, self.payload_cog)
        self._task = Task(0, world.part)
        self._settle()

    def drive(self, q_target: FloatArray, qd_target: FloatArray) -> None:
        """Simulate one tick of 2 ms.

        Args:
            q_target: (6,) joint targets at the end of the tick, rad.
            qd_target: (6,) joint speeds on the way, rad/s.
        """
        if self._phase == 0:
            self._servo.refresh(_ONLY, q_target[None])
        self._phase = (self._phase + 1) % KINEMATICS_TICKS
        self._before, self._twist_before = (self.q, self.qd), self._twist
        set_points = self._servo.set_points(q_target, qd_target)
        self.set_points = set_points[0]
        self.world.drive(set_points)
        self._measure()
        self._joint_sense.read(self.world, self.payload_kg, self.payload_cog, self.tcp_offset[:3])

    def lay_out(self, task: Task) -> None:
        """Begin an episode: another hole, another plant, the arm at rest at the start pose.

        The configured TCP and payload stay. The sensor's zero is lost because the bias changes.

        Raises:
            ValueError: a value of the task is out of range.
        """
        task.check()
        if not self.world.holds(task):
            self.world = World(1, task.part, plant=task.plant)
        nominal = scene.PAYLOAD_KG, (0.0, 0.0, scene.PAYLOAD_COM_M), self.tcp_offset[:3]
        self.world.sensor.configure(*nominal, self.world.rotation)  # load that a reset assumes to be carried
        self.world.reset(_ONLY, [task])
        self._task = task
        self._joint_sense.begin(task.seed)
        self._configure()
        self._placed()

    def place(self, position: Sequence[float], yaw: float = 0.0) -> None:
        """Put the arm at rest with the scene's TCP at `position` (3,), m, tool down, turned by `yaw`, rad.

        Raises:
            KinematicsError: the pose is out of reach.
        """
        self.world.place(_ONLY, np.array([position], np.float64), np.array([yaw]))
        self._placed()

    def set_tcp(self, offset: Sequence[float]) -> None:
        """Configure the TCP: its pose in the flange's frame."""
        self._tool_rotation = rotation_of(*offset[3:])
        self.tcp_offset = tuple(map(float, offset))
        self._configure()
        self._pose = self._twist = self._twist_before = None

    def set_payload(self, kg: float, cog: Sequence[float], inertia: Sequence[float] | None = None) -> None:
        """Configure the payload: mass kg, centre (3,) m in the flange's frame, inertia (6,) kg·m²; None keeps the
        inertia. The sensor's zero stays.
        """
        self.payload_kg, self.payload_cog = float(kg), tuple(map(float, cog))
        if inertia is not None:
            self.payload_inertia = tuple(map(float, inertia))
        self._configure()

    def next_delay(self) -> int:
        """Return the ticks from the next command's arrival to its effect: `input_delay` with its jitter."""
        return int(self.world.arm.delays.next(_ONLY)[0])

    def zero_ft(self) -> None:
        """Take the sensor's latest readings as its zero; meaningless in contact and in motion."""
        self.world.zero_ft(_ONLY)

    def flange(self) -> tuple[Vector, Rotation]:
        """Return measured position (m) and rotation of the flange."""
        if self._flange is None:
            self._flange = flange_of(self.q.tolist())
        return self._flange

    def tcp_pose(self) -> list[float]:
        """Return the measured pose of the configured TCP."""
        if self._pose is None:
            self._pose = self._tcp(*self.flange())
        return self._pose.copy()

    def tcp_speed(self) -> list[float]:
        """Return the measured twist of the configured TCP, base axes, m/s and rad/s."""
        if self._twist is None:
            speed: list[float] = (jacobian_of(self.q.tolist(), self.tcp_pose()[:3]) @ self.qd).tolist()
            self._twist = speed
        return self._twist.copy()

    def tcp_acceleration(self) -> list[float]:
        """Return the change of `tcp_speed` over the last tick, m/s² and rad/s²."""
        if self._twist_before is None:
            q, qd = self._before
            self._twist_before = (self.jacobian_of(q.tolist()) @ qd).tolist()
        return [(now - before) / TICK_S for now, before in zip(self.tcp_speed(), self._twist_before, strict=True)]

    def tool_acceleration(self) -> list[float]:
        """Return the reading of an accelerometer at the TCP (3,), flange axes, m/s²; at rest the reaction to
        gravity.
        """
        x, y, z, *_ = self.tcp_acceleration()
        return list(rotate(transpose(self.flange()[1]), (x, y, z + kinematics.GRAVITY_M_S2)))

    def flange_wrench(self) -> list[float]:
        """Return `wrench` with the torque about the flange's origin instead of the TCP."""
        force, moment = self.wrench[:3].tolist(), self.wrench[3:].tolist()
        lever = rotate(self.flange()[1], self.tcp_offset[:3])
        turned = cross(lever, force)
        return [*force, moment[0] + turned[0], moment[1] + turned[1], moment[2] + turned[2]]

    def joint_torques(self) -> FloatArray:
        """Return the torque of the joint servos (6,), N·m, without the weight of the links."""
        return self.world.joint_torques[0].copy()

    def felt_wrench(self) -> list[float]:
        """Return the wrench about the flange, base axes, of the force at the TCP that the joints' drives feel."""
        force: list[float] = self._joint_sense.force.tolist()
        return [*force, *cross(rotate(self.flange()[1], self.tcp_offset[:3]), force)]

    def elbow(self) -> tuple[list[float], list[float]]:
        """Return position (3,), m, and velocity (3,), m/s, of the elbow, the end of the upper arm."""
        q1, q2 = self.q[:2].tolist()
        rate1, rate2 = self.qd[:2].tolist()
        length = UR3E[1].a_m
        reach, height = length * math.cos(q2), length * math.sin(q2)
        c1, s1 = math.cos(q1), math.sin(q1)
        position = [c1 * reach, s1 * reach, UR3E[0].d_m + height]
        velocity = [
            -s1 * reach * rate1 - c1 * height * rate2,
            c1 * reach * rate1 - s1 * height * rate2,
            reach * rate2,
        ]
        return position, velocity

    def momentum(self) -> float:
        """Return the norm of the arm's linear momentum, tool included, kg·m/s."""
        return math.hypot(*self.world.momentum())

    def flange_pose_of(self, q: Sequence[float]) -> list[float]:
        """Return the pose of the flange at joint angles (6,)."""
        position, rotation = flange_of(q)
        return [*position, *rotvec_of(rotation)]

    def tcp_pose_of(self, q: Sequence[float]) -> list[float]:
        """Return the pose of the configured TCP at joint angles (6,)."""
        return self._tcp(*flange_of(q))

    def jacobian_of(self, q: Sequence[float]) -> FloatArray:
        """Return the geometric Jacobian (6, 6) of the configured TCP at joint angles (6,), base axes, linear rows
        first.
        """
        position, rotation = flange_of(q)
        x, y, z = rotate(rotation, self.tcp_offset[:3])
        return jacobian_of(q, (position[0] + x, position[1] + y, position[2] + z))

    @property
    def estimate(self) -> FloatArray:
        """(3,) camera's estimate of the hole's mouth, m."""
        return self.world.estimate[0]

    @property
    def true_force(self) -> float:
        """Resultant of the true load on the gripper and the peg, N, gravity and inertia included."""
        return float(self.world.true_force[0])

    def truth(self) -> dict[str, Any]:
        """Return facts that only the simulation knows; for evaluation and tests, never for a controller."""
        return {"task": self._task.to_json(), **self.world.truth()}

    @property
    def part(self) -> Part:
        """Peg and hole of the present world."""
        return self.world.part

    def _tcp(self, position: Vector, rotation: Rotation) -> list[float]:
        x, y, z = rotate(rotation, self.tcp_offset[:3])
        turn = rotvec_of(multiply(rotation, self._tool_rotation))
        return [position[0] + x, position[1] + y, position[2] + z, *turn]

    def _configure(self) -> None:
        self._servo.set_payload(self.payload_kg, self.payload_cog)
        self.world.sensor.configure(self.payload_kg, self.payload_cog, self.tcp_offset[:3], self.world.rotation)
        self._phase = 0

    def _placed(self) -> None:
        self._settle()
        for heard in self.on_placed:
            heard()

    def _settle(self) -> None:
        self._phase = 0
        self.input_delay = int(self.world.target_delay[0])
        self.set_points = self.world.joints[0]
        self._measure()
        self._before, self._twist_before = (self.q, self.qd), self._twist

    def _measure(self) -> None:
        world = self.world
        self.q, self.qd = world.joints[0], world.joint_speeds[0].copy()
        self.wrench, self.ft_raw = world.sensor.wrench[0].copy(), world.sensor.raw[0]
        self.saturated = bool(world.sensor.saturated[0])
        self._flange: tuple[Vector, Rotation] | None = None
        self._pose: list[float] | None = None
        self._twist: list[float] | None = None
        if self.external_wrench is not None:
            rotation, force = self.flange()[1], self.external_wrench[:3]
            turned = cross(self.tcp_offset[:3], force)
            moment = [a - b for a, b in zip(self.external_wrench[3:], turned, strict=True)]
            self.wrench = np.array((*rotate(rotation, force), *rotate(rotation, moment)))
