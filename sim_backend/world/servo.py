"""Set-points of the joints' position loops, chosen so that the arm follows its reference closely."""

import mujoco
import numpy as np
import numpy.typing as npt

from sim_backend.world import kinematics
from wire.arrays import CellIndices, FloatArray


class JointServo:
    """Servos of n arms. A joint lags by its damping and sags under the payload; the set-point leads by the same amount.

    Args:
        n: number of arms.
        stiffness: (6,) stiffness of the position loops, N·m/rad.
        damping: (6,) damping of the position loops, N·m·s/rad.
        payload_kg: mass whose weight the loops carry.
        payload_com_m: (3,) centre of that mass, in the flange's frame.

    Attributes:
        sag: (n, 6) angles by which the joints sag under the payload, rad, as of the latest refresh.
    """

    def __init__(
        self, n: int, stiffness: FloatArray, damping: FloatArray, payload_kg: float, payload_com_m: npt.ArrayLike
    ) -> None:
        self._lead = damping / stiffness
        self._compliance = 1.0 / stiffness
        self.sag = np.zeros((n, 6))
        self.set_payload(payload_kg, payload_com_m)

    def set_payload(self, payload_kg: float, payload_com_m: npt.ArrayLike) -> None:
        """Configure the payload; arms refreshed from now on carry it."""
        self._weight = payload_kg * kinematics.GRAVITY_M_S2
        self._com = np.array(payload_com_m, np.float64)

    def refresh(self, cells: CellIndices, joints: FloatArray) -> None:
        """Update the sag of `cells` (k,) at joint angles (k, 6); it changes slowly, so not every tick needs it."""
        self.sag[cells] = self._compliance * self._weight * kinematics.jacobian(joints, self._com)[:, 2, :]

    def set_points(self, joints: FloatArray, speeds: FloatArray) -> FloatArray:
        """Return set-points (n, 6), rad, that bring the joints to `joints` (n, 6) at speeds `speeds` (n, 6)."""
        return joints + self._lead * speeds + self.sag

    def constants(self) -> dict[str, FloatArray]:
        """Return what the compiled tick needs, by its names."""
        return {"lead": self._lead, "sag_per_lever": self._compliance * self._weight, "payload_com": self._com}


def gains(model: mujoco.MjModel) -> tuple[FloatArray, FloatArray]:
    """Return stiffness (6,) and damping (6,) of a model's joint servos."""
    return model.actuator_gainprm[:, 0].copy(), -model.actuator_biasprm[:, 2]
