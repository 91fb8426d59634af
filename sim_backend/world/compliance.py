"""The compliance law: an admittance about a TCP pose target, 500 times a second, for any number of arms at once.

    inertia · v̇  =  stiffness · e  −  damping · v  +  wrench

`e` is the pose of the target relative to the reference (base axes), `v` the reference's twist, and `wrench` the
measured wrench of the environment on the tool. The position-controlled arm follows the reference. Translation and
rotation are about the TCP, the peg's tip, so a corner that catches turns the peg about its tip and does not drag it
sideways.

The law needs only the pose, the compensated wrench and position commands, so any UR controller can run it.
`docs/explanation/decisions/0004-admittance.md` compares it with joint torques and `force_mode`.
"""

from dataclasses import dataclass

import numpy as np

from sim_backend.world import quaternion
from wire.arrays import FloatArray
from wire.records import TICK_S


@dataclass(slots=True)
class Law:
    """Parameters of the law for n arms.

    Attributes:
        stiffness: (n, 6) N/m and N·m/rad.
        damping: (n, 6) N·s/m and N·m·s/rad.
        inertia: (n, 6) kg and kg·m².
        max_speed: (n, 2) m/s and rad/s.
    """

    stiffness: FloatArray
    damping: FloatArray
    inertia: FloatArray
    max_speed: FloatArray


@dataclass(slots=True)
class Reference:
    """Pose and twist that n arms follow, base frame.

    Attributes:
        position: (n, 3) m.
        quaternion: (n, 4) scalar first.
        twist: (n, 6) m/s and rad/s.
    """

    position: FloatArray
    quaternion: FloatArray
    twist: FloatArray


def advance(
    law: Law, reference: Reference, target_position: FloatArray, target_quaternion: FloatArray, wrench: FloatArray
) -> None:
    """Advance the reference by one tick, in place.

    The step is semi-implicit: stiffness and damping act on the twist at the end of the tick, so that no choice of
    parameters makes the law unstable by itself. The loop through the contact limits the parameters; see the decision
    record.

    Args:
        law: parameters of n arms.
        reference: pose and twist of n arms, changed in place.
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
    limit_speed(twist, law.max_speed)
    reference.position += TICK_S * twist[:, :3]
    quaternion.turn(reference.quaternion, (0.5 * TICK_S) * twist[:, 3:])


def limit_speed(twist: FloatArray, max_speed: FloatArray) -> None:
    """Shorten the linear and the angular part of `twist` (n, 6) to `max_speed` (n, 2), in place.

    A part that is not above its limit stays as it is; so does one whose length is not a number.
    """
    pairs = twist.reshape(-1, 2, 3)
    speed = np.sqrt((pairs * pairs).sum(2))
    above = speed > max_speed
    if above.any():
        pairs *= np.where(above, max_speed / np.maximum(speed, 1e-12), 1.0)[:, :, None]
