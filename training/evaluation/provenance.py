"""Provenance of figures and models: commit, machine, versions, and the sources that decide an episode."""

import hashlib
import os
import platform
import shutil
import subprocess
from collections.abc import Iterable
from functools import cache, lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from training.evaluation.source_code import without_prose

PACKAGES = ("mujoco", "numpy", "onnxruntime", "torch")
ROOT = Path(__file__).parents[2]
CODE = ("wire", "service", "sim_backend", "training")
DECIDING = (
    *(
        f"service/policy/{name}.py"
        for name in ("action", "contract", "model", "observation", "onnx_file", "step", "window")
    ),
    *(f"service/safety/{name}.py" for name in ("bounds", "dsl", "pose")),
    *(f"sim_backend/world/{name}.py" for name in ("arm", "compliance", "conditions", "engine", "kinematics", "layout")),
    *(f"sim_backend/world/{name}.py" for name in ("linear", "parts", "quaternion", "scene", "sensor", "servo")),
    *(f"sim_backend/world/{name}.py" for name in ("delays", "errors", "gears", "model_errors", "peg")),
    *(f"sim_backend/world/{name}.py" for name in ("telling", "together", "world")),
    "sim_backend/world/compiled/__init__.py",
    *(f"sim_backend/world/compiled/{name}.c" for name in ("advance", "arguments", "arm", "cells", "functions")),
    *(f"sim_backend/world/compiled/{name}.c" for name in ("joint_sense", "kinematics", "module", "quaternion")),
    *(f"sim_backend/world/compiled/{name}.c" for name in ("sensor", "telling")),
    *(f"sim_backend/world/compiled/{name}.h" for name in ("advance", "arguments", "arm", "cells", "functions")),
    *(f"sim_backend/world/compiled/{name}.h" for name in ("joint_sense", "kinematics")),
    *(f"sim_backend/world/compiled/{name}.h" for name in ("linear", "quaternion", "rows", "sensor", "telling")),
    *(f"service/policy/compiled/{name}.py" for name in ("__init__", "policy_step")),
    *(f"service/policy/compiled/{name}.c" for name in ("act", "action", "arrays", "bounds", "functions", "lock")),
    *(f"service/policy/compiled/{name}.c" for name in ("module", "observation", "observe", "pose", "window")),
    *(f"service/policy/compiled/{name}.h" for name in ("action", "arrays", "bounds", "calls", "functions", "lock")),
    *(f"service/policy/compiled/{name}.h" for name in ("numbers", "observation", "pose", "window")),
    "wire/loops.h",
    *(f"wire/{name}.py" for name in ("extension", "law", "limits", "plant", "pose", "records", "task")),
    "training/evaluation/evaluate.py",
    *(f"training/environment/{name}.py" for name in ("insertion", "reward")),
)
"""Sources that decide an episode in the batched environment, besides the policy's file; a test finds missing ones."""
DEPLOYED = (
    *(
        f"{package}/**/*.{kind}"
        for package in ("wire", "service", "sim_backend")
        for kind in ("py", "urscript", "lark", "c", "h")
    ),
    "training/evaluation/through_service.py",
)
"""Further sources on which an episode through the deployed service may depend."""
DIRTY = "-dirty"


def commit() -> str | None:
    """Return the commit, with `DIRTY` if the code differs from it; None if it is not known.

    Results, documents and policies may differ from the commit: a file of results names its policy.
    """
    head = _git("rev-parse", "--verify", "HEAD")
    return None if head is None else head + (DIRTY if _git("status", "--porcelain", "--", *CODE) != "" else "")


def machine() -> str:
    """Return the processor and how many of its cores this process may use."""
    return f"{_processor()}, {len(os.sched_getaffinity(0))} cores"


@cache
def sources() -> str:
    """Return the SHA-256 of `DECIDING`, names and code in sorted order: the same wherever the sources are."""
    return _digest(DECIDING)


def deployed_sources() -> str:
    """Return the SHA-256 of `DECIDING` and `DEPLOYED` together, read anew: a service starts from the files."""
    found = (path for pattern in DEPLOYED for path in ROOT.glob(pattern))
    return _digest({*DECIDING, *(path.relative_to(ROOT).as_posix() for path in found)})


def versions() -> dict[str, str]:
    """Return the versions of Python and of the installed packages that results depend on."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def _digest(names: Iterable[str]) -> str:
    """Digest files: Python without docstrings, comments and blank lines, other files byte by byte."""
    digest = hashlib.sha256()
    for name in sorted(names):
        data = (ROOT / name).read_bytes()
        if name.endswith(".py"):
            data = _code(data)
        digest.update(f"{name} {len(data)}\n".encode() + data)
    return digest.hexdigest()


@lru_cache(maxsize=1024)
def _code(data: bytes) -> bytes:
    """Code of a Python file; cached, because a measurement through the service asks for its digest at every episode."""
    return without_prose(data.decode()).encode()


def _git(*arguments: str) -> str | None:
    """Return the output of git in this project; None if it fails, as outside a working tree."""
    git = shutil.which("git")
    if git is None:
        return None
    done = subprocess.run([git, *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    return None if done.returncode else done.stdout.strip()


def _processor() -> str:
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()
