"""The parts of MuJoCo's models that an episode changes: the hole and its walls, grasp, masses and contact."""

from collections.abc import Sequence

import numpy as np
from mujoco.batch import Batch

from sim_backend.world import quaternion, scene
from sim_backend.world.conditions import Episode
from sim_backend.world.linear import product
from sim_backend.world.model_errors import ModelErrors
from sim_backend.world.parts import hole_walls, wall_centres
from wire import pose
from wire.arrays import CellIndices, FloatArray


class Layout:
    """The parts of n simulations that differ from episode to episode.

    Args:
        batch: the simulations.
        scene: their scene.

    Attributes:
        block_position: (n, 3) view of the centre of the hole's mouth, m.
        hole_yaw: (n,) yaw of the hole, rad.
        outward: cosine and sine of the angles of the walls' outward normals, (w,) each, hole frame.
        wall_distance: (n, w) distance of the walls' faces from the hole's centre, m.
        friction: (n, geoms, 3) view of the coefficients of friction.
        mass: (n, bodies) view, kg.
    """

    def __init__(self, batch: Batch, scene: scene.Scene) -> None:
        self._scene = scene
        self._carried = [scene.gripper_body, scene.peg_body]
        self.block_position: FloatArray = batch.bind("mocap_pos")[:, 0]
        self.hole_yaw = np.zeros(batch.nsim)
        self._turn = np.ones(batch.nsim), np.zeros(batch.nsim)
        self._tilt = np.zeros((batch.nsim, 3))
        self._untilt = np.tile(np.eye(3), (batch.nsim, 1, 1))
        walls = hole_walls(scene.part, np.zeros(batch.nsim))
        self.outward: tuple[FloatArray, FloatArray] = np.cos(walls[0, :, 0]), np.sin(walls[0, :, 0])
        self.wall_distance: FloatArray = walls[:, :, 1].copy()
        self._block_quat = batch.bind("mocap_quat")[:, 0]
        self.friction: FloatArray = batch.expand("geom_friction")
        self.mass: FloatArray = batch.expand("body_mass")
        self._wall_position = batch.expand("geom_pos")
        self._contact = batch.expand("geom_solref")
        self._body_position = batch.expand("body_pos")
        self._inertia = batch.expand("body_inertia")
        self._finger_stiffness = batch.expand("jnt_stiffness")
        self._errors = ModelErrors(batch, scene)

    def write(self, cells: CellIndices, clearance_m: FloatArray, episodes: Sequence[Episode]) -> None:
        """Lay out `cells` (k,) for k episodes; `clearance_m` (k,) per face."""
        rows, model = cells[:, None], self._scene.model

        def of(name: str) -> FloatArray:
            return np.array([getattr(episode, name) for episode in episodes])

        errors = [episode.errors for episode in episodes]
        self._tilt[cells] = [one.hole_tilt for one in errors]
        self._untilt[cells] = pose.rotation_from_rotvec(-self._tilt[cells])
        self.move_hole(cells, of("hole_position"), of("hole_yaw"))
        self.wall_distance[cells] = hole_walls(self._scene.part, clearance_m)[:, :, 1]
        centres = wall_centres(self._scene.part, clearance_m, scene.WALL_HALF_THICKNESS_M)
        self._wall_position[rows, self._scene.wall_geoms, :2] = centres
        self.friction[cells, :, 0] = of("friction")[:, None]
        self._contact[cells, :, 0] = of("contact_time_s")[:, None]
        self._body_position[cells, self._scene.peg_body, :2] = of("grasp_offset")
        scale = of("mass_scale")[:, None]
        self.mass[rows, self._carried] = model.body_mass[self._carried] * scale
        self._inertia[rows, self._carried] = model.body_inertia[self._carried] * scale[:, :, None]
        self._finger_stiffness[cells, -1] = scene.FINGER_STIFFNESS_NM * of("stiffness_scale")
        self._errors.write(cells, errors)

    def move_hole(self, cells: CellIndices, position: FloatArray, yaw: FloatArray) -> None:
        """Move the holes of `cells` (k,) to `position` (k, 3), m, and `yaw` (k,), rad, about their axes."""
        half = 0.5 * yaw
        self.block_position[cells] = position
        turned = np.column_stack([np.cos(half), np.zeros((len(cells), 2)), np.sin(half)])
        self._block_quat[cells] = quaternion.product(quaternion.from_rotvec(self._tilt[cells]), turned)
        stored = 2.0 * np.arctan2(self._block_quat[cells, 3], self._block_quat[cells, 0])
        self.hole_yaw[cells] = stored
        for turn, function in zip(self._turn, (np.cos, np.sin), strict=True):
            turn[cells] = function(stored)

    def in_hole(self, points: FloatArray) -> FloatArray:
        """Return points (n, 3), base frame, in the frames of the holes, (n, 3), m."""
        beside = points - self.block_position
        x, y, z = (product(self._untilt, beside) if self._tilt.any() else beside).T
        cosine, sine = self._turn
        return np.stack([cosine * x + sine * y, cosine * y - sine * x, z], axis=1)
