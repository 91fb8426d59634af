"""Optional compiled extensions: identity of their C sources, loading, and the constants that they take.

`setup.py` runs this file by itself; it imports nothing of the project.
"""

import hashlib
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import numpy.typing as npt

SHARED = Path(__file__).parent
"""Folder of the headers that all extensions include."""
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fno-fast-math", "-fno-tree-slp-vectorize")
"""Flags of the compiler: as in numpy, one rounding for each operation, whatever the environment's `CFLAGS` ask for."""


def digest(folder: Path) -> str:
    """Return the SHA-256 of the compiler's flags, the C files of a folder and the shared headers, in sorted order."""
    found = hashlib.sha256(" ".join(FLAGS).encode())
    for path in (*sorted(folder.glob("*.[ch]")), *sorted(SHARED.glob("*.h"))):
        data = path.read_bytes()
        found.update(f"{path.name} {len(data)}\n".encode() + data)
    return found.hexdigest()


def load(name: str, folder: Path) -> tuple[ModuleType | None, str]:
    """Load an extension that carries the digest of its sources as `SOURCES`.

    Args:
        name: its module.
        folder: folder of its present sources.

    Returns:
        The module and "", or None and the reason why it is not used.
    """
    try:
        found = import_module(name)
    except ImportError as error:
        return None, f"it is not built: {error}"
    except Exception as error:  # one that was built for other libraries may raise anything
        return None, f"it cannot be loaded: {error!r}"
    if digest(folder) != getattr(found, "SOURCES", None):
        return None, "it was built from other sources"
    return found, ""


def constants(sizes: Mapping[str, int], found: Mapping[str, npt.ArrayLike]) -> npt.NDArray[np.float64]:
    """Return constants one after another, in the order of `sizes`.

    Args:
        sizes: how many numbers the extension asks for of each constant.
        found: the constants by name; others are left out.

    Raises:
        ValueError: a constant has another size.
    """
    parts = [np.atleast_1d(np.asarray(found[name], np.float64)) for name in sizes]
    for part, (name, size) in zip(parts, sizes.items(), strict=True):
        if part.shape != (size,):
            raise ValueError(f"constant {name} has shape {part.shape}, the extension asks for {size} numbers")
    return np.concatenate(parts)


def describe(what: str, name: str, absence: str) -> str:
    """Return a line that says whether the extension called `name` computes `what`.

    Args:
        what: for people.
        name: for people.
        absence: the reason why it does not, or "".
    """
    if not absence:
        return f"{what}: compiled"
    return (
        f"{what}: numpy, slower; the {name} is not used, {absence}; "
        "where a C compiler and Python's headers are installed, `make -B setup` builds it"
    )
