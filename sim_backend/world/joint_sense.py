"""The force on the tool as the joints' drives feel it: a second witness of the contact, beside the F/T sensor.

A controller knows the torques of its drives and the torques that its own model of the arm, the motion and the payload
explains. The rest is the environment's. It has no part in common with the force/torque sensor, and is much coarser:
gears rub, and the model is not exact.
"""

from collections.abc import Sequence

import numpy as np

from sim_backend.world import compiled, kinematics
from sim_backend.world.linear import product
from sim_backend.world.world import World
from wire import extension
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
    """The drives of one arm, in a world of one cell."""

    def __init__(self) -> None:
        self._friction = FRICTION_SHARE * kinematics.JOINT_TORQUE_NM
        self._noise = NOISE_SHARE * kinematics.JOINT_TORQUE_NM
        self._trust = 1.0 / self._friction**2
        self._stick, self._force = np.zeros((1, 6)), np.zeros((1, 3))
        self._setting: tuple[float, Sequence[float], Sequence[float]] | None = None
        self._compiled = compiled.tick
        self._arrays = () if self._compiled is None else compiled.arrays(self._compiled.DRIVES, vars(self))
        self.begin(0)

    @property
    def force(self) -> FloatArray:
        """(3,) copy of the latest reading: the force of the environment on the tool, N, base axes."""
        return self._force[0].copy()

    def begin(self, seed: int) -> None:
        """Begin an episode: the joints have come to rest somewhere within their friction."""
        self._rng = np.random.default_rng([seed, _STREAM])
        self._stick[0] = self._rng.uniform(-1.0, 1.0, 6)
        self._force[:] = 0.0

    def read(self, world: World, payload_kg: float, payload_com_m: Sequence[float], point_m: Sequence[float]) -> None:
        """Take one reading.

        The force is the one at `point_m` that explains the torques best, each weighed by its joint's friction. A
        singular arm keeps its last reading.

        Args:
            world: after its tick.
            payload_kg: mass that the controller compensates.
            payload_com_m: (3,) centre of that mass, in the flange's frame.
            point_m: (3,) point of contact that is assumed, in the flange's frame.
        """
        noise = self._rng.standard_normal((1, 6))
        if self._compiled is not None:
            setting = payload_kg, payload_com_m, point_m
            if setting != self._setting:
                self._setting, self._constants = setting, self._constants_of(self._compiled, *setting)
            self._compiled.feel(self._arrays, self._constants, world.drives, noise)
            return
        stick = self._stick[0]
        stick += world.joint_speeds[0] * (2.0 * TICK_S / PRESLIDING_RAD)
        np.clip(stick, -1.0, 1.0, out=stick)
        point = np.asarray(point_m, np.float64)
        _, rotation, jacobian = kinematics.forward_and_jacobian(world.joints, point)
        x, y, _ = product(rotation, np.asarray(payload_com_m, np.float64)[None] - point)[0].tolist()
        jacobian = jacobian[0]
        carried = payload_kg * kinematics.GRAVITY_M_S2 * (jacobian[2] + y * jacobian[3] - x * jacobian[4])
        felt = carried - world.joint_torques[0] + (1.0 - DYNAMICS_SHARE) * world.inertial_torques[0]
        felt += self._friction * stick + self._noise * noise[0]
        lever = jacobian[:3]
        gram = (lever[:, None] * (lever * self._trust)).sum(-1)
        found = _solve(gram, (lever * (self._trust * felt)).sum(-1))
        if found is not None:
            self._force[0] = found

    def _constants_of(
        self, tick: compiled.Tick, payload_kg: float, payload_com_m: Sequence[float], point_m: Sequence[float]
    ) -> FloatArray:
        constants = {
            **kinematics.LENGTHS_M,
            "turns_per_rad_s": 2.0 * TICK_S / PRESLIDING_RAD,
            "modelled_share": 1.0 - DYNAMICS_SHARE,
            "weight": payload_kg * kinematics.GRAVITY_M_S2,
            "friction": self._friction,
            "noise_nm": self._noise,
            "trust": self._trust,
            "com": payload_com_m,
            "point": point_m,
        }
        return extension.constants(tick.DRIVES_CONSTANTS, constants)


def _solve(gram: FloatArray, moved: FloatArray) -> tuple[float, float, float] | None:
    """Return the solution of a symmetric system of three equations, by its adjugate; None if it is singular.

    Args:
        gram: (3, 3); what stands below the diagonal is not read.
        moved: (3,) right-hand side.
    """
    (a, b, c), (_, d, e), (_, _, f) = gram.tolist()
    x, y, z = moved.tolist()
    aa, bb, cc = d * f - e * e, c * e - b * f, b * e - c * d
    dd, ee, ff = a * f - c * c, b * c - a * e, a * d - b * b
    determinant = a * aa + b * bb + c * cc
    if determinant == 0.0:
        return None
    return (
        (aa * x + bb * y + cc * z) / determinant,
        (bb * x + dd * y + ee * z) / determinant,
        (cc * x + ee * y + ff * z) / determinant,
    )
