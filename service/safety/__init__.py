"""Keeps a policy from breaking the part: depth lock, command bounds, monitor, stop confirmation, pre-flight checks.

The package is pure: arrays and frozen dataclasses in, decisions out. It reads no clock, does no input or output, and
logs nothing. The depth lock, the bounds and the pose arithmetic work on any leading batch shape `...`, which is `()` in
a cell and `(n,)` in training.
"""
