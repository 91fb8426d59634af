"""The force on the tool as the joints' drives feel it: a second witness of the contact, beside the F/T sensor.

A controller knows the torques of its drives and the torques that its own model of the arm, the motion and the payload
explains. The rest is the environment's. It has no part in common with the force/torque sensor, and is much coarser:
gears rub, and the model is not exact.
"""

import contextlib

import numpy as np
import numpy.typing as npt

from sim_backend.world import kinematics
from sim_backend.world.world import World
from wire.arrays import FloatArray
from wire.records import TICK_S

FRICTION_SHARE = 0.02
"""Friction that the controller's model leaves over, as a share of the rated torque. An assumption."""
DYNAMICS_SHARE = 0.1
"""Share of the torques of acceleration that the controller's model leaves over. An assumption likewise."""
NOISE_SHARE = 0.002
"""Standard deviation of one reading's noise, as a share of the rated torque. An assumption likewise."""
PRESLIDING_RAD = 1e-3
"""Way of a joint over which its friction turns from one end to the other."""

_STREAM = 3
"""Number of this sense's random stream, so that the other draws of a seed do not depend on it."""


class JointSense:
    """The drives of one arm, in a world of one cell.

    Attributes:
        force: (3,) latest reading: the force of the environment on the tool, N, base axes.
    """

    def __init__(self) -> None:
        self._friction = FRICTION_SHARE * kinematics.JOINT_TORQUE_NM
        self._noise = NOISE_SHARE * kinematics.JOINT_TORQUE_NM
        self._weight = 1.0 / self._friction**2
        self.force: FloatArray = np.zeros(3)
        self.begin(0)

    def begin(self, seed: int) -> None:
        """Begin an episode: the joints have come to rest somewhere within their friction."""
        self._rng = np.random.default_rng([seed, _STREAM])
        self._stick = self._rng.uniform(-1.0, 1.0, 6)
        self.force = np.zeros(3)

    def read(self, world: World, payload_kg: float, payload_com_m: npt.ArrayLike, point_m: npt.ArrayLike) -> None:
        """Take one reading.

        The force is the one at `point_m` that explains the torques best, each weighed by its joint's friction. A
        singular arm keeps its last reading.

        Args:
            world: after its tick.
            payload_kg: mass that the controller compensates.
            payload_com_m: (3,) centre of that mass, in the flange's frame.
            point_m: (3,) point of contact that is assumed, in the flange's frame.
        """
        qd = world.joint_speeds[0]
        self._stick = np.minimum(np.maximum(self._stick + qd * (2.0 * TICK_S / PRESLIDING_RAD), -1.0), 1.0)
        point = np.asarray(point_m, np.float64)
        _, rotation, jacobian = kinematics.forward_and_jacobian(world.joints[0], point)
        x, y, _ = (rotation @ (np.asarray(payload_com_m, np.float64) - point)).tolist()
        carried = payload_kg * kinematics.GRAVITY_M_S2 * (jacobian[2] + y * jacobian[3] - x * jacobian[4])
        felt = carried - world.joint_torques[0] + (1.0 - DYNAMICS_SHARE) * world.inertial_torques[0]
        felt += self._friction * self._stick + self._noise * self._rng.standard_normal(6)
        lever = jacobian[:3]
        with contextlib.suppress(np.linalg.LinAlgError):
            self.force = np.linalg.solve((lever * self._weight) @ lever.T, lever @ (self._weight * felt))
