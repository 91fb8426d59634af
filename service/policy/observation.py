"""Builds a policy's observation from its contract: one table of entries, raw physical units, any batch shape.

Frame `tool` is the base frame turned by the measured yaw about z: x along the TCP's x axis, z up.
Scaling and clipping happen inside the policy's graph, not here.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, Protocol

import numpy as np
import numpy.typing as npt

from service.policy.window import WrenchSummary, summarise
from service.safety.pose import rotate, wrap
from wire.arrays import BoolArray, Float32Array, FloatArray, IntArray

ObservationMode = Literal["VFTM", "FTM", "VM"]
Frame = Literal["tool", "base", "none"]

CENTROID_FLOOR_N = 1.0
"""Smallest normal force that divides the torque, N. It keeps the contact centroid small where contact is weak."""
CENTROID_LIMIT_M = 0.03
"""Limit at which the contact centroid is cut, m. A value beyond the largest part carries no meaning."""


def uses_estimate(mode: ObservationMode) -> bool:
    """Return whether a mode uses the camera's estimate of the hole; FTM uses the nominal centre instead."""
    return mode != "FTM"


class Need(StrEnum):
    """Capability that a cell must have to supply an entry."""

    FORCE_TORQUE = "force_torque"
    HOLE = "hole"
    """A camera's estimate of the hole. Mode FTM uses the nominal centre and needs no camera."""
    LAST_JOINT = "last_joint"


@dataclass(frozen=True, slots=True)
class Measurement:
    """Quantities known at one policy step; base frame, batch shape (...).

    Attributes:
        position: (..., 3) m, measured TCP.
        yaw: (...) rad, measured.
        tilt: (..., 2) rad, measured, as `service.safety.pose.yaw_and_tilt` gives it.
        wrench_window: (T, ..., 6) N and N·m at the TCP, oldest first: the samples since the last step.
        hole_estimate: (..., 3) m, this camera frame's estimate of the centre of the hole's mouth; NaN without one.
        nominal_hole: (..., 3) m, nominal centre of the hole's mouth, known without a camera.
        target_position: (..., 3) m, the command in force.
        target_yaw: (...) rad, the command in force.
        start_yaw: (...) rad, yaw at the start of the run.
        z_lock: (...) m, height of the safety lock; NaN while there is none.
        contact_z: (...) m, height of the first contact (`z_contact0` of the lock's state); NaN before it.
        phase: (...) `Phase` of the lock's state.
        previous_action: (..., 4) the policy's last action (`ActionMap.unit`); zero before the first.
        last_joint: (...) rad, angle of the last joint.
    """

    position: FloatArray
    yaw: FloatArray
    tilt: FloatArray
    wrench_window: FloatArray
    hole_estimate: FloatArray
    nominal_hole: FloatArray
    target_position: FloatArray
    target_yaw: FloatArray
    start_yaw: FloatArray
    z_lock: FloatArray
    contact_z: FloatArray
    phase: npt.NDArray[np.integer]
    previous_action: FloatArray
    last_joint: FloatArray


@dataclass(frozen=True, slots=True)
class ObservationState:
    """Memory between steps; batch shape (...) in front.

    Attributes:
        frames: (..., H, n) float32, the last H frames of all entries, newest last.
        hole_mean: (..., 3) m, running mean of the hole estimates of the episode.
        hole_count: (...) int32, number of estimates in that mean.
        steps: (...) int32, number of observations built in this episode.
    """

    frames: Float32Array
    hole_mean: FloatArray
    hole_count: IntArray
    steps: IntArray


@dataclass(frozen=True, slots=True)
class Reading:
    """A measurement together with the quantities that several entries share."""

    m: Measurement
    felt: WrenchSummary
    hole: FloatArray
    hole_frame: FloatArray
    contact_known: BoolArray
    time_fraction: FloatArray
    wrench_clip: FloatArray

    def in_tool_frame(self, vector: FloatArray) -> FloatArray:
        """Turn a vector (..., 2 or 3) from base axes to tool axes."""
        return rotate(-self.m.yaw, vector)


def _column(value: npt.ArrayLike) -> FloatArray:
    return np.asarray(value, np.float64)[..., None]


def _hole_offset_xy(r: Reading) -> FloatArray:
    return r.in_tool_frame(r.hole[..., :2] - r.m.position[..., :2])


def _height(r: Reading) -> FloatArray:
    return _column(r.m.position[..., 2] - np.where(r.contact_known, r.m.contact_z, r.hole[..., 2]))


def _yaw(r: Reading) -> FloatArray:
    return _column(wrap(r.m.yaw - r.m.start_yaw))


def _force_z_range(r: Reading) -> FloatArray:
    return np.stack((r.felt.fz_min, r.felt.fz_max, r.felt.fz_std), axis=-1)


