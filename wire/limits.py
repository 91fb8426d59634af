"""Hard maxima that no configuration, recipe or policy may exceed, and the defaults that cells and trainings share."""

from typing import Literal

FORCE_HARD_MAXIMUM_N = 50.0
"""Highest force ceiling that can be configured."""
TORQUE_HARD_MAXIMUM_NM = 10.0
"""Highest torque ceiling that can be configured; it is the end of the sensor's range."""

YAW_HALF_RANGE_RAD = 1.45
"""Default yaw range of commands to either side of the start's yaw: 83°. A hole needs 60°; a cell may set another."""

TILT_RAD = 0.08
"""Default tilt of the tool from straight down at which a cell stops: 4.6°. Insertions lean up to 3.7°."""
TORQUE_CEILING_NM = 5.0
"""Default resultant torque at the TCP at which a cell stops; every single sample counts."""

LockMode = Literal["paper", "peck", "sliding", "off"]
"""Modes of the depth limit; `service.safety.dsl` describes each."""
