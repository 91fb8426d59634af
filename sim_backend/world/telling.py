"""State that cells tell of themselves: fields of the wire's state record, in its units."""

from collections.abc import Mapping

from sim_backend.world import compiled, quaternion
from sim_backend.world.linear import product
from wire import pose
from wire.arrays import FloatArray

REPORT = (
    *("q", "qd", "tcp_position", "tcp_rotvec", "tcp_velocity", "target_position", "target_rotvec"),
    *("wrench", "ft_raw", "hole_estimate", "peak_force"),
)
"""Fields of `records.STATE` that `Telling.write` writes."""


class Telling:
    """Present state of n cells.

    Args:
        found: by name, arrays that change in place from tick to tick. Measured: `joints` (n, 6), `qvel` (n, 7),
            `position` (n, 3), `rotation` (n, 3, 3), `estimate` (n, 3), `wrench` and `raw` (n, 6). Of the arm:
            `jacobian` (n, 6, 6), `target_position` (n, 3), `target_quaternion` (n, 4), `peak_force` (n,).
    """

    def __init__(self, found: Mapping[str, FloatArray]) -> None:
        self._found = found
        self._compiled = compiled.tick
        self._arrays = () if self._compiled is None else compiled.arrays(self._compiled.TELLING, found)

    def write(self, report: compiled.Arrays) -> None:
        """Write the present state into the arrays of `report`: those of `REPORT`, (n, …)."""
        if self._compiled is not None:
            self._compiled.tell(self._arrays, report)
            return
        found, speeds = self._found, self._found["qvel"][:, :6]
        state = (
            found["joints"],
            speeds,
            found["position"],
            pose.rotvec_from_rotation(found["rotation"]),
            product(found["jacobian"], speeds),
            found["target_position"],
            quaternion.to_rotvec(found["target_quaternion"]),
            found["wrench"],
            found["raw"],
            found["estimate"],
            found["peak_force"],
        )
        for array, values in zip(report, state, strict=True):
            array[:] = values
