"""n simulated cells stepped together: the plant, its sensor and its arm controller, one tick of 2 ms at a time.

One class serves one cell over Zenoh and hundreds in training: there is no other simulation.
"""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch

from sim_backend.world import compiled, engine, kinematics, scene
from sim_backend.world.arm import ArmController
from sim_backend.world.conditions import CAMERA_FRAMES, Episode, draw
from sim_backend.world.gears import RIPPLE_WAVES, Gears
from sim_backend.world.layout import Layout
from sim_backend.world.linear import product
from sim_backend.world.parts import HOLE_DEPTH_M
from sim_backend.world.peg import shape_of
from sim_backend.world.sensor import ForceTorqueSensor
from sim_backend.world.servo import gains
from sim_backend.world.telling import Telling
from sim_backend.world.together import Together
from wire import extension, pose
from wire.arrays import BoolArray, CellIndices, FloatArray
from wire.law import ControlLimits
from wire.plant import PlantErrors
from wire.records import StopReason
from wire.task import Part, Task

START_POSITION_M = (scene.NOMINAL_HOLE_M[0], scene.NOMINAL_HOLE_M[1], 0.180)
"""TCP position at the start of an episode, tool down."""
START_YAW_RAD = 0.0
ESTIMATE_TICKS = 20
"""Ticks per camera frame."""
FLOOR_GIVE_M = 1e-3
"""Reading below the floor's level that a peg standing on the floor may have, m."""
_NEAR_JOINTS = np.array([-0.2, -1.9, -1.7, -1.1, 1.57, 0.0])
"""Joint angles with the elbow up, over the table: the arm's branch of the inverse kinematics."""


