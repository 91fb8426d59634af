"""Limits and defaults that the service, the simulated arm and training share: hard maxima first, then the defaults."""

FORCE_HARD_MAXIMUM_N = 50.0
"""Highest force ceiling that can be configured."""
TORQUE_HARD_MAXIMUM_NM = 10.0
"""Highest torque ceiling that can be configured; it is the end of the sensor's range."""

FORCE_CEILING_N = 30.0
"""Force ceiling of the standard recipe and of training: resultant of any single sample."""
TORQUE_CEILING_NM = 5.0
"""Torque ceiling: resultant at the TCP of any single sample."""
TILT_RAD = 0.08
"""Tilt of the tool from straight down at which a cell stops: 4.6°. Insertions tilt up to 3.7°."""
YAW_HALF_RANGE_RAD = 1.45
"""Largest angle between commanded yaw and start yaw: 83°. A hole needs 60°."""

MAX_SPEED = (0.1, 3.0)
"""Speed of targets and of the arm's reference, m/s and rad/s."""
MAX_STEP = (0.012, 0.30)
"""Change between consecutive targets, and distance of a target from the measured pose, m and rad."""
TARGET_AGE_S = 0.3
"""Time without a new target after which the arm's own controller stops."""
WORKSPACE_M = ((0.15, -0.26, 0.01), (0.45, 0.04, 0.40))
"""Lower and upper corner of the box for the TCP in the simulated cell, base frame."""
