"""What no configuration, recipe or policy may raise, and what both a cell and a training must have alike."""

from typing import Literal

FORCE_HARD_MAXIMUM_N = 50.0
"""Highest force ceiling that can be configured."""
TORQUE_HARD_MAXIMUM_NM = 10.0
"""Highest torque ceiling that can be configured: the end of the sensor's range."""

YAW_HALF_RANGE_RAD = 1.45
"""How far from the start's yaw commands may turn, unless a cell says otherwise: 83°, of which a hole needs 60°."""

LockMode = Literal["paper", "peck", "sliding", "off"]
"""How the depth may be limited; `service.safety.dsl` says what each one does."""