def _contact_centroid(r: Reading) -> FloatArray:
    # A normal force N, upwards at (x, y) from the TCP, gives Tx = y N, Ty = -x N
    normal = np.maximum(r.felt.mean[..., 2], CENTROID_FLOOR_N)
    centroid = np.stack((-r.felt.mean[..., 4], r.felt.mean[..., 3]), axis=-1) / normal[..., None]
    return np.clip(r.in_tool_frame(centroid), -CENTROID_LIMIT_M, CENTROID_LIMIT_M)


def _lag(r: Reading) -> FloatArray:
    linear = r.in_tool_frame(r.m.target_position - r.m.position)
    return np.concatenate((linear, _column(wrap(r.m.target_yaw - r.m.yaw))), axis=-1)


def _lock_height(r: Reading) -> FloatArray:
    return _column(np.nan_to_num(r.m.z_lock - r.m.position[..., 2], nan=0.0))


@dataclass(frozen=True, slots=True)
class EntrySpec:
    """One kind of observation entry.

    Attributes:
        size: number of components of one frame.
        unit: unit of each component; two units are joined by a comma.
        frame: axes of the components.
        needs: capabilities that the cell must have.
        meaning: one line for the documentation.
        read: function that returns the entry (..., size) of a reading.
    """

    size: int
    unit: str
    frame: Frame
    needs: frozenset[Need]
    meaning: str
    read: Callable[[Reading], FloatArray]


_FT = frozenset({Need.FORCE_TORQUE})
_HOLE = frozenset({Need.HOLE})
_NONE: frozenset[Need] = frozenset()

ENTRIES: dict[str, EntrySpec] = {
    "hole_offset_xy": EntrySpec(2, "m", "tool", _HOLE, "hole (mean of the estimates) minus TCP", _hole_offset_xy),
    "height": EntrySpec(
        1, "m", "base", _HOLE, "height of the TCP above the hole; after a contact, above the first contact", _height
    ),
    "contact_height_known": EntrySpec(
        1, "1", "none", _FT, "1 after the first contact, 0 before", lambda r: _column(r.contact_known)
    ),
    "yaw": EntrySpec(1, "rad", "base", _NONE, "yaw minus the yaw at the start of the run", _yaw),
    "tilt": EntrySpec(
        2, "rad", "tool", _NONE, "tilt of the tool from straight down", lambda r: r.in_tool_frame(r.m.tilt)
    ),
    "force_mean": EntrySpec(
        3, "N", "tool", _FT, "mean force over the window", lambda r: r.in_tool_frame(r.felt.mean[..., :3])
    ),
    "torque_mean": EntrySpec(
        3, "N·m", "tool", _FT, "mean torque at the TCP over the window", lambda r: r.in_tool_frame(r.felt.mean[..., 3:])
    ),
    "force_z_range": EntrySpec(
        3, "N", "base", _FT, "minimum, maximum, standard deviation of Fz over the window", _force_z_range
    ),
    "contact_centroid": EntrySpec(
        2, "m", "tool", _FT, "point of the normal force: (-Ty, Tx) / max(Fz, 1 N), cut at 30 mm", _contact_centroid
    ),
    "lag": EntrySpec(4, "m,rad", "tool", _NONE, "command in force minus measured pose: x, y, z, yaw", _lag),
    "previous_action": EntrySpec(
        4, "1", "none", _NONE, "last action, -1 … 1: dx, dy, dz, dyaw", lambda r: r.m.previous_action
    ),
    "lock_height": EntrySpec(1, "m", "base", _FT, "height of the lock above the TCP; 0 without a lock", _lock_height),
    "phase": EntrySpec(1, "1", "none", _FT, "phase of the lock (`Phase`)", lambda r: _column(r.m.phase)),
    "time_fraction": EntrySpec(
        1, "1", "none", _NONE, "steps taken divided by steps allowed", lambda r: _column(r.time_fraction)
    ),
    "eef_position": EntrySpec(3, "m", "base", _NONE, "position of the TCP, as in the paper", lambda r: r.m.position),
    "last_joint_angle": EntrySpec(
        1,
        "rad",
        "none",
        frozenset({Need.LAST_JOINT}),
        "angle of the last joint, as in the paper",
        lambda r: _column(r.m.last_joint),
    ),
    "hole_position": EntrySpec(
        3, "m", "base", _HOLE, "this camera frame's estimate, as in the paper", lambda r: r.hole_frame
    ),
    "wrench_normalised": EntrySpec(
        6,
        "1",
        "base",
        _FT,
        "mean wrench over the window, divided by the lock's clip, cut to -1 … 1, as in the paper",
        lambda r: np.clip(r.felt.mean / r.wrench_clip, -1.0, 1.0),
    ),
}
"""Every entry that a contract may name."""


