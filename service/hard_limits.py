"""What no configuration, recipe or policy may raise."""

from typing import Literal

FORCE_HARD_MAXIMUM_N = 50.0
"""Highest force ceiling that can be configured."""
TORQUE_HARD_MAXIMUM_NM = 10.0
"""Highest torque ceiling that can be configured: the end of the sensor's range."""

LockMode = Literal["paper", "peck", "sliding", "off"]
"""How the depth may be limited; `service.safety.dsl` says what each one does."""
