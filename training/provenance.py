"""Where a figure or a model comes from: commit, machine, versions, and the sources that decide an episode."""

import hashlib
import os
import platform
import shutil
import subprocess
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = ("mujoco", "numpy", "onnxruntime", "torch")
ROOT = Path(__file__).parents[1]
DECIDING = (
    *(f"service/policy/{name}.py" for name in ("action", "contract", "model", "observation", "onnx_file", "window")),
    *(f"service/safety/{name}.py" for name in ("bounds", "dsl", "pose")),
    "service/hard_limits.py",
    *(f"sim_backend/{name}.py" for name in ("arm", "compliance", "conditions", "kinematics", "parts", "quaternion")),
    *(f"sim_backend/{name}.py" for name in ("scene", "sensor", "servo", "world")),
    *(f"sim_backend/protocol/{name}.py" for name in ("pose", "task", "wire")),
    *(f"training/{name}.py" for name in ("evaluate", "insertion", "reward")),
)
"""What an episode in the batched environment depends on, besides the policy's file; a test looks for missing ones."""


def commit() -> str | None:
    """Return the commit of the working tree, marked if it is not as committed; None where that is not known."""
    git = shutil.which("git")
    if git is None:
        return None
    done = subprocess.run(
        [git, "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout.strip() or None


def machine() -> str:
    """Return the processor and how many of its cores this process may use."""
    return f"{_processor()}, {len(os.sched_getaffinity(0))} cores"


@cache
def sources() -> str:
    """Return the SHA-256 of `DECIDING`, names and contents in sorted order: the same wherever the sources are."""
    digest = hashlib.sha256()
    for name in sorted(DECIDING):
        data = (ROOT / name).read_bytes()
        digest.update(f"{name} {len(data)}\n".encode() + data)
    return digest.hexdigest()


def versions() -> dict[str, str]:
    """Return the versions of Python and of what results depend on, as far as it is installed."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def _processor() -> str:
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()
