"""The wrist's force/torque sensor and the controller's view of it.

Raw readings are the load on the flange in the flange's frame, with bias, drift, noise, delay and a finite range.
Compensated readings are zeroed, without the gravity of the configured payload, at the TCP, in the base frame. Their
sign is that of the environment's action on the tool: a UR controller's `actual_TCP_force`.
"""

import numpy as np
import numpy.typing as npt

from sim_backend.world import compiled
from sim_backend.world.conditions import NOISE_ROWS, Episode
from sim_backend.world.errors import NONE
from sim_backend.world.kinematics import GRAVITY_M_S2
from sim_backend.world.linear import moment, product
from wire import extension, pose
from wire.arrays import BoolArray, FloatArray
from wire.records import TICK_S

RANGE = np.array([30.0] * 3 + [10.0] * 3)
"""End of the range of the UR3e's sensor, N and N·m, per channel."""
MAX_DELAY = 32
DRIFT_TICKS = 50_000
"""Ticks after an episode's start at which its drift ends, as that of a real sensor ends once the sensor is warm."""
ZERO_TICKS = 100
"""Time constant of the average from which a zero is taken; a single sample would carry its noise into all readings."""


class ForceTorqueSensor:
    """Force/torque sensors of n cells.

    Args:
        n: number of sensors.
        payload_kg: mass that the controller compensates.
        payload_com_m: (3,) centre of that mass, in the flange's frame.
        tcp_offset_m: (3,) TCP in the flange's frame.

    Attributes:
        saturated: (n,) True where a channel of the latest reading is at the end of its range.
    """

    def __init__(self, n: int, payload_kg: float, payload_com_m: npt.ArrayLike, tcp_offset_m: npt.ArrayLike) -> None:
        self._rows = np.arange(n)
        self._history = np.zeros((n, MAX_DELAY, 6))
        self._slot = 0
        self._tick = np.zeros(n, np.int64)
        self._delay = np.ones(n, np.int64)
        self._noise = np.zeros((n, NOISE_ROWS, 6), np.float32)
        self._gain = np.ones(n)
        self._left = np.zeros((n, 6))
        self._bias = np.zeros((n, 6))
        self._drift = np.zeros((n, 6))
        self._zero = np.zeros((n, 6))
        self._average = np.zeros((n, 6))
        self._sensed = np.zeros((n, 6))
        self._raw = np.zeros((n, 6))
        self._wrench = np.zeros((n, 6))
        self.saturated: BoolArray = np.zeros(n, bool)
        self._compiled = compiled.tick
        self._arrays = () if self._compiled is None else compiled.arrays(self._compiled.SENSOR, vars(self))
        self._set_levers(payload_kg, payload_com_m, tcp_offset_m)

    @property
    def raw(self) -> FloatArray:
        """(n, 6) copy of the latest reading within the sensor's range: about the flange, flange axes, N and N·m."""
        return self._raw.copy()

    @property
    def wrench(self) -> FloatArray:
        """(n, 6) copy of the latest compensated reading: at the TCP, base axes, N and N·m."""
        return self._wrench.copy()

    @property
    def latest(self) -> FloatArray:
        """(n, 6) `wrench` itself, which the next reading changes in place."""
        return self._wrench

    @property
    def latest_raw(self) -> FloatArray:
        """(n, 6) `raw` itself, which the next reading changes in place."""
        return self._raw

    @property
    def bound(self) -> compiled.Bound:
        """Arrays and constants for the compiled tick; the constants are those of the latest `configure`."""
        return self._arrays, self._constants

    @property
    def slot(self) -> int:
        """Slot of the latest reading in the history."""
        return self._slot

    def pass_slots(self, ticks: int) -> None:
        """Go on by readings that the compiled tick has taken."""
        self._slot = (self._slot + ticks) % MAX_DELAY

    def configure(
        self, payload_kg: float, payload_com_m: npt.ArrayLike, tcp_offset_m: npt.ArrayLike, rotation: FloatArray
    ) -> None:
        """Compensate another payload and report at another TCP from the next reading on; the zero stays.

        Args:
            payload_kg: mass that the controller compensates.
            payload_com_m: (3,) centre of that mass, in the flange's frame.
            tcp_offset_m: (3,) TCP in the flange's frame.
            rotation: (n, 3, 3) present orientation of the flange; the next zero uses the readings before this call.
        """
        self._average += self._gravity(rotation)
        self._set_levers(payload_kg, payload_com_m, tcp_offset_m)
        self._average -= self._gravity(rotation)

    def reset(self, cell: int, episode: Episode) -> None:
        """Give one sensor an episode's noise, bias and delay, and clear its history."""
        self._tick[cell] = 0
        self._delay[cell] = episode.sensor_delay
        self._noise[cell] = episode.wrench_noise
        self._bias[cell] = episode.bias
        self._drift[cell] = episode.drift * TICK_S
        self._zero[cell] = 0.0
        # at rest, tool down, since long before the episode; the payload's mass differs slightly from the configured one
        self._average[cell] = episode.bias + episode.wrench_noise[-ZERO_TICKS:].mean(axis=0)
        self._average[cell, 2] += (episode.mass_scale - 1.0) * self._weight
        self._average[cell] += self._misread(episode)
        self._gain[cell], self._left[cell] = episode.errors.ft_gain, episode.errors.ft_left
        self._raw[cell] = self._wrench[cell] = 0.0
        self.saturated[cell] = False

    def read(self, carried: FloatArray, rotation: FloatArray) -> None:
        """Take one reading and set `raw`, `wrench` and `saturated`.

        Args:
            carried: (n, 6) true load on the flange, flange axes, from environment and gravity.
            rotation: (n, 3, 3) orientation of the flange.
        """
        sensed = self.sense(carried)
        if self._compiled is not None:
            self._compiled.compensate(self._arrays, self._constants, sensed, rotation)
            return
        np.any(np.abs(sensed) >= RANGE, axis=1, out=self.saturated)
        np.clip(sensed, -RANGE, RANGE, out=self._raw)
        own = self._raw - self._gravity(rotation)
        self._average += (own - self._average) / ZERO_TICKS
        own -= self._zero
        self._wrench[:] = self._at_tcp(own, rotation)

    def unzeroed(self, rotation: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Return the latest reading as `wrench`, (n, 6), but without any zero.

        Args:
            rotation: (n, 3, 3) orientation of the flange at that reading.
            out: (n, 6) where to write it; None: into a new array.
        """
        out = np.empty_like(self._raw) if out is None else out
        if self._compiled is not None:
            self._compiled.unzeroed(self._arrays, self._constants, rotation, out)
        else:
            out[:] = self._at_tcp(self._raw - self._gravity(rotation), rotation)
        return out

    def sense(self, carried: FloatArray) -> FloatArray:
        """Return the reading (n, 6) that the sensor's electronics make of the true load, before its range ends it."""
        self._slot = (self._slot + 1) % MAX_DELAY
        if self._compiled is not None:
            self._compiled.sense(self._arrays, self._constants, carried, self._slot)
            return self._sensed
        self._history[:, self._slot] = carried
        fresh = self._tick == 0
        if fresh.any():
            self._history[fresh] = carried[fresh][:, None]
        # MuJoCo's reading is already one tick old
        raw = self._history[self._rows, (self._slot - self._delay + 1) % MAX_DELAY]
        raw *= self._gain[:, None]
        raw += self._noise[self._rows, self._tick % NOISE_ROWS]
        raw += self._bias
        raw += self._drift * np.minimum(self._tick, DRIFT_TICKS)[:, None]
        self._tick += 1
        return raw

    def zero(self, cells: npt.NDArray[np.int64]) -> None:
        """Take the running average of the latest readings as the zero of `cells`; meaningless in contact or
        in motion.
        """
        self._zero[cells] = self._average[cells] - self._left[cells]

    def _misread(self, episode: Episode) -> FloatArray:
        """Return the error (6,), flange axes, with which the payload is read at rest, tool down."""
        errors = episode.errors
        if errors is NONE:
            return np.zeros(6)
        weight = np.array([0.0, 0.0, episode.mass_scale * self._weight])
        shown = np.stack([weight, np.cross(self._com + errors.payload_shift, weight)])
        turned = errors.ft_gain * shown @ pose.rotation_from_rotvec(errors.ft_turn)
        return (turned - np.stack([weight, np.cross(self._com, weight)])).ravel()

    def _at_tcp(self, own: FloatArray, rotation: FloatArray) -> FloatArray:
        """Return a wrench at the TCP, base axes, of one about the flange, flange axes; (n, 6) each."""
        wrench = np.empty_like(own)
        wrench[:, :3] = product(rotation, own[:, :3])
        own[:, 3:] -= moment(self._tcp, own[:, :3])
        wrench[:, 3:] = product(rotation, own[:, 3:])
        return wrench

    def _gravity(self, rotation: FloatArray) -> FloatArray:
        """Return the wrench of the configured payload's weight, (n, 6), flange axes: force along base -z at
        its centre.
        """
        out = np.empty((len(rotation), 6))
        np.multiply(rotation[:, 2, :], -self._weight, out=out[:, :3])
        out[:, 3:] = moment(self._com, out[:, :3])
        return out

    def _set_levers(self, payload_kg: float, payload_com_m: npt.ArrayLike, tcp_offset_m: npt.ArrayLike) -> None:
        self._weight = payload_kg * GRAVITY_M_S2
        self._com, self._tcp = np.array(payload_com_m, np.float64), np.array(tcp_offset_m, np.float64)
        if self._compiled is not None:
            self._constants = extension.constants(
                self._compiled.SENSOR_CONSTANTS,
                {
                    "drift_ticks": DRIFT_TICKS,
                    "zero_ticks": ZERO_TICKS,
                    "weight": self._weight,
                    "range": RANGE,
                    "com": self._com,
                    "tcp": self._tcp,
                },
            )
