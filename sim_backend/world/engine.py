"""The callbacks that the compiled tick installs in MuJoCo, which has one of each callback for the whole process."""

import ctypes
from collections.abc import Callable
from typing import Any

import mujoco

from sim_backend.world import compiled

_Control: Callable[[int], Any] = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)
_Clock: Callable[[int], Any] = ctypes.CFUNCTYPE(ctypes.c_double)
_control = None if compiled.tick is None else _Control(compiled.tick.CONTROL)
_clock = None if compiled.tick is None else _Clock(compiled.tick.CLOCK)


def obstacle() -> str:
    """Return the reason why several ticks cannot be one call of MuJoCo in this process, or "" if they can.

    The control callback is installed if there is none. It leaves other models alone, which it tells by their names.
    """
    tick = compiled.tick
    if tick is None:
        return "the compiled tick is not used"
    if mujoco.mj_version() != tick.MUJOCO:
        return f"the compiled tick was built for MuJoCo {tick.MUJOCO}, this is {mujoco.mj_version()}"
    if not tick.INVERTS:
        return "numpy's inverse of a matrix is not where the compiled tick looks for it"
    if mujoco.get_mjcb_control() is None:
        mujoco.set_mjcb_control(_control)
    if mujoco.get_mjcb_control() is not _control:
        return "another control callback of MuJoCo is installed"
    return ""


def describe() -> str:
    """Return a line that says what computes the ticks, and why several are not one call where the extension is used."""
    reason = obstacle()
    line = compiled.describe()
    return line if compiled.tick is None or not reason else f"{line}; every tick is a call of MuJoCo, slower: {reason}"


def stop_timers() -> None:
    """Stop MuJoCo's timers, `MjData.timer`, which nobody here reads: reading the clock is a tenth of a step.

    A clock that somebody else has installed stays.
    """
    if _clock is not None and mujoco.get_mjcb_time() is None:  # None stands for MuJoCo's own
        mujoco.set_mjcb_time(_clock)
