"""Zenoh key expressions of a simulated cell; what is sent under each stands in `docs/wire.md`."""

STATE = "sim/{world}/state"
COMMAND = "sim/{world}/command"
ADVANCE = "sim/{world}/advance"
RESET = "sim/{world}/reset"
INFO = "sim/{world}/info"
TRUTH = "sim/{world}/truth"
