"""Attitudes of the emulated arm at which another client's program lets it stand."""

from collections.abc import Sequence

START = (0.07, -1.59, -1.24, -1.89, 1.57, -1.5)
"""Joint angles near the start pose, rad: the tool points straight down."""
TURNS = ((0.0, 0.0), (-1.5, 0.0), (-1.5, 1.57), (-1.5, 3.14))
"""Turns of wrists 1 and 3 from there, rad: straight down, then three times nearly level."""


def targets() -> list[list[float]]:
    """Return the joint angles of all attitudes."""
    *others, wrist1, wrist2, wrist3 = START
    return [[*others, wrist1 + tilt, wrist2, wrist3 + roll] for tilt, roll in TURNS]


def movej(q: Sequence[float]) -> str:
    """Return a program that moves the arm there, as an operator's pendant does."""
    return f"def jog():\n  movej({list(q)}, a=8.0, v=3.0)\nend\n"