class ObservedEntry(Protocol):
    """Fields of a contract's observation entry that the builder reads."""

    @property
    def name(self) -> str: ...
    @property
    def history(self) -> int: ...


class ObservationBuilder:
    """Builds observations for one contract. `ObservationState` holds the memory between steps.

    Attributes:
        columns: (size,) place of each number of an observation in the flattened frames.
    """

    def __init__(
        self,
        entries: Sequence[ObservedEntry],
        mode: ObservationMode,
        max_steps: int,
        window_samples: int,
        force_clip_n: float = 10.0,
        torque_clip_nm: float = 1.0,
    ) -> None:
        """Prepare the builder.

        Args:
            entries: observation entries of a checked contract, in order.
            mode: FTM observes the nominal centre instead of the estimate; VM observes nothing of the contact.
            max_steps: length of an episode, steps, for `time_fraction`.
            window_samples: number of newest samples of the wrench window that are averaged.
            force_clip_n: the lock's force clip, N, for `wrench_normalised`.
            torque_clip_nm: the lock's torque clip, N·m, for `wrench_normalised`.

        Raises:
            ValueError: `ENTRIES` lacks an entry.
        """
        unknown = [entry.name for entry in entries if entry.name not in ENTRIES]
        if unknown:
            raise ValueError(f"unknown observation entries {unknown}; known are {sorted(ENTRIES)}")
        self._specs = [ENTRIES[entry.name] for entry in entries]
        self._mode: ObservationMode = mode
        self._max_steps = max_steps
        self._window_samples = window_samples
        self._wrench_clip = np.array([force_clip_n] * 3 + [torque_clip_nm] * 3)
        self._depth = max(entry.history for entry in entries)
        self._width = sum(spec.size for spec in self._specs)
        columns: list[int] = []
        first = 0
        for entry, spec in zip(entries, self._specs, strict=True):
            for row in range(self._depth - entry.history, self._depth):
                columns += range(row * self._width + first, row * self._width + first + spec.size)
            first += spec.size
        self.columns = np.array(columns)

    @property
    def size(self) -> int:
        """Length of an observation."""
        return len(self.columns)

    def begin(self, shape: tuple[int, ...] = ()) -> ObservationState:
        """Return the memory before the first observation of an episode."""
        return ObservationState(
            frames=np.zeros((*shape, self._depth, self._width), np.float32),
            hole_mean=np.zeros((*shape, 3)),
            hole_count=np.zeros(shape, np.int32),
            steps=np.zeros(shape, np.int32),
        )

    def build(self, state: ObservationState, measurement: Measurement) -> tuple[ObservationState, Float32Array]:
        """Build one observation; call it once per policy step.

        Args:
            state: from `begin` or the last call.
            measurement: present measurement.

        Returns:
            The next memory, and (..., size) float32: entries in order, each with its history, oldest frame first. The
            first frame of an episode stands for the frames before it. A value is NaN where a quantity is not known.
        """
        hole_mean, hole_count = self._hole(state, measurement)
        contact_known = np.isfinite(measurement.contact_z)
        if self._mode == "VM":
            contact_known = contact_known & False
        nominal = not uses_estimate(self._mode)
        reading = Reading(
            m=measurement,
            felt=summarise(measurement.wrench_window, self._window_samples),
            hole=measurement.nominal_hole
            if nominal
            else np.where(np.asarray(hole_count > 0)[..., None], hole_mean, np.nan),
            hole_frame=measurement.nominal_hole if nominal else measurement.hole_estimate,
            contact_known=contact_known,
            time_fraction=state.steps / self._max_steps,
            wrench_clip=self._wrench_clip,
        )
        frame = np.concatenate([spec.read(reading) for spec in self._specs], axis=-1).astype(np.float32)
        first = np.asarray(state.steps == 0)[..., None, None]
        newest = frame[..., None, :]
        frames = np.where(first, newest, np.concatenate((state.frames[..., 1:, :], newest), axis=-2))
        observation = frames.reshape(*frames.shape[:-2], -1)[..., self.columns]
        return ObservationState(frames, hole_mean, hole_count, state.steps + 1), observation

    def _hole(self, state: ObservationState, measurement: Measurement) -> tuple[FloatArray, IntArray]:
        """Update the running mean of the estimates. A frame without an estimate leaves it unchanged."""
        seen = np.asarray(np.isfinite(measurement.hole_estimate).all(-1))
        count = state.hole_count + seen
        change = (measurement.hole_estimate - state.hole_mean) / np.maximum(count, 1)[..., None]
        return state.hole_mean + np.where(seen[..., None], change, 0.0), count
