"""What no configuration, recipe or policy may raise, and the defaults that cells and trainings share."""

from typing import Literal

FORCE_HARD_MAXIMUM_N = 50.0
"""Highest force ceiling that can be configured."""
TORQUE_HARD_MAXIMUM_NM = 10.0
"""Highest torque ceiling that can be configured: the end of the sensor's range."""

YAW_HALF_RANGE_RAD = 1.45
"""Default of how far from the start's yaw commands may turn; a cell may say otherwise: 83°, a hole needs 60°."""

TILT_RAD = 0.08
"""Default of how far the tool may lean from straight down before a cell stops: 4.6°; insertions lean up to 3.7°."""
TORQUE_CEILING_NM = 5.0
"""Default of the resultant torque at the TCP, of any single sample, at which a cell stops."""

LockMode = Literal["paper", "peck", "sliding", "off"]
"""How the depth may be limited; `service.safety.dsl` says what each one does."""
