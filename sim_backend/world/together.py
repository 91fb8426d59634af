"""All ticks of a policy step in one call of MuJoCo: arm, sensor and camera run inside its steps, on its threads.

Between two ticks a call of `Batch.step` ends and another begins. Each loads and saves every simulation and waits for
all threads. MuJoCo's control callback is called within a step, when the kinematics of its beginning are known and
before its forces are. The compiled tick does there what `World.tick` does before a step, preceded by what it does
after the step before.

The callback is one for the whole process. It recognises this project's scenes by their name, and a call under way by
a custom number of the simulation's own model, which MuJoCo keeps when it resets a simulation that has diverged. It
leaves everything else alone.
"""

import numpy as np
from mujoco.batch import Batch

from sim_backend.world import compiled
from sim_backend.world.sensor import ForceTorqueSensor
from wire import extension
from wire.arrays import FloatArray


class Together:
    """Ticks of n cells in one call.

    Args:
        tick: the extension.
        batch: the simulations.
        bodies: id of the site of the TCP, and of the body that carries the gripper.
        arm: of the arm controllers.
        cells: of the world.
    """

    def __init__(
        self, tick: compiled.Tick, batch: Batch, bodies: tuple[int, int], arm: compiled.Bound, cells: compiled.Bound
    ) -> None:
        site, body = bodies
        n = batch.nsim
        mine = {
            "orientation": batch.bind("xquat")[:, body],
            "before": np.zeros((n, 17)),
            "done": np.zeros(n, np.int64),
            "told": batch.expand("numeric_data"),
        }
        constants = {"tcp_site": site, "gripper_body": body}
        self._tick = tick
        self._batch = batch
        self._others = *arm, *cells
        self._arrays = compiled.arrays(tick.TOGETHER, mine)
        self._constants = extension.constants(tick.TOGETHER_CONSTANTS, constants)
        self._call = np.zeros(tick.CALL)

    def advance(self, sensor: ForceTorqueSensor, readings: FloatArray) -> None:
        """Run as many ticks as `readings` (ticks, n, 6) has rows; write the compensated readings there.

        Args:
            sensor: the force/torque sensors.
            readings: see above.

        Raises:
            SimulationError: MuJoCo failed in a simulation.
            RuntimeError: another thread advances or steps these cells, or MuJoCo has called another callback.
        """
        mine = self._arrays, self._constants, self._call
        self._tick.advance(*self._others, *sensor.bound, *mine, readings, sensor.slot, self._step)
        sensor.pass_slots(len(readings))

    def _step(self, ticks: int) -> None:
        self._batch.step(nstep=ticks)
