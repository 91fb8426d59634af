"""Modes that more than one side names."""

from typing import Literal

LockMode = Literal["paper", "sliding", "off"]
"""Mode of the depth lock; `service.safety.dsl` describes each."""
TimeMode = Literal["real_time", "lockstep"]
"""Passage of time: by itself, or only as far as the client lets it."""
