"""Errors of one episode's plant: the sizes of `wire.plant` with signs and directions drawn."""

from dataclasses import dataclass, field
from functools import partial

import numpy as np

from wire.arrays import CellIndices, FloatArray
from wire.plant import PlantErrors

JITTERS = 64
"""Targets whose further delay is drawn per episode; a longer episode repeats them."""
_DIRECTIONS, _JITTER = 4, 5
"""Numbers of the random streams, so that the other draws of a seed do not depend on them."""


_nothing = partial(np.zeros, 3)


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """One plant's errors that no other quantity of an episode holds; the defaults are no errors.

    Attributes:
        hole_tilt: (3,) rotation vector that tilts the hole, base axes, rad.
        tcp_shift: (3,) the peg's place relative to the calibrated TCP, tool axes, m.
        tcp_turn: (3,) rotation vector that turns the peg about it, tool axes, rad.
        ft_turn: (3,) rotation vector that turns the sensor's axes, flange axes, rad.
        ft_gain: reading of the sensor for a load of one.
        ft_left: (6,) reading of a zeroed sensor without a load, its axes, N and N·m.
        payload_shift: (3,) the payload's centre relative to the one that is compensated, flange axes, m.
        finger_stiffness_scale: stiffness of the fingers, relative to nominal.
        joint_stiffness_scale: stiffness of the joints' position loops, relative to nominal.
        joint_friction_share: Coulomb friction of the joints, relative to their rated torques.
        joint_backlash: play of the joints' gears, rad.
        joint_ripple: amplitude of their uneven motion, rad.
        target_jitter: (JITTERS,) further delay of the targets, in their order, ticks.
    """

    hole_tilt: FloatArray = field(default_factory=_nothing)
    tcp_shift: FloatArray = field(default_factory=_nothing)
    tcp_turn: FloatArray = field(default_factory=_nothing)
    ft_turn: FloatArray = field(default_factory=_nothing)
    ft_gain: float = 1.0
    ft_left: FloatArray = field(default_factory=partial(np.zeros, 6))
    payload_shift: FloatArray = field(default_factory=_nothing)
    finger_stiffness_scale: float = 1.0
    joint_stiffness_scale: float = 1.0
    joint_friction_share: float = 0.0
    joint_backlash: float = 0.0
    joint_ripple: float = 0.0
    target_jitter: CellIndices = field(default_factory=partial(np.zeros, JITTERS, np.int64))


NONE = Errors()


@dataclass(frozen=True, slots=True, eq=False)
class Directions:
    """Signs and directions of one plant's errors, each uniform. Horizontal ones are of length 1 in x and y."""

    hole_axis: FloatArray
    tcp_shift: FloatArray
    tcp_height: float
    tcp_axis: FloatArray
    ft_axis: FloatArray
    ft_gain: float
    ft_force: FloatArray
    ft_torque: FloatArray
    camera: FloatArray
    camera_height: float
    payload: FloatArray


def directions(seed: int) -> Directions:
    """Draw the signs and directions of a seed."""
    rng = np.random.default_rng([seed, _DIRECTIONS])

    def level() -> FloatArray:
        angle = rng.uniform(-np.pi, np.pi)
        return np.array([np.cos(angle), np.sin(angle), 0.0])

    def sign() -> float:
        return float(rng.choice([-1.0, 1.0]))

    def spatial() -> FloatArray:
        v = rng.normal(size=3)
        return v / np.sqrt((v * v).sum())

    return Directions(
        hole_axis=level(),
        tcp_shift=level(),
        tcp_height=sign(),
        tcp_axis=level(),
        ft_axis=spatial(),
        ft_gain=sign(),
        ft_force=spatial(),
        ft_torque=spatial(),
        camera=level(),
        camera_height=sign(),
        payload=level(),
    )


def errors_of(plant: PlantErrors, drawn: Directions, seed: int) -> Errors:
    """Return the errors of a plant for the episode of `seed`."""
    height = np.array([0.0, 0.0, drawn.tcp_height * plant.tcp_height_m])
    jitter = np.random.default_rng([seed, _JITTER]).integers(0, plant.target_jitter_ticks + 1, JITTERS)
    return Errors(
        hole_tilt=np.deg2rad(plant.hole_tilt_deg) * drawn.hole_axis,
        tcp_shift=plant.tcp_shift_m * drawn.tcp_shift + height,
        tcp_turn=np.deg2rad(plant.tcp_tilt_deg) * drawn.tcp_axis,
        ft_turn=np.deg2rad(plant.ft_turn_deg) * drawn.ft_axis,
        ft_gain=1.0 + drawn.ft_gain * plant.ft_gain_error,
        ft_left=np.concatenate([plant.ft_left_n * drawn.ft_force, plant.ft_left_nm * drawn.ft_torque]),
        payload_shift=plant.payload_shift_m * drawn.payload,
        finger_stiffness_scale=plant.finger_stiffness_scale,
        joint_stiffness_scale=plant.joint_stiffness_scale,
        joint_friction_share=plant.joint_friction_share,
        joint_backlash=float(np.deg2rad(plant.joint_backlash_deg)),
        joint_ripple=float(np.deg2rad(plant.joint_ripple_deg)),
        target_jitter=jitter,
    )
