"""The compliance law: an admittance about a TCP pose target, 500 times a second, for any number of arms at once.

    inertia · v̇  =  stiffness · e  −  damping · v  +  wrench

`e` is the pose of the target seen from the reference (base axes), `v` the reference's twist, `wrench` what the sensor
says that the environment does to the tool. The reference is what the position-controlled arm follows. Translation and
rotation are about the TCP, the peg's tip, so a corner that catches turns the peg about its tip and does not drag it
sideways.
It needs nothing but the pose, the compensated wrench and position commands: any UR controller can run it. Why this law
and not joint torques or `force_mode`: `docs/explanation/decisions/0004-admittance.md`.
"""

from dataclasses import dataclass

import numpy as np

from sim_backend.world import quaternion
from wire.arrays import FloatArray
from wire.records import TICK_S


@dataclass(slots=True)
class Law:
    """Parameters, each (n, 6): N/m and N·m/rad; N·s/m and N·m·s/rad; kg and kg·m².

    `max_speed` is (n, 2), m/s and rad/s.
    """

    stiffness: FloatArray
    damping: FloatArray
    inertia: FloatArray
    max_speed: FloatArray


@dataclass(slots=True)
class Reference:
    """What the arm is told to follow, in the base frame.

    `position` (n, 3) m, `quaternion` (n, 4) scalar first, `twist` (n, 6) m/s and rad/s.
    """

    position: FloatArray
    quaternion: FloatArray
    twist: FloatArray


def advance(
    law: Law, reference: Reference, target_position: FloatArray, target_quaternion: FloatArray, wrench: FloatArray
) -> None:
    """Advance the reference by one tick, in place.

    Semi-implicit: stiffness and damping act on the twist at the end of the tick, so that no choice of parameters
    makes the law unstable by itself. What limits them is the loop through the contact: see the decision record.

    Args:
        law: parameters of n arms.
        reference: theirs, changed in place.
        target_position: (n, 3) m, base frame.
        target_quaternion: (n, 4) scalar first.
        wrench: (n, 6) N and N·m, on the tool at the TCP, base axes.
    """
    force = np.empty_like(wrench)
    np.subtract(target_position, reference.position, out=force[:, :3])
    force[:, 3:] = quaternion.between(reference.quaternion, target_quaternion)
    force *= law.stiffness
    force += wrench
    force *= TICK_S
    twist = reference.twist
    twist *= law.inertia
    twist += force
    twist /= law.inertia + TICK_S * (law.damping + TICK_S * law.stiffness)
    pairs = twist.reshape(-1, 2, 3)
    speed = np.sqrt((pairs * pairs).sum(2))
    if (speed > law.max_speed).any():
        pairs *= np.minimum(1.0, law.max_speed / np.maximum(speed, 1e-12))[:, :, None]
    reference.position += TICK_S * twist[:, :3]
    quaternion.turn(reference.quaternion, (0.5 * TICK_S) * twist[:, 3:])
