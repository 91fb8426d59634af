"""Zenoh key expressions of a simulated cell, under `sim/<world>/`.

| key | kind | payload |
|---|---|---|
| `state` | publication, every tick in real time, none in lockstep | one `wire.STATE` |
| `command` | subscription | one `wire.COMMAND` |
| `advance` | query, lockstep: commands or none, then `ticks` (a parameter) ticks | reply: `ticks` of `wire.STATE` |
| `reset` | query: JSON of `Task` | reply: one `wire.STATE`, after the world is laid out anew; an error reply is text |
| `info` | query | reply: JSON `{"version", "mode", "epoch", "tick_s", "part"}` |
| `truth` | query, for evaluation and tests; the service never asks | reply: JSON of the world's true state |
"""

STATE = "sim/{world}/state"
COMMAND = "sim/{world}/command"
ADVANCE = "sim/{world}/advance"
RESET = "sim/{world}/reset"
INFO = "sim/{world}/info"
TRUTH = "sim/{world}/truth"
