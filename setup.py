"""The parts of the package that are built: the compiled tick and the compiled step, left out without a C compiler.

Everything else about the package is in `pyproject.toml`.
"""

import runpy
from glob import glob
from importlib.util import find_spec
from pathlib import Path

import numpy
from setuptools import Extension, setup

MUJOCO = find_spec("mujoco")
if MUJOCO is None or MUJOCO.origin is None:
    raise ModuleNotFoundError("the compiled tick is built against the headers of mujoco, which is not installed")
INCLUDED = ["wire", numpy.get_include(), str(Path(MUJOCO.origin).parent / "include")]
IDENTITY = runpy.run_path("wire/extension.py")


def extension(folder: str, name: str) -> Extension:
    """Return the extension of the C files of a folder."""
    return Extension(
        f"{folder.replace('/', '.')}.{name}",
        sorted(glob(f"{folder}/*.c")),
        depends=["wire/extension.py", *sorted(glob(f"{folder}/*.h") + glob("wire/*.h"))],
        include_dirs=INCLUDED,
        define_macros=[("Py_LIMITED_API", "0x030B0000"), ("SOURCES", f'"{IDENTITY["digest"](Path(folder))}"')],
        extra_compile_args=list(IDENTITY["FLAGS"]),
        py_limited_api=True,
        optional=True,
    )


setup(
    ext_modules=[extension("sim_backend/world/compiled", "_tick"), extension("service/policy/compiled", "_step")],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
