"""Modes that more than one side names."""

from typing import Literal

LockMode = Literal["paper", "sliding", "off"]
"""Mode of the depth lock; `service.safety.dsl` describes each."""
TimeMode = Literal["real_time", "lockstep"]
"""Passage of time: by itself, or only as far as the client lets it."""
RESTING_PERIOD_S = 0.01
"""Time from one state to the next of a simulated cell in real time that nothing drives, s."""
