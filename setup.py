"""The one part of the package that is built: the compiled tick, left out where there is no C compiler.

Everything else about the package is in `pyproject.toml`.
"""

import runpy
from glob import glob
from importlib.util import find_spec
from pathlib import Path

import numpy
from setuptools import Extension, setup

FOLDER = "sim_backend/world/compiled"
MUJOCO = find_spec("mujoco")
if MUJOCO is None or MUJOCO.origin is None:
    raise ModuleNotFoundError("the compiled tick is built against the headers of mujoco, which is not installed")
SOURCES = runpy.run_path(f"{FOLDER}/sources.py")["digest"]()

setup(
    ext_modules=[
        Extension(
            "sim_backend.world.compiled._tick",
            sorted(glob(f"{FOLDER}/*.c")),
            depends=sorted(glob(f"{FOLDER}/*.h")),
            include_dirs=[numpy.get_include(), str(Path(MUJOCO.origin).parent / "include")],
            define_macros=[("Py_LIMITED_API", "0x030B0000"), ("SOURCES", f'"{SOURCES}"')],
            # as numpy's: one rounding for each operation
            extra_compile_args=["-std=c99", "-O2", "-ffp-contract=off"],
            py_limited_api=True,
            optional=True,
        )
    ],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
