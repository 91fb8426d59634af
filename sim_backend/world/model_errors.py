"""The parts of MuJoCo's models that only a plant with errors changes."""

from collections.abc import Sequence

import numpy as np
from mujoco.batch import Batch

from sim_backend.world import errors, kinematics, quaternion, scene
from sim_backend.world.errors import Errors
from wire.arrays import CellIndices, FloatArray

_FRICTION_IMPEDANCE = 0.999
"""Impedance of the joints' friction; with MuJoCo's own, 0.9, a joint creeps under half of it."""


class ModelErrors:
    """Errors of n simulations' models. Models of a batch that never had errors are left as they are.

    Args:
        batch: the simulations.
        scene: their scene.
    """

    def __init__(self, batch: Batch, scene: scene.Scene) -> None:
        self._batch = batch
        self._scene = scene
        self._begun = False

    def write(self, cells: CellIndices, episodes: Sequence[Errors]) -> None:
        """Give `cells` (k,) the errors of k episodes."""
        if not self._begun and all(one is errors.NONE for one in episodes):
            return
        if not self._begun:
            self._begin()
        peg, gripper, model = self._scene.peg_body, self._scene.gripper_body, self._scene.model

        def of(name: str) -> FloatArray:
            return np.array([getattr(one, name) for one in episodes])

        self._body_position[cells, peg, :2] += of("tcp_shift")[:, :2]
        self._body_position[cells, peg, 2] = model.body_pos[peg, 2] + of("tcp_shift")[:, 2]
        self._body_turn[cells, peg] = quaternion.from_rotvec(of("tcp_turn"))
        self._sensor_turn[cells, model.site("ft").id] = quaternion.from_rotvec(of("ft_turn"))
        lever = scene.PAYLOAD_KG / scene.GRIPPER_MASS_KG  # the peg stays, so the gripper's own centre moves further
        self._centre[cells, gripper] = model.body_ipos[gripper] + lever * of("payload_shift")
        self._finger_stiffness[cells, -1] *= of("finger_stiffness_scale")
        stiffness = of("joint_stiffness_scale")[:, None]
        self._gain[cells, :, 0] = model.actuator_gainprm[:, 0] * stiffness
        self._bias[cells, :, 1] = model.actuator_biasprm[:, 1] * stiffness
        self._bias[cells, :, 2] = model.actuator_biasprm[:, 2] * np.sqrt(stiffness)
        self._friction[cells, :6] = of("joint_friction_share")[:, None] * kinematics.JOINT_TORQUE_NM

    def _begin(self) -> None:
        expand = self._batch.expand
        self._body_position, self._body_turn = expand("body_pos"), expand("body_quat")
        self._sensor_turn, self._centre = expand("site_quat"), expand("body_ipos")
        expand("site_sameframe")[:, self._scene.model.site("ft").id] = 0  # or its axes count as the body's
        self._finger_stiffness, self._friction = expand("jnt_stiffness"), expand("dof_frictionloss")
        self._gain, self._bias = expand("actuator_gainprm"), expand("actuator_biasprm")
        expand("dof_solimp")[:, :6, :2] = _FRICTION_IMPEDANCE
        self._begun = True
