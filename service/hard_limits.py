"""What no configuration, recipe or policy may raise, and the default that cells and trainings share."""

from typing import Literal

FORCE_HARD_MAXIMUM_N = 50.0
"""Highest force ceiling that can be configured."""
TORQUE_HARD_MAXIMUM_NM = 10.0
"""Highest torque ceiling that can be configured: the end of the sensor's range."""

YAW_HALF_RANGE_RAD = 1.45
"""Default of how far from the start's yaw commands may turn; a cell may say otherwise: 83°, a hole needs 60°."""

LockMode = Literal["paper", "peck", "sliding", "off"]
"""How the depth may be limited; `service.safety.dsl` says what each one does."""
