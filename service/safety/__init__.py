"""What keeps a policy from breaking the part: depth lock, command bounds, monitor, stop confirmation, pre-flight.

Pure: arrays and frozen dataclasses in, decisions out. No clock, no input or output, no logging. The depth lock, the
bounds and the pose arithmetic work on any leading batch shape `...`, which is `()` in a cell and `(n,)` in training.
"""