class World:
    """n simulated cells.

    Args:
        n: number of cells.
        part: peg and hole of all cells; clearance, pose and plant differ from cell to cell.
        threads: number of threads that step the physics; 0 for one per core.
        plant: errors of the plants; the shape of the peg is that of all cells, the others vary with the tasks.

    Attributes:
        sensor: force/torque sensor; `sensor.wrench` (n, 6) is the compensated reading.
        arm: the arm controllers.
        telling: what the cells tell of themselves.
        ticks: (n,) ticks since each cell's reset.
    """

    def __init__(self, n: int = 1, part: Part = "tr", threads: int = 1, plant: PlantErrors | None = None) -> None:
        self.n = n
        self.part: Part = part
        self._shape = shape_of(plant)
        self._scene = scene.build(part, shape=self._shape)
        model = self._scene.model
        self._batch = Batch(model, nsim=n, nthread=threads)
        batch = self._batch
        self._qpos, self._qvel, self._ctrl = batch.bind("qpos"), batch.bind("qvel"), batch.bind("ctrl")
        self._layout = Layout(batch, self._scene)
        self._gears = Gears(n)
        self._block_position = self._layout.block_position
        self._servo_torques, self._constraint_torques = batch.bind("actuator_force"), batch.bind("qfrc_constraint")
        self._passive_torques, self._bias_torques = batch.bind("qfrc_passive"), batch.bind("qfrc_bias")
        self._warmstart = batch.bind("qacc_warmstart")
        self._load = batch.bind("sensordata")
        site = model.site("tcp").id
        self._tcp_position = batch.bind("site_xpos")[:, site]
        self._tcp_rotation = batch.bind("site_xmat").reshape(n, -1, 3, 3)[:, site]
        self._orientation = batch.bind("xquat")[:, self._scene.gripper_body]
        self._peg_position = batch.bind("xpos")[:, self._scene.peg_body]
        base = model.body("base").id
        self._moving = slice(base, self._scene.peg_body + 1)
        self._centre = batch.bind("subtree_com")[:, base]
        self._body_centre, self._body_twist = batch.bind("xipos"), batch.bind("cvel")
        self.sensor = ForceTorqueSensor(
            n, scene.PAYLOAD_KG, (0.0, 0.0, scene.PAYLOAD_COM_M), (0.0, 0.0, scene.TCP_OFFSET_M)
        )
        self.arm = ArmController(n, scene.TCP_OFFSET_M, (scene.PAYLOAD_KG, scene.PAYLOAD_COM_M), *gains(model))
        self._episodes: list[Episode] = [draw(Task(0, part))] * n
        self._all = np.arange(n)
        self.clearance = np.full(n, 2e-3)
        self._joints, self._carried = np.zeros((n, 6)), np.zeros((n, 6))
        self._position, self._rotation = np.zeros((n, 3)), np.zeros((n, 3, 3))
        self._estimate = np.zeros((n, 3))
        self._offset = np.zeros((n, 3))
        self._jitter = np.zeros((n, CAMERA_FRAMES, 3))
        self.ticks = np.zeros(n, np.int64)
        self._stiffness_scale = np.ones(n)
        self._compiled = compiled.tick
        self._together: Together | None = None
        if self._compiled is not None:
            frames = {"estimate_ticks": ESTIMATE_TICKS, "ripple_waves": RIPPLE_WAVES}
            gears = {"play": self._gears.play, "gears": self._gears.errors}
            self._arrays = compiled.arrays(self._compiled.CELLS, vars(self) | gears)
            self._constants = extension.constants(self._compiled.CELLS_CONSTANTS, frames)
            bodies, mine = (site, self._scene.gripper_body), (self._arrays, self._constants)
            engine.stop_timers()
            self._together = Together(self._compiled, batch, bodies, self.arm.bound, mine)
        self.telling = Telling(
            {
                "joints": self._joints,
                "qvel": self._qvel,
                "position": self._position,
                "rotation": self._rotation,
                "estimate": self._estimate,
                "jacobian": self.arm.jacobian,
                "target_position": self.arm.target_position,
                "target_quaternion": self.arm.target_quaternion,
                "peak_force": self.arm.peak_force,
                "wrench": self.sensor.latest,
                "raw": self.sensor.latest_raw,
            }
        )
        self.reset(self._all, [Task(i, part, plant=plant) for i in range(n)])

    def reset(self, cells: CellIndices, tasks: Sequence[Task]) -> None:
        """Lay out cells anew: another hole, another plant, the arm at rest at the start pose.

        Args:
            cells: (k,) indices.
            tasks: k tasks; their part must be this world's.

        Raises:
            ValueError: a task names another part, or another shape of its peg.
        """
        self.lay_out(cells, tasks)
        k = len(cells)
        self.place(cells, np.tile(START_POSITION_M, (k, 1)), np.full(k, START_YAW_RAD))

    def lay_out(self, cells: CellIndices, tasks: Sequence[Task]) -> None:
        """Do all of `reset` but to place the arms, for a caller who places them elsewhere.

        Raises:
            ValueError: a task names another part, or another shape of its peg.
        """
        for task in tasks:
            if not self.holds(task):
                held, asked = (self.part, self._shape), (task.part, shape_of(task.plant))
                raise ValueError(f"this world holds part {held}, the task asks for {asked}; start another world")
        episodes = [draw(task) for task in tasks]
        self.clearance[cells] = [task.clearance_m for task in tasks]
        self._layout.write(cells, self.clearance[cells], episodes)
        self._gears.write(cells, [episode.errors for episode in episodes])
        self._stiffness_scale[cells] = [episode.stiffness_scale for episode in episodes]
        for cell, episode in zip(cells, episodes, strict=True):
            self._episodes[cell] = episode
            self._offset[cell] = episode.hole_position + episode.estimate_offset
            self._jitter[cell] = episode.estimate_noise
            self.sensor.reset(int(cell), episode)
        self.ticks[cells] = 0
        self._estimate[cells] = self.camera(cells)

    def holds(self, task: Task) -> bool:
        """Tell whether a task's peg is the one of this world."""
        return task.part == self.part and shape_of(task.plant) == self._shape

    def place(self, cells: CellIndices, position: FloatArray, yaw: FloatArray) -> None:
        """Put arms at rest with the TCP at `position` (k, 3), tool down, yaw (k,); their programs are idle afterwards.

        Raises:
            KinematicsError: the pose is out of reach.
        """
        rotation = pose.tool_down(yaw)
        flange = position - rotation @ np.array([0.0, 0.0, scene.TCP_OFFSET_M])
        joints = kinematics.inverse(flange, rotation, np.broadcast_to(_NEAR_JOINTS, (len(cells), 6)))
        self.arm.place(cells, joints, np.array([self._episodes[c].target_delays for c in cells], np.int64))
        self._qpos[cells] = np.column_stack([joints, np.zeros(len(cells))])
        self._qvel[cells] = 0.0
        self._warmstart[cells] = 0.0
        self._ctrl[cells] = self._gears.play[cells] = joints
        self._batch.forward(None if len(cells) == self.n else cells.astype(np.int32))
        self._measure(cells)

    def move_hole(self, cells: CellIndices, position: FloatArray, yaw: FloatArray) -> None:
        """Move the holes of `cells` as a slipping block does; the camera does not notice.

        Args:
            cells: (k,) indices.
            position: (k, 3) centre of the mouth, m.
            yaw: (k,) yaw, rad.
        """
        self._layout.move_hole(cells, position, yaw)

    def zero_ft(self, cells: CellIndices) -> None:
        """Zero the sensors of `cells`; meaningless in contact. Callers refuse it while engaged."""
        self.sensor.zero(cells)

    def engage(
        self, cells: CellIndices, stiffness: FloatArray, damping: FloatArray, inertia: FloatArray, limits: ControlLimits
    ) -> BoolArray:
        """Start the control programs; the plant's stiffness error applies. Return the mask (k,) of engaged cells."""
        scaled = np.broadcast_to(stiffness, (len(cells), 6)) * self._stiffness_scale[cells, None]
        return self.arm.engage(cells, scaled, damping, inertia, limits)

    def stop(self, cells: CellIndices, *, blind: bool = False) -> None:
        """Stop arms as a client's command does; `blind`: without yielding to the sensor."""
        self.arm.stop(cells, StopReason.COMMAND, blind=blind)

    def tick(self) -> None:
        """Advance every cell by one tick of 2 ms, driven by its arm controller."""
        sensor = self.sensor
        self.arm.update(self._joints, sensor.latest, self._position, self._orientation, sensor.saturated, self._ctrl)
        self._step()

    def advance(self, readings: FloatArray) -> None:
        """Advance every cell by as many ticks as `readings` (ticks, n, 6) has rows, each as by `tick`.

        A row takes the sensors' compensated readings after its tick. The ticks are one call of MuJoCo if there is no
        `engine.obstacle`.
        """
        if self._together is None or not len(readings) or engine.obstacle():
            for row in readings:
                self.tick()
                row[:] = self.sensor.latest
            return
        self._together.advance(self.sensor, readings)

    def drive(self, set_points: FloatArray) -> None:
        """Advance every cell by one tick of 2 ms with `set_points` (n, 6) for the joint servos, rad.

        For controllers other than `arm`, which stands still meanwhile.
        """
        self._ctrl[:] = set_points
        self._step()

    def camera(self, cells: CellIndices) -> FloatArray:
        """Return the camera's present estimate of the hole's mouth, (k, 3)."""
        frame = (self.ticks[cells] // ESTIMATE_TICKS) % CAMERA_FRAMES
        return self._offset[cells] + self._jitter[cells, frame]

    def hover(self, cells: CellIndices) -> FloatArray:
        """Return the height above the estimate, (k,) m, at which the episode's scripted approach ends."""
        return np.array([self._episodes[int(cell)].hover_m for cell in cells])

    def model(self, cell: int = 0) -> mujoco.MjModel:
        """Copy one cell's MuJoCo model, with the walls, grasp, masses and friction of its episode."""
        model = self._batch.get_model(cell)
        model.numeric_data[:] = 0.0  # no call is the copy's
        return model

    def data(self, cell: int = 0) -> mujoco.MjData:
        """Return one cell's MuJoCo data, for rendering and inspection. Its model is `model(cell)`."""
        return self._batch.get_data(cell)

    @property
    def joints(self) -> FloatArray:
        """(n, 6) copy of the measured joint angles, rad."""
        return self._joints.copy()

    @property
    def position(self) -> FloatArray:
        """(n, 3) copy of the measured TCP, base frame; MuJoCo gives that of the previous tick."""
        return self._position.copy()

    @property
    def rotation(self) -> FloatArray:
        """(n, 3, 3) copy of the measured orientation of the TCP, of the previous tick too."""
        return self._rotation.copy()

    @property
    def estimate(self) -> FloatArray:
        """(n, 3) copy of the camera's estimate of the hole's mouth."""
        return self._estimate.copy()

    @property
    def target_delay(self) -> CellIndices:
        """(n,) ticks from a command's arrival to its effect in the present episodes, without jitter."""
        return np.array([episode.target_delay for episode in self._episodes])

    def truth(self, cell: int = 0) -> dict[str, Any]:
        """Return facts about a cell that only the simulation knows, as JSON; for evaluation and tests, never for
        control.
        """
        return {
            "hole_position": self.hole_position[cell].tolist(),
            "hole_yaw": float(self.hole_yaw[cell]),
            "depth": float(self.depth[cell]),
            "offset": self.offset[cell].tolist(),
            "contained": bool(self.contained[cell]),
            "force": float(self.true_force[cell]),
        }

    @property
    def twist(self) -> FloatArray:
        """(n, 6) measured twist of the TCP, base frame, m/s and rad/s."""
        return product(self.arm.jacobian, self._qvel[:, :6])

    @property
    def drives(self) -> compiled.Arrays:
        """Effort of the drives in the last tick, as views: joint angles (n, 6), rad; speeds (n, 7), rad/s; and torques,
        N·m, of the servos (n, 6), of contacts, of the fingers' spring, and of weight and turning (n, 7 each).
        """
        return (
            self._joints,
            self._qvel,
            self._servo_torques,
            self._constraint_torques,
            self._passive_torques,
            self._bias_torques,
        )

    @property
    def joint_torques(self) -> FloatArray:
        """(n, 6) torques of the joint servos in the last tick, N·m; the links' own weight is not in them."""
        return self._servo_torques

    @property
    def inertial_torques(self) -> FloatArray:
        """(n, 6) torques that accelerated the joints in the last tick, N·m."""
        forces = self._constraint_torques[:, :6] + self._passive_torques[:, :6] - self._bias_torques[:, :6]
        return self._servo_torques + forces

    @property
    def joint_speeds(self) -> FloatArray:
        """(n, 6) measured, rad/s."""
        return self._qvel[:, :6]

    @property
    def depth(self) -> FloatArray:
        """(n,) true depth of the peg's bottom below the hole's mouth, along its axis, m; negative above it."""
        return -self._layout.in_hole(self._peg_position)[:, 2]

    @property
    def offset(self) -> FloatArray:
        """(n, 2) true position of the peg's axis in the hole's frame, m."""
        return self._layout.in_hole(self._peg_position)[:, :2]

    @property
    def hole_yaw(self) -> FloatArray:
        """(n,) copy of the true yaw of the hole, rad."""
        return self._layout.hole_yaw.copy()

    @property
    def friction(self) -> FloatArray:
        """(n,) sliding friction of peg on block."""
        return self._layout.friction[:, self._scene.peg_geom, 0]

    @property
    def symmetry_order(self) -> int:
        """Turns by 2π over this leave the peg unchanged; 0 for a round one."""
        return self._scene.part.symmetry_order

    @property
    def hole_position(self) -> FloatArray:
        """(n, 3) true centre of the hole's mouth, m."""
        return self._block_position

    @property
    def contained(self) -> BoolArray:
        """(n,) mask: the peg's axis lies inside the hole's outline, and its bottom is not below the hole's floor."""
        offset, (x, y) = self.offset, self._layout.outward
        along = x * offset[:, :1] + y * offset[:, 1:]
        inside = np.logical_and.reduce(along <= self._layout.wall_distance, axis=1)
        return inside & (self.depth <= HOLE_DEPTH_M + FLOOR_GIVE_M)

    @property
    def true_force(self) -> FloatArray:
        """(n,) resultant of the true load on the flange, N: contact, weight and inertia."""
        return np.sqrt((self._load[:, :3] ** 2).sum(axis=1))

    @property
    def contact_force(self) -> FloatArray:
        """(n, 3) true force of the surroundings on the peg in the last tick, N, base frame: no weight, no inertia.

        Contacts are the only constraints on the arm's own joints, unless a plant's errors give them friction, so their
        generalised forces are those of a wrench.
        """
        jacobian = kinematics.jacobian(self._joints, (0.0, 0.0, scene.TCP_OFFSET_M))
        torques = self._constraint_torques[:, :6, None]
        return np.asarray(np.linalg.solve(jacobian.transpose(0, 2, 1), torques)[:, :3, 0], np.float64)

    def momentum(self, cell: int = 0) -> tuple[float, float, float]:
        """Return the linear momentum of one cell's arm and its load, base frame, kg·m/s."""
        moving = self._moving
        x0, y0, z0 = self._centre[cell].tolist()
        px = py = pz = 0.0
        for mass, (x, y, z), (wx, wy, wz, vx, vy, vz) in zip(  # velocities at the centre of mass of the whole
            self._layout.mass[cell, moving].tolist(),
            self._body_centre[cell, moving].tolist(),
            self._body_twist[cell, moving].tolist(),
            strict=True,
        ):
            px += mass * (vx + wy * (z - z0) - wz * (y - y0))
            py += mass * (vy + wz * (x - x0) - wx * (z - z0))
            pz += mass * (vz + wx * (y - y0) - wy * (x - x0))
        return px, py, pz

    def _step(self) -> None:
        self._gears.transmit(self._ctrl)
        self._batch.step()
        if self._compiled is not None:
            self._compiled.measure(self._arrays, self._constants)
        else:
            self.ticks += 1
            self._measure(self._all)
            np.negative(self._load, out=self._carried)
            self._estimate[:] = self.camera(self._all)
        self.sensor.read(self._carried, self._rotation)

    def _measure(self, cells: CellIndices) -> None:
        self._joints[cells] = self._qpos[cells, :6]
        self._position[cells] = self._tcp_position[cells]
        self._rotation[cells] = self._tcp_rotation[cells]
