"""Conditions under which figures were taken; a figure without them says little."""

import ctypes
import os
import platform
import subprocess
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

PACKAGES = ("mujoco", "onnxruntime", "eclipse-zenoh", "numpy", "uvicorn")
_MCL_CURRENT = 1


def conditions() -> dict[str, str]:
    """Describe machine, versions, permissions and present load."""
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "commit": _commit(),
        "processor": _processor(),
        "cores": str(len(os.sched_getaffinity(0))),
        "kernel": platform.release(),
        "python": platform.python_version(),
        **{package: version(package) for package in PACKAGES},
        "SCHED_FIFO": "permitted" if may_use_fifo() else "refused",
        "mlockall": "permitted" if may_lock_memory() else "refused",
        "load before": load(),
    }


def load() -> str:
    """Return the load of the last minute; above the number of cores, every measured time is too high."""
    return f"{os.getloadavg()[0]:.2f}"


def may_use_fifo() -> bool:
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except OSError:
        return False
    os.sched_setscheduler(0, *before)
    return True


def may_lock_memory() -> bool:
    libc = ctypes.CDLL(None)
    if libc.mlockall(_MCL_CURRENT):
        return False
    libc.munlockall()
    return True


def _processor() -> str:
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()


def _commit() -> str:
    """Return the commit, marked if tracked files differ from it, or a text if there is none."""
    root = Path(__file__).resolve().parents[2]
    try:
        done = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--exclude", "*"],  # noqa: S607  # any installed git will do
            cwd=root,
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return "not a git checkout"
    return done.stdout.strip()
