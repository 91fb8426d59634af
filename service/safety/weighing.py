"""Weighs the payload at several attitudes, and so proves signs, gains and axes of the force/torque sensor.

With the tool straight down the payload's weight acts along one axis of the sensor and says nothing about the others.
Turned, it acts along all of them. The raw reading of a standing arm with a free tool is `gain @ weight + bias`, where
`weight` (3,) is the configured payload's, in flange axes. Four attitudes whose weights do not lie in one plane
determine gain and bias, for force and torque alike. For an honest sensor and a correct payload the gain of the force is
the identity, and that of the torque the cross product with the payload's centre.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from math import sqrt

import numpy as np

from wire.arrays import BoolArray, FloatArray

GRAVITY_M_S2 = 9.81
MIN_TURN_RAD = float(np.deg2rad(20.0))
"""Smallest angle between two attitudes, as gravity sees it."""
MIN_ATTITUDES = 4
"""A bias hides one direction of three attitudes."""
LIMIT_SHARE = 1.0 / 15.0
"""Admitted error of a mean force, as a share of the sensor's range: 2 N on a UR3e, the precision of its sensor."""
TORQUE_LIMIT_SHARE = 1.0 / 50.0
"""Admitted error of a mean torque, as a share of the sensor's range: 0.2 N·m on a UR3e."""
SHOWN_FACTOR = 2.0
"""Weight or torque that a channel must have been shown, in limits of error."""
MAX_GAIN = 1.25
"""Largest gain that passes, of a channel and of a force in any direction; the smallest is its inverse. On an axis that
has been shown just enough weight, an honest sensor passes with an error of a fifth of that weight: 0.8 N on a UR3e.
"""
MIN_GAIN = 0.1
"""A channel that shows less of the weight shows none."""
MAX_CROSSTALK = 0.25
"""Largest share of a channel's reading that may come from the other axes: a sensor that is turned by 14°."""
CHANNELS = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
AXES = ("x", "y", "z")
POINTING: Mapping[str, tuple[float, float, float]] = {
    "z": (0.0, 0.0, 1.0),
    "x": (1.0, 0.0, 0.0),
    "y": (0.0, 1.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
}
"""Attitudes to propose, by the flange's axis that points down."""
UPWARDS = "-z"
"""The last attitude to propose: few cells have room for a tool that points upwards."""
_REWIRE = "correct the mounting of the sensor or the settings of its driver, and weigh again"


@dataclass(frozen=True, slots=True)
class Payload:
    """Everything that the flange carries, as it is configured.

    Attributes:
        mass_kg: mass.
        centre_m: (3,) centre of mass, flange axes.
    """

    mass_kg: float
    centre_m: tuple[float, float, float]

    @property
    def weight_n(self) -> float:
        """Weight, N."""
        return self.mass_kg * GRAVITY_M_S2

    def load(self, down: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return force (3,), N, and torque (3,), N·m, of the weight on the flange, flange axes.

        Args:
            down: (3,) unit vector that points straight down, flange axes.
        """
        force = self.weight_n * down
        return force, np.cross(self.centre_m, force)


@dataclass(frozen=True, slots=True)
class Scale:
    """Instrument and load of a weighing.

    Attributes:
        payload: configured payload.
        force_range_n: end of the sensor's range, per channel of force.
        torque_range_nm: end of the sensor's range, per channel of torque.
    """

    payload: Payload
    force_range_n: float
    torque_range_nm: float

    @property
    def limit_n(self) -> float:
        """Largest difference from the payload's weight at an attitude, N."""
        return LIMIT_SHARE * self.force_range_n

    @property
    def limit_nm(self) -> float:
        """Largest difference from the torque of the payload's weight at an attitude, N·m."""
        return TORQUE_LIMIT_SHARE * self.torque_range_nm

    @property
    def needed_n(self) -> float:
        """Weight that an axis must have been shown to be proven, N."""
        return SHOWN_FACTOR * self.limit_n

    @property
    def is_too_light(self) -> bool:
        """The payload's weight proves no axis, not even at the six attitudes along the flange's axes."""
        return self.payload.weight_n * sqrt(2.0) < self.needed_n


@dataclass(frozen=True, slots=True)
class Rest:
    """Readings of one attitude at which the arm stood.

    Attributes:
        down: (3,) unit vector that points straight down, flange axes.
        wrench: (6,) mean raw reading, N and N·m, about the flange, flange axes.
        frozen: (6,) channels that did not change by a bit.
        saturated: (6,) channels that were at the end of the sensor's range.
        samples: number of readings.
        joints_kg: mass of the payload as the joints feel it.
    """

    down: FloatArray
    wrench: FloatArray
    frozen: BoolArray
    saturated: BoolArray
    samples: int
    joints_kg: float

    @classmethod
    def of(cls, scale: Scale, window: FloatArray, down: FloatArray, joints_kg: float) -> "Rest":
        """Summarise a window (T, 6) of raw readings."""
        ranges = np.array([scale.force_range_n] * 3 + [scale.torque_range_nm] * 3)
        within = np.abs(window) < ranges  # which NaN is not
        saturated = np.array([not column.all() for column in within.T])
        mean = np.nan_to_num(window.mean(0), posinf=0.0, neginf=0.0)
        return cls(down, mean, (window == window[0]).all(0), saturated, len(window), joints_kg)


class Weighing:
    """Compares the readings at all attitudes with the configured payload's weight.

    Args:
        scale: instrument and load.
        rests: attitudes taken so far, one or more.

    Attributes:
        shown_n: (3,) weight that each axis of the flange has been shown, apart from what the other axes were shown at
            the same time and from the bias; root of the sum of squares over the attitudes, N. Zero with fewer than four
            attitudes.
        gain: (3, 3) gain of the force: row, channel; column, axis of the flange.
        lever_m: (3, 3) torque per newton of weight: row, channel; column, axis of the flange.
        residuals: (n, 6) what each attitude differs from the configured payload's weight, less the mean, N and N·m.
    """

    def __init__(self, scale: Scale, rests: tuple[Rest, ...]) -> None:
        self.scale = scale
        self.rests = rests
        downs, read = np.array([rest.down for rest in rests]), np.array([rest.wrench for rest in rests])
        weight_n = scale.payload.weight_n
        apart = downs - downs.mean(0)
        self.shown_n = weight_n * np.array([_alone(apart, axis) for axis in range(3)])
        solved = np.linalg.lstsq(np.column_stack((weight_n * downs, np.ones(len(rests)))), read)[0]
        fit = np.asarray(solved, np.float64)
        self.gain, self.lever_m = fit[:3, :3].T, fit[:3, 3:].T
        over = read - np.array([np.concatenate(scale.payload.load(down)) for down in downs])
        self.residuals: FloatArray = over - over.mean(0)

    @property
    def proven(self) -> tuple[bool, bool, bool]:
        """Axes of the flange along which enough of the weight has been shown to judge the sensor."""
        x, y, z = (self.shown_n >= self.scale.needed_n).tolist()
        return x, y, z

    @property
    def complete(self) -> bool:
        """Every axis is proven."""
        return all(self.proven)

    @property
    def passed(self) -> bool:
        """Every axis is proven, and nothing is wrong."""
        return self.complete and not self.findings

    @property
    def size(self) -> float:
        """Common gain of the axes, without their signs and order; one wrong axis does not change it."""
        return float(np.median(np.linalg.svd(self.gain, compute_uv=False)))

    @property
    def mass_kg(self) -> float:
        """Mass of the payload as the sensor weighs it."""
        return self.size * self.scale.payload.mass_kg

    @property
    def joints_kg(self) -> float:
        """Mass of the payload as the joints feel it, mean of all attitudes."""
        return float(np.mean([rest.joints_kg for rest in self.rests]))

    @property
    def centre_m(self) -> tuple[float, float, float]:
        """Centre of the payload's mass, flange axes, m; meaningless unless `forces_are_right`."""
        lever = self.lever_m / max(self.size, MIN_GAIN)
        x, y, z = lever[2, 1] - lever[1, 2], lever[0, 2] - lever[2, 0], lever[1, 0] - lever[0, 1]
        return float(x / 2.0), float(y / 2.0), float(z / 2.0)

    @property
    def unproven_torques(self) -> tuple[str, ...]:
        """Channels of torque about whose axis the configured payload's weight has too short a lever to judge them."""
        shown_nm = self.scale.payload.weight_n * np.linalg.norm(_cross_matrix(self.scale.payload.centre_m), axis=1)
        return tuple(
            name for name, nm in zip(CHANNELS[3:], shown_nm, strict=True) if nm < SHOWN_FACTOR * self.scale.limit_nm
        )

    def turned_rad(self, down: FloatArray) -> float:
        """Return the angle, rad, between `down` (3,) and the nearest attitude taken so far."""
        nearest = max(float(rest.down @ down) for rest in self.rests)
        return float(np.arccos(np.clip(nearest, -1.0, 1.0)))

    def next_axis(self) -> str:
        """Return the axis of the flange to point down next: the one of `POINTING` farthest from what was taken."""

        def turned_rad(axis: str) -> float:
            return self.turned_rad(np.array(POINTING[axis]))

        farthest = max(POINTING, key=turned_rad)
        return farthest if turned_rad(farthest) >= MIN_TURN_RAD else UPWARDS

    @cached_property
    def findings(self) -> tuple[str, ...]:
        """Everything wrong so far, one sentence each with its remedy. Axes are judged once every one is proven."""
        if not self.complete or self._force_findings:
            return self._force_findings
        return tuple(self._wrong_sums()) or tuple(self._wrong_torques())

    @property
    def forces_are_right(self) -> bool:
        """Every axis is proven, and every force has its sign, gain and axis; `centre_m` is then the payload's."""
        return self.complete and not self._force_findings

    @cached_property
    def _force_findings(self) -> tuple[str, ...]:
        broken = tuple(self._broken_channels())
        if not self.complete:
            return broken
        return (*broken, *self._wrong_forces()) or tuple(self._wrong_directions())

    def _broken_channels(self) -> Iterator[str]:
        saturated = np.any([rest.saturated for rest in self.rests], axis=0)
        frozen = np.any([rest.frozen for rest in self.rests], axis=0) & ~saturated
        if saturated.any():
            yield (
                f"{_names(saturated)} at the end of the sensor's range: free the tool; if it is free, the payload is "
                "too heavy or the sensor's scale is wrong"
            )
        if frozen.any():
            yield (
                f"{_names(frozen)} frozen, without a change by a bit in {min(rest.samples for rest in self.rests)} "
                "samples: switch the arm off and on again; if that does not help, have the sensor repaired"
            )

    def _wrong_forces(self) -> Iterator[str]:
        """Judge each channel of force that is not broken by the axis that it follows."""
        sizes = np.linalg.norm(self.gain, axis=1)
        follows = np.abs(self.gain).argmax(axis=1)
        clear: list[int] = []
        for row in range(3):
            if any(rest.frozen[row] or rest.saturated[row] for rest in self.rests):
                continue
            along = abs(float(self.gain[row, follows[row]]))
            if sizes[row] < MIN_GAIN:
                yield (
                    f"{CHANNELS[row]} does not show the payload's weight, gain {sizes[row]:.2f}: see that the sensor "
                    "is connected"
                )
            elif sizes[row] ** 2 - along**2 > (MAX_CROSSTALK * sizes[row]) ** 2:
                shares = ", ".join(f"{share:.2f}" for share in self.gain[row])
                yield (
                    f"{CHANNELS[row]} shows x, y and z of the weight with the gains {shares}: the sensor is turned "
                    "against the flange, or something touched the tool at an attitude; correct the mounting or weigh "
                    "again"
                )
            else:
                clear.append(row)
        yield from self._wrong_axes(clear, follows.tolist())
        yield from self._wrong_gains(clear, sizes.tolist())

    def _wrong_axes(self, rows: list[int], follows: list[int]) -> Iterator[str]:
        for row in rows:
            other = follows[row]
            if other > row and other in rows and follows[other] == row:
                yield f"{AXES[row]} and {AXES[other]} are swapped: {_REWIRE}"
            elif other != row and not (other in rows and follows[other] == row):
                yield f"{CHANNELS[row]} shows the weight along {AXES[other]}: {_REWIRE}"
        turned_over = [row for row in rows if self.gain[row, follows[row]] < 0.0]
        if turned_over:
            yield f"{', '.join(CHANNELS[row] for row in turned_over)} with the wrong sign: {_REWIRE}"

    def _wrong_gains(self, rows: list[int], sizes: list[float]) -> Iterator[str]:
        wrong = [row for row in rows if not 1.0 / MAX_GAIN <= sizes[row] <= MAX_GAIN]
        if len(wrong) == 3 and max(sizes) <= MAX_GAIN * min(sizes):
            yield (
                f"gain {self.size:.2f} on all axes: the sensor weighs {self.mass_kg:.2f} kg, the joints about "
                f"{self.joints_kg:.2f} kg, {self.scale.payload.mass_kg:g} kg is configured. Weigh the payload on a "
                "scale: correct ur.payload_kg if that is wrong, else have the sensor repaired"
            )
            return
        for row in wrong:
            yield f"{CHANNELS[row]} with a gain of {sizes[row]:.2f}: correct the sensor's scale, or have it repaired"

    def _wrong_directions(self) -> Iterator[str]:
        """Judge forces between the channels, each of which is right by itself: channels that are not at right angles
        hide a force. The singular values of the gain are its least and its largest in any direction.
        """
        _, gains, directions = np.linalg.svd(self.gain)
        for gain, along in zip(gains.tolist(), directions.tolist(), strict=True):
            if not 1.0 / MAX_GAIN <= gain <= MAX_GAIN:
                yield (
                    f"a force along [{', '.join(f'{share:z.2f}' for share in along)}] of the flange is shown with a "
                    f"gain of {gain:.2f}: the channels are not at right angles; have the sensor repaired"
                )

    def _wrong_sums(self) -> Iterator[str]:
        for number, off_n in enumerate(np.linalg.norm(self.residuals[:, :3], axis=1).tolist(), start=1):
            if not off_n <= self.scale.limit_n:
                yield (
                    f"attitude {number} is {off_n:.1f} N off the configured payload's weight, limit "
                    f"{self.scale.limit_n:g} N: see that nothing touches the tool and its cables hang free, and weigh "
                    f"again; the sensor weighs {self.mass_kg:.2f} kg, {self.scale.payload.mass_kg:g} kg is configured"
                )

    def _wrong_torques(self) -> Iterator[str]:
        """Judge the torques by the centre of mass that they give; the forces are right."""
        weight_n, limit_nm = self.scale.payload.weight_n, self.scale.limit_nm
        wanted, found = self.scale.payload.centre_m, self.centre_m
        off = np.linalg.norm(self.lever_m - _cross_matrix(wanted), axis=1) * weight_n
        if (off <= limit_nm).all():
            return
        unlike = np.linalg.norm(self.lever_m - self.size * _cross_matrix(found), axis=1) * weight_n
        if (unlike <= limit_nm).all():
            yield (
                f"by the torques the payload's centre lies at {_millimetres(found)} mm, {_millimetres(wanted)} mm is "
                "configured: correct ur.payload_com_m; if that is right, the torques have a wrong sign or gain"
            )
            return
        for row in np.flatnonzero(off > limit_nm).tolist():
            expected = _cross_matrix(wanted)[row]
            gain = float(self.lever_m[row] @ expected / max(float(expected @ expected), 1e-12))
            yield (
                f"{CHANNELS[3 + row]} differs from the torque of the payload's weight by up to {off[row]:.2f} N·m "
                f"(gain {gain:.2f}), limit {limit_nm:g} N·m: {_REWIRE}"
            )


def _alone(apart: FloatArray, axis: int) -> float:
    """Return the length of column `axis` of `apart` (n, 3), less its part along the other two columns."""
    column, others = apart[:, axis], np.delete(apart, axis, axis=1)
    return float(np.linalg.norm(column - others @ np.linalg.lstsq(others, column)[0]))


def _cross_matrix(centre: tuple[float, float, float]) -> FloatArray:
    """Return the matrix (3, 3) whose product with a vector is the cross product of `centre` (3,) with it."""
    x, y, z = centre
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _names(channels: BoolArray) -> str:
    return ", ".join(CHANNELS[index] for index in np.flatnonzero(channels))


def _millimetres(centre: tuple[float, float, float]) -> str:
    return "[" + ", ".join(f"{value * 1e3:.0f}" for value in centre) + "]"
